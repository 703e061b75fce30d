#include "tests/diagnose/camera_report.h"

#include <Eigen/Cholesky>
#include <Eigen/Eigenvalues>
#include <Eigen/Geometry>
#include <Eigen/LU>
#include <algorithm>
#include <cmath>
#include <functional>

namespace horopter {
namespace {

constexpr double kRecoveredPx = 2.0;
constexpr double kMissPx = 1e3;  // stands for a point behind the camera
constexpr int kMinObservations = 8;
constexpr double kVisible = 0.1;

using Views = std::vector<std::optional<EstimatedView>>;

// Residuals of all corners seen in registered views; NaN-free.
Eigen::VectorXd Residuals(const Views& views,
                          const std::vector<WorldCorner>& corners,
                          const Eigen::Matrix4d& H) {
  std::vector<double> r;
  for (const WorldCorner& corner : corners) {
    const Eigen::Vector4d x = H * corner.point_in_world.homogeneous();
    for (size_t v = 0; v < views.size(); ++v) {
      if (!views[v] || !corner.seen[v]) {
        continue;
      }
      const Eigen::Vector3d p =
          views[v]->camera_from_world.R * x.head<3>() + views[v]->camera_from_world.t * x.w();
      // A collineation is known up to sign, so only the ratio counts.
      const Eigen::Vector3d front = p.z() < 0.0 ? Eigen::Vector3d(-p) : p;
      Eigen::Vector2d d(kMissPx, kMissPx);
      if (front.z() > 1e-12) {
        d = (Project(views[v]->camera, front) - *corner.seen[v])
                .cwiseMax(-kMissPx)
                .cwiseMin(kMissPx);
      }
      r.push_back(d.x());
      r.push_back(d.y());
    }
  }
  return Eigen::Map<Eigen::VectorXd>(r.data(), static_cast<Eigen::Index>(r.size()));
}

// Levenberg-Marquardt with numeric derivatives over an update H(delta).
Eigen::Matrix4d Refine(
    const Views& views,
    const std::vector<WorldCorner>& corners,
    Eigen::Matrix4d H,
    int parameters,
    const std::function<Eigen::Matrix4d(const Eigen::Matrix4d&, const Eigen::VectorXd&)>& update) {
  constexpr double kStep = 1e-6;
  double lambda = 1e-3;
  Eigen::VectorXd r = Residuals(views, corners, H);
  for (int round = 0; round < 60; ++round) {
    Eigen::MatrixXd J(r.size(), parameters);
    for (int k = 0; k < parameters; ++k) {
      Eigen::VectorXd delta = Eigen::VectorXd::Zero(parameters);
      delta[k] = kStep;
      J.col(k) = (Residuals(views, corners, update(H, delta)) - r) / kStep;
    }
    Eigen::MatrixXd A = J.transpose() * J;
    A.diagonal() += lambda * (A.diagonal().array() + 1e-9).matrix();
    const Eigen::VectorXd delta = A.ldlt().solve(-(J.transpose() * r));
    if (!delta.allFinite()) {
      break;
    }
    const Eigen::Matrix4d next = update(H, delta);
    const Eigen::VectorXd next_r = Residuals(views, corners, next);
    if (next_r.squaredNorm() < r.squaredNorm()) {
      const bool done = r.squaredNorm() - next_r.squaredNorm() < 1e-9 * r.squaredNorm();
      H = next;
      r = next_r;
      lambda = std::max(lambda * 0.2, 1e-12);
      if (done) {
        break;
      }
    } else if ((lambda *= 8.0) > 1e9) {
      break;
    }
  }
  return H;
}

Eigen::Matrix4d UpdateSimilarity(const Eigen::Matrix4d& H, const Eigen::VectorXd& d) {
  Eigen::Matrix4d step = Eigen::Matrix4d::Identity();
  const Eigen::Vector3d w = d.head<3>();
  const double angle = w.norm();
  const Eigen::Matrix3d R = angle < 1e-15 ? Eigen::Matrix3d::Identity()
                                          : Eigen::AngleAxisd(angle, w / angle).toRotationMatrix();
  step.topLeftCorner<3, 3>() = std::exp(d[6]) * R;
  step.topRightCorner<3, 1>() = d.segment<3>(3);
  return step * H;
}

Eigen::Matrix4d UpdateCollineation(const Eigen::Matrix4d& H, const Eigen::VectorXd& d) {
  Eigen::Matrix4d next = H;
  for (int k = 0; k < 16; ++k) {
    next(k / 4, k % 4) += d[k] * H.norm();
  }
  return next / next.norm();
}

// Start from one view's pose and the ratio of the camera distances.
std::optional<Eigen::Matrix4d> StartSimilarity(const Views& views,
                                               const BopScene& scene,
                                               size_t anchor) {
  std::vector<double> ratios;
  const auto centre = [](const Rigid3& pose) {
    return Eigen::Vector3d(-(pose.R.transpose() * pose.t));
  };
  for (size_t i = 0; i < views.size(); ++i) {
    for (size_t j = i + 1; j < views.size(); ++j) {
      if (views[i] && views[j] && scene.images[i].has_pose && scene.images[j].has_pose) {
        const double truth =
            (centre(scene.images[i].camera_from_world) - centre(scene.images[j].camera_from_world))
                .norm();
        const double estimate =
            (centre(views[i]->camera_from_world) - centre(views[j]->camera_from_world)).norm();
        if (truth > 1e-9 && estimate > 1e-12) {
          ratios.push_back(estimate / truth);
        }
      }
    }
  }
  if (ratios.empty()) {
    return std::nullopt;
  }
  const double scale = Median(ratios);
  const Eigen::Matrix3d R =
      views[anchor]->camera_from_world.R.transpose() * scene.images[anchor].camera_from_world.R;
  Eigen::Matrix4d H = Eigen::Matrix4d::Identity();
  H.topLeftCorner<3, 3>() = scale * R;
  H.topRightCorner<3, 1>() = centre(views[anchor]->camera_from_world) -
                             scale * R * centre(scene.images[anchor].camera_from_world);
  return H;
}

// Linear collineation: x cross (P H X) = 0, 16 unknowns.
std::optional<Eigen::Matrix4d> StartCollineation(const Views& views,
                                                 const std::vector<WorldCorner>& corners) {
  Eigen::Vector3d mean = Eigen::Vector3d::Zero();
  for (const WorldCorner& corner : corners) {
    mean += corner.point_in_world / static_cast<double>(corners.size());
  }
  double spread = 0.0;
  for (const WorldCorner& corner : corners) {
    spread += (corner.point_in_world - mean).norm() / static_cast<double>(corners.size());
  }
  Eigen::Matrix4d normalise = Eigen::Matrix4d::Identity();
  normalise.topLeftCorner<3, 3>() /= spread;
  normalise.topRightCorner<3, 1>() = -mean / spread;
  Eigen::Matrix<double, 16, 16> moment = Eigen::Matrix<double, 16, 16>::Zero();
  for (const WorldCorner& corner : corners) {
    const Eigen::Vector4d X = normalise * corner.point_in_world.homogeneous();
    for (size_t v = 0; v < views.size(); ++v) {
      if (!views[v] || !corner.seen[v]) {
        continue;
      }
      const Eigen::Vector2d n =
          (*corner.seen[v] - Eigen::Vector2d(views[v]->camera.cx, views[v]->camera.cy)) /
          views[v]->camera.focal_px;
      Eigen::Matrix<double, 3, 4> P;
      P << views[v]->camera_from_world.R, views[v]->camera_from_world.t;
      P /= P.norm();
      for (int row = 0; row < 2; ++row) {
        const Eigen::RowVector4d left = n[row] * P.row(2) - P.row(row);
        Eigen::Matrix<double, 16, 1> a;
        for (int k = 0; k < 16; ++k) {
          a[k] = left[k / 4] * X[k % 4];
        }
        moment += a * a.transpose();
      }
    }
  }
  const Eigen::SelfAdjointEigenSolver<Eigen::Matrix<double, 16, 16>> solver(moment);
  if (solver.info() != Eigen::Success) {
    return std::nullopt;
  }
  Eigen::Matrix4d H;
  for (int k = 0; k < 16; ++k) {
    H(k / 4, k % 4) = solver.eigenvectors()(k, 0);
  }
  H = H * normalise;
  return H / H.norm();
}

double WorstView(const Views& views,
                 const std::vector<WorldCorner>& corners,
                 const Eigen::Matrix4d& H) {
  double worst = 0.0;
  for (size_t v = 0; v < views.size(); ++v) {
    if (!views[v]) {
      continue;
    }
    Views only(views.size());
    only[v] = views[v];
    const Eigen::VectorXd r = Residuals(only, corners, H);
    if (r.size() > 0) {
      worst = std::max(worst, std::sqrt(2.0 * r.squaredNorm() / static_cast<double>(r.size())));
    }
  }
  return worst;
}

}  // namespace

double Median(std::vector<double> values) {
  if (values.empty()) {
    return 0.0;
  }
  std::nth_element(
      values.begin(), values.begin() + static_cast<long>(values.size() / 2), values.end());
  return values[values.size() / 2];
}

std::vector<WorldCorner> TrueWorldCorners(const BopScene& scene, const TrueModels& models) {
  std::vector<WorldCorner> corners;
  const size_t instances = scene.images.empty() ? 0 : scene.images[0].instances.size();
  for (size_t i = 0; i < instances; ++i) {
    const BopImage* clearest = nullptr;
    for (const BopImage& image : scene.images) {
      if (!image.has_pose || image.instances[i].visib_fract < kVisible) continue;
      if (clearest != nullptr &&
          clearest->instances[i].visib_fract >= image.instances[i].visib_fract) {
        continue;
      }
      clearest = &image;
    }
    const auto it = models.find(scene.images[0].instances[i].obj_id);
    if (it == models.end() || clearest == nullptr) {
      continue;
    }
    for (size_t k = 0; k < it->second.vertices.size(); ++k) {
      WorldCorner corner;
      corner.instance = static_cast<int>(i);
      corner.vertex = static_cast<int>(k);
      corner.point_in_world = clearest->camera_from_world.Inverse() *
                              (clearest->instances[i].camera_from_object * it->second.vertices[k]);
      for (const BopImage& image : scene.images) {
        const Eigen::Vector3d p = image.camera_from_world * corner.point_in_world;
        const Eigen::Vector2d pixel = ProjectTrue(image, p);
        const bool inside = image.has_pose && p.z() > 0.0 && pixel.x() >= 0 && pixel.y() >= 0 &&
                            pixel.x() < image.camera.width && pixel.y() < image.camera.height;
        corner.seen.push_back(inside ? std::optional<Eigen::Vector2d>(pixel) : std::nullopt);
      }
      corners.push_back(std::move(corner));
    }
  }
  return corners;
}

// Two images with known poses in which enough corners are.
bool Measurable(const BopScene& scene, const std::vector<WorldCorner>& corners) {
  int images = 0;
  size_t observations = 0;
  for (size_t v = 0; v < scene.images.size(); ++v) {
    const auto seen = std::count_if(corners.begin(), corners.end(), [v](const WorldCorner& c) {
      return c.seen[v].has_value();
    });
    images += seen > 0 ? 1 : 0;
    observations += static_cast<size_t>(seen);
  }
  return images >= 2 && observations >= static_cast<size_t>(kMinObservations);
}

CameraFinding CompareCameras(const Views& views,
                             const BopScene& scene,
                             const std::vector<WorldCorner>& corners,
                             Freedom freedom) {
  CameraFinding finding;
  finding.measured = Measurable(scene, corners);
  for (const auto& view : views) {
    finding.registered += view ? 1 : 0;
  }
  if (finding.registered < 2 ||
      Residuals(views, corners, Eigen::Matrix4d::Identity()).size() < 2 * kMinObservations) {
    return finding;
  }
  std::optional<Eigen::Matrix4d> best;
  double best_cost = 1e300;
  const auto consider = [&](const Eigen::Matrix4d& H) {
    const double cost = Residuals(views, corners, H).squaredNorm();
    if (cost < best_cost) {
      best_cost = cost;
      best = H;
    }
  };
  for (size_t v = 0; v < views.size(); ++v) {
    if (views[v] && scene.images[v].has_pose) {
      if (const auto start = StartSimilarity(views, scene, v)) {
        consider(Refine(views, corners, *start, 7, UpdateSimilarity));
      }
    }
  }
  if (freedom == Freedom::kCollineation) {
    if (best) {
      consider(Refine(views, corners, *best / best->norm(), 16, UpdateCollineation));
    }
    if (const auto start = StartCollineation(views, corners)) {
      consider(Refine(views, corners, *start, 16, UpdateCollineation));
    }
  }
  if (!best) {
    return finding;
  }
  finding.aligned = true;
  finding.estimate_from_truth = *best;
  finding.worst_view_px = WorstView(views, corners, *best);
  finding.recovered =
      finding.registered == static_cast<int>(views.size()) && finding.worst_view_px <= kRecoveredPx;
  return finding;
}

std::optional<double> FocalError(const Views& views, const BopScene& scene) {
  std::vector<double> errors;
  for (size_t v = 0; v < views.size(); ++v) {
    if (views[v]) {
      errors.push_back(std::abs(views[v]->camera.focal_px / scene.images[v].camera.focal_px - 1.0));
    }
  }
  return errors.empty() ? std::nullopt : std::optional<double>(Median(errors));
}

double DistanceMm(const CameraFinding& alignment,
                  const Eigen::Vector3d& estimate,
                  const Eigen::Vector3d& truth) {
  const Eigen::Vector4d back = alignment.estimate_from_truth.inverse() * estimate.homogeneous();
  return 1e3 * (back.head<3>() / back.w() - truth).norm();
}

}  // namespace horopter
