#include "server/vision/recognition/initialization/decomposition.h"

#include <Eigen/Dense>
#include <algorithm>
#include <cmath>
#include <functional>

#include "absl/strings/str_cat.h"
#include "server/base/status_macros.h"
#include "server/vision/geometry/camera_factors.h"
#include "server/vision/geometry/collineation.h"
#include "server/vision/geometry/pose_perturbation.h"

namespace horopter {
namespace {

constexpr int kUpgradeParameters = 15;  // of a collineation of space
constexpr double kStep = 1e-6;  // of numeric derivatives, relative to parameters of order one

Eigen::Vector3d Euclidean(const Eigen::Vector4d& X) {
  return X.head<3>() / X.w();
}

// The object's points in the scene, measured or mapped.
std::vector<Eigen::Vector4d> ScenePoints(const CollineatedObject& o) {
  if (!o.points_in_scene.empty()) return o.points_in_scene;
  std::vector<Eigen::Vector4d> out;
  for (const auto& x : o.points_in_object) out.push_back(o.scene_from_object * x.homogeneous());
  return out;
}

absl::Status CheckObjects(std::span<const CollineatedObject> objects) {
  if (objects.empty()) return absl::InvalidArgumentError("objects: none");
  for (std::size_t i = 0; i < objects.size(); ++i) {
    const CollineatedObject& o = objects[i];
    const std::size_t n = o.points_in_object.size();
    if (n < 4 || (!o.points_in_scene.empty() && o.points_in_scene.size() != n)) {
      return absl::InvalidArgumentError(absl::StrCat("objects[",
                                                     i,
                                                     "]: ",
                                                     n,
                                                     " points, ",
                                                     o.points_in_scene.size(),
                                                     " of them in the scene; need 4 and all"));
    }
    if (!o.scene_from_object.allFinite()) {
      return absl::InvalidArgumentError(absl::StrCat("objects[", i, "]: not finite"));
    }
    const double det = o.scene_from_object.determinant();
    if (std::abs(det) < 1e-12 * std::pow(o.scene_from_object.norm(), 4)) {
      return absl::FailedPreconditionError(
          absl::StrCat("objects[", i, "]: the collineation is singular"));
    }
  }
  return absl::OkStatus();
}

// Absolute orientation (Arun, Huang, Blostein 1987): to ~ R from + t.
Rigid3 Orient(const std::vector<Eigen::Vector3d>& from, const std::vector<Eigen::Vector3d>& to) {
  const double n = static_cast<double>(from.size());
  Eigen::Vector3d a = Eigen::Vector3d::Zero(), b = a;
  for (std::size_t i = 0; i < from.size(); ++i) a += from[i] / n, b += to[i] / n;
  Eigen::Matrix3d M = Eigen::Matrix3d::Zero();
  for (std::size_t i = 0; i < from.size(); ++i) M += (to[i] - b) * (from[i] - a).transpose();
  const Eigen::JacobiSVD<Eigen::Matrix3d> svd(M, Eigen::ComputeFullU | Eigen::ComputeFullV);
  Eigen::Matrix3d D = Eigen::Matrix3d::Identity();
  D(2, 2) = (svd.matrixU() * svd.matrixV().transpose()).determinant();
  const Eigen::Matrix3d R = svd.matrixU() * D * svd.matrixV().transpose();
  return {R, b - R * a};
}

// Affine part, rigid transform and stretch of U H, scaled so that its last entry is one.
struct RigidPart {
  Rigid3 pose;
  double stretch = 1.0;
};
absl::StatusOr<RigidPart> RigidPartOf(const Eigen::Matrix4d& U,
                                      const CollineatedObject& o,
                                      std::size_t index) {
  Eigen::Matrix4d B = U * o.scene_from_object;
  // At the middle of the object: a collineation that is not affine is linearised there.
  Eigen::Vector3d middle = Eigen::Vector3d::Zero();
  for (const auto& x : o.points_in_object) {
    middle += x / static_cast<double>(o.points_in_object.size());
  }
  Eigen::Matrix4d shift = Eigen::Matrix4d::Identity();
  shift.topRightCorner<3, 1>() = middle;
  B = B * shift;
  B /= B(3, 3);
  for (const auto& x : o.points_in_object) {
    if (!((B * (x - middle).eval().homogeneous()).w() > 0.0)) {
      return absl::FailedPreconditionError(
          absl::StrCat("objects[", index, "]: the plane at infinity passes through it"));
    }
  }
  // d(x / w) at the middle.
  const Eigen::Matrix3d A =
      B.topLeftCorner<3, 3>() - B.topRightCorner<3, 1>() * B.bottomLeftCorner<1, 3>();
  const auto polar = PolarDecomposition(A);
  if (!polar) {
    return absl::FailedPreconditionError(
        absl::StrCat("objects[", index, "]: the upgrade flattens or mirrors it"));
  }
  const Eigen::Vector3d s = Eigen::SelfAdjointEigenSolver<Eigen::Matrix3d>(polar->S).eigenvalues();
  const Eigen::Vector3d t = B.topRightCorner<3, 1>() / s.mean();
  return RigidPart{{polar->Q, t - polar->Q * middle}, s(2) / std::max(1e-12, s(0))};
}

absl::Status FillStretch(std::span<const CollineatedObject> objects, Decomposition* d) {
  d->stretch.clear();
  double squares = 0.0;
  int n = 0;
  for (std::size_t i = 0; i < objects.size(); ++i) {
    HOROPTER_ASSIGN_OR_RETURN(const RigidPart part,
                              RigidPartOf(d->metric_from_scene, objects[i], i));
    d->stretch.push_back(part.stretch);
    const auto scene = ScenePoints(objects[i]);
    for (std::size_t j = 0; j < scene.size(); ++j, ++n) {
      squares += (Euclidean(d->metric_from_scene * scene[j]) -
                  d->metric_from_object[i] * objects[i].points_in_object[j])
                     .squaredNorm();
    }
  }
  d->rms_m = std::sqrt(squares / n);
  return absl::OkStatus();
}

// The metric frame is the first object's.
void TieToFirst(Decomposition* d) {
  const Rigid3 inverse = d->metric_from_object[0].Inverse();
  Eigen::Matrix4d M = Eigen::Matrix4d::Identity();
  M.topLeftCorner<3, 3>() = inverse.R;
  M.topRightCorner<3, 1>() = inverse.t;
  d->metric_from_scene = M * d->metric_from_scene;
  for (Rigid3& T : d->metric_from_object) T = inverse * T;
}

// U with its columns at the scale of the scene: moves are relative to it.
Decomposition Moved(const Decomposition& d, const Eigen::VectorXd& step) {
  Decomposition out = d;
  // (I + D) U, D without its last entry: 15 freedoms of a collineation up to scale.
  Eigen::Matrix4d D = Eigen::Matrix4d::Zero();
  for (int k = 0; k < kUpgradeParameters; ++k) D(k / 4, k % 4) = step(k);
  out.metric_from_scene = (Eigen::Matrix4d::Identity() + D) * d.metric_from_scene;
  for (std::size_t i = 1; i < d.metric_from_object.size(); ++i) {
    const auto d6 = step.segment<6>(kUpgradeParameters + 6 * (static_cast<int>(i) - 1));
    out.metric_from_object[i] = Perturbed(d.metric_from_object[i], d6);
  }
  return out;
}

// Levenberg-Marquardt with numeric derivatives.
Decomposition Minimise(const Decomposition& start,
                       const std::function<Eigen::VectorXd(const Decomposition&)>& residuals) {
  const int n = kUpgradeParameters + 6 * (static_cast<int>(start.metric_from_object.size()) - 1);
  Decomposition best = start;
  Eigen::VectorXd r = residuals(best);
  double lambda = 1e-3;
  for (int iteration = 0; iteration < 40; ++iteration) {
    Eigen::MatrixXd J(r.size(), n);
    for (int k = 0; k < n; ++k) {
      Eigen::VectorXd d = Eigen::VectorXd::Zero(n);
      d(k) = kStep;
      J.col(k) = (residuals(Moved(best, d)) - r) / kStep;
    }
    const Eigen::MatrixXd A = J.transpose() * J;
    const Eigen::VectorXd b = J.transpose() * r;
    bool moved = false, settled = false;
    while (!moved && lambda < 1e8) {
      Eigen::MatrixXd damped = A;
      damped.diagonal() *= 1.0 + lambda;
      damped.diagonal().array() += 1e-15;
      const Eigen::VectorXd step = -damped.ldlt().solve(b);
      const Decomposition trial = Moved(best, step);
      const Eigen::VectorXd trial_r = residuals(trial);
      if (trial_r.allFinite() && trial_r.squaredNorm() < r.squaredNorm()) {
        moved = true;
        settled = r.squaredNorm() - trial_r.squaredNorm() < 1e-8 * r.squaredNorm();
        best = trial;
        r = trial_r;
        lambda = std::max(1e-12, 0.2 * lambda);
      } else {
        lambda *= 8.0;
      }
    }
    if (!moved || settled) break;
  }
  return best;
}

}  // namespace

std::optional<PolarFactors> PolarDecomposition(const Eigen::Matrix3d& A) {
  if (!A.allFinite() || !(A.determinant() > 1e-12 * std::pow(A.norm(), 3))) return std::nullopt;
  Eigen::Matrix3d Q = A;
  for (int i = 0; i < 30; ++i) {
    const Eigen::Matrix3d inverse_transposed = Q.inverse().transpose();
    const double g = std::sqrt(inverse_transposed.norm() / Q.norm());
    const Eigen::Matrix3d next = 0.5 * (g * Q + inverse_transposed / g);
    const bool settled = (next - Q).norm() < 1e-14 * next.norm();
    Q = next;
    if (settled) break;
  }
  const Eigen::Matrix3d S = Q.transpose() * A;
  return PolarFactors{Q, 0.5 * (S + S.transpose())};
}

absl::StatusOr<Decomposition> DecomposePerObject(std::span<const CollineatedObject> objects) {
  HOROPTER_RETURN_IF_ERROR(CheckObjects(objects));
  Decomposition out;
  out.metric_from_scene = objects[0].scene_from_object.inverse();
  for (std::size_t i = 0; i < objects.size(); ++i) {
    HOROPTER_ASSIGN_OR_RETURN(const RigidPart part,
                              RigidPartOf(out.metric_from_scene, objects[i], i));
    out.metric_from_object.push_back(part.pose);
  }
  HOROPTER_RETURN_IF_ERROR(FillStretch(objects, &out));
  return out;
}

absl::StatusOr<Decomposition> DecomposeCommon(std::span<const CollineatedObject> objects,
                                              const CommonUpgradeOptions& options) {
  HOROPTER_ASSIGN_OR_RETURN(Decomposition out, DecomposePerObject(objects));
  std::vector<std::vector<Eigen::Vector4d>> scene;
  for (const CollineatedObject& o : objects) scene.push_back(ScenePoints(o));
  for (int iteration = 0; iteration < options.iterations; ++iteration) {
    // Near the identity: the linear estimate wants coordinates of order one.
    std::vector<PointPair3> pairs;
    double size = 1e-9;
    for (std::size_t i = 0; i < objects.size(); ++i) {
      for (std::size_t j = 0; j < scene[i].size(); ++j) {
        PointPair3 pair;
        pair.from.head<3>() = Euclidean(out.metric_from_scene * scene[i][j]);
        pair.to.head<3>() = out.metric_from_object[i] * objects[i].points_in_object[j];
        size = std::max(size, pair.to.head<3>().norm());
        pairs.push_back(pair);
      }
    }
    for (PointPair3& pair : pairs) pair.from.w() = pair.to.w() = size;
    auto H = FitCollineation(pairs, {});
    if (!H) return absl::FailedPreconditionError("the objects' points leave the upgrade open");
    // x = size * (homogeneous / w).
    Eigen::Matrix4d D = Eigen::Vector4d(1, 1, 1, size).asDiagonal();
    const Eigen::Matrix4d step = D.inverse() * *H * D;
    out.metric_from_scene = step / step(3, 3) * out.metric_from_scene;
    for (std::size_t i = 0; i < objects.size(); ++i) {
      std::vector<Eigen::Vector3d> upgraded;
      for (const auto& X : scene[i]) upgraded.push_back(Euclidean(out.metric_from_scene * X));
      out.metric_from_object[i] = Orient(objects[i].points_in_object, upgraded);
    }
  }
  TieToFirst(&out);
  HOROPTER_RETURN_IF_ERROR(FillStretch(objects, &out));
  return out;
}

absl::StatusOr<Decomposition> RefineDecomposition(std::span<const CollineatedObject> objects,
                                                  const Decomposition& start) {
  HOROPTER_RETURN_IF_ERROR(CheckObjects(objects));
  std::vector<std::vector<Eigen::Vector4d>> scene;
  int n = 0;
  for (const CollineatedObject& o : objects) {
    scene.push_back(ScenePoints(o));
    n += static_cast<int>(scene.back().size());
  }
  Decomposition out = Minimise(start, [&](const Decomposition& d) {
    Eigen::VectorXd r(3 * n);
    int at = 0;
    for (std::size_t i = 0; i < objects.size(); ++i) {
      for (std::size_t j = 0; j < scene[i].size(); ++j, at += 3) {
        r.segment<3>(at) = Euclidean(d.metric_from_scene * scene[i][j]) -
                           d.metric_from_object[i] * objects[i].points_in_object[j];
      }
    }
    return r;
  });
  HOROPTER_RETURN_IF_ERROR(FillStretch(objects, &out));
  return out;
}

absl::StatusOr<Decomposition> RefineInImages(std::span<const CollineatedObject> objects,
                                             std::span<const std::optional<CameraMatrix>> cameras,
                                             std::span<const ObjectPointObservation> observations,
                                             const Decomposition& start) {
  HOROPTER_RETURN_IF_ERROR(CheckObjects(objects));
  Decomposition out = Minimise(start, [&](const Decomposition& d) {
    const Eigen::Matrix4d scene_from_metric = d.metric_from_scene.inverse();
    Eigen::VectorXd r = Eigen::VectorXd::Zero(2 * static_cast<Eigen::Index>(observations.size()));
    for (std::size_t k = 0; k < observations.size(); ++k) {
      const ObjectPointObservation& o = observations[k];
      if (!cameras[o.view]) continue;
      const Eigen::Vector3d x = d.metric_from_object[o.object] * o.point_in_object;
      const Eigen::Vector3d u = *cameras[o.view] * (scene_from_metric * x.homogeneous());
      r.segment<2>(2 * static_cast<Eigen::Index>(k)) = u.head<2>() / u.z() - o.pixel;
    }
    return r;
  });
  HOROPTER_RETURN_IF_ERROR(FillStretch(objects, &out));
  return out;
}

std::optional<MetricCamera> UpgradeCamera(const CameraMatrix& P,
                                          const Eigen::Matrix4d& metric_from_scene,
                                          int width,
                                          int height) {
  const auto factors = FactorCamera(P * metric_from_scene.inverse());
  if (!factors) return std::nullopt;
  const Eigen::Matrix3d& K = factors->K;
  MetricCamera out;
  out.camera_from_metric = factors->camera_from_scene;
  out.camera = {width, height, std::sqrt(K(0, 0) * K(1, 1)), K(0, 2), K(1, 2), 0.0};
  if (!(out.camera_from_metric.t.z() > 0.0)) return std::nullopt;
  return out;
}

}  // namespace horopter
