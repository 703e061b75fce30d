#include "server/vision/euclidean/findings.h"

#include <Eigen/Eigenvalues>
#include <algorithm>
#include <cmath>
#include <map>

#include "absl/strings/str_format.h"
#include "server/vision/euclidean/robust_scatter.h"
#include "server/vision/geometry/symmetric_eigen.h"

namespace horopter {
namespace {

constexpr double kUnknownLimits = 18.0;  // deviation of what nothing determines, in limits of it

// Covariance of the perturbation of a_from_object at the object's centre, a: camera `view`.
Matrix6d InCamera(const SceneBundle& bundle, const SceneCovariance& c, int view, int object) {
  const Rigid3 &camera = bundle.views[view].camera_from_scene,
               &pose = bundle.objects[object].scene_from_object;
  const Rigid3 at_center = {Eigen::Matrix3d::Identity(), bundle.objects[object].model->center};
  const Matrix6d by_camera = FirstInProduct(camera, pose * at_center);
  const Matrix6d by_object = SecondInProduct(camera) * FirstInProduct(pose, at_center);
  const int v = c.layout.view[view], k = c.layout.object[object];
  const Matrix6d cross = by_camera * c.matrix.block<6, 6>(v, k) * by_object.transpose();
  return by_camera * c.matrix.block<6, 6>(v, v) * by_camera.transpose() +
         by_object * c.matrix.block<6, 6>(k, k) * by_object.transpose() + cross + cross.transpose();
}

// ... of other_from_object, about the other's axes.
Matrix6d InObject(const SceneBundle& bundle, const SceneCovariance& c, int other, int object) {
  const Rigid3 other_from_scene = bundle.objects[other].scene_from_object.Inverse();
  const Rigid3 at_center = {Eigen::Matrix3d::Identity(), bundle.objects[object].model->center};
  const Rigid3& pose = bundle.objects[object].scene_from_object;
  const Matrix6d by_other = FirstInProduct(other_from_scene, pose * at_center) *
                            InInverse(bundle.objects[other].scene_from_object);
  const Matrix6d by_object = SecondInProduct(other_from_scene) * FirstInProduct(pose, at_center);
  const int o = c.layout.object[other], k = c.layout.object[object];
  const Matrix6d cross = by_other * c.matrix.block<6, 6>(o, k) * by_object.transpose();
  return by_other * c.matrix.block<6, 6>(o, o) * by_other.transpose() +
         by_object * c.matrix.block<6, 6>(k, k) * by_object.transpose() + cross + cross.transpose();
}

Finding Weak(FindingKind kind, int object, const Eigen::Vector3d& direction, double sigma) {
  Finding f;
  f.kind = kind;
  f.object = object;
  f.direction = direction;
  f.value = sigma;
  const char* what =
      kind == FindingKind::kTurnUndetermined ? "rotation about" : "translation along";
  f.detail = absl::StrFormat("object %d: %s (%.2f, %.2f, %.2f) of its frame is known to %.3g %s",
                             object,
                             what,
                             direction.x(),
                             direction.y(),
                             direction.z(),
                             sigma,
                             kind == FindingKind::kTurnUndetermined ? "rad" : "m");
  return f;
}

// Information of one object's edges about its pose in the cameras, these fixed: turns and shifts of
// its centre in units of `options`' limits. Only of points that agree with the answer, and without
// the edge of one view that says most about the direction known least: one wrong association may
// pin a bar that no image ends.
Matrix6d AgreedInformation(const SceneBundle& bundle, int object, const FindingOptions& options) {
  const AdjustedObject& o = bundle.objects[object];
  const Eigen::Vector3d center = o.scene_from_object.R * o.model->center;
  const double shift = options.shift_diameters * o.model->model.diameter_m;
  std::map<std::pair<int, int>, Matrix6d> edges;
  Matrix6d all = Matrix6d::Zero();
  EdgeRow row;
  for (const EdgeObservation& e : bundle.edges) {
    if (e.object != object || std::abs(e.residual_px) > options.agreed_px ||
        !LinearizeEdge(bundle, e, &row)) {
      continue;
    }
    const Eigen::Vector3d by_shift = row.J.segment<3>(kViewParameters + 3);
    Vector6d J;
    J << options.turn_rad * (row.J.segment<3>(kViewParameters) - center.cross(by_shift)),
        shift * by_shift;
    const double w = RobustWeight(bundle.cauchy_sigmas, row.residual * row.residual);
    const Matrix6d JtJ = w * J * J.transpose();
    all += JtJ;
    edges.try_emplace({e.view, e.edge}, Matrix6d::Zero()).first->second += JtJ;
  }
  const Vector6d weakest = SymmetricEigen<6>(all).eigenvectors().col(0);
  Matrix6d strongest = Matrix6d::Zero();
  for (const auto& [key, information] : edges) {
    if (weakest.dot(information * weakest) > weakest.dot(strongest * weakest)) {
      strongest = information;
    }
  }
  return all - strongest;
}

// Directions that the covariance takes for known by one edge in one view alone.
void AddLoneDirections(const SceneBundle& bundle,
                       int object,
                       const FindingOptions& options,
                       std::vector<Finding>* out) {
  const auto named = [&](FindingKind kind) {
    return std::any_of(out->begin(), out->end(), [&](const Finding& f) {
      return f.object == object && f.kind == kind;
    });
  };
  const AdjustedObject& o = bundle.objects[object];
  const double shift = options.shift_diameters * o.model->model.diameter_m;
  const SymmetricEigen<6> eigen(AgreedInformation(bundle, object, options));
  for (int i = 0; i < 6 && eigen.eigenvalues()(i) < 1.0; ++i) {
    const Vector6d d = eigen.eigenvectors().col(i);
    const double sigma =
        std::min(kUnknownLimits, 1.0 / std::sqrt(std::max(1e-12, eigen.eigenvalues()(i))));
    const bool turns = d.head<3>().norm() > d.tail<3>().norm();
    const FindingKind kind =
        turns ? FindingKind::kTurnUndetermined : FindingKind::kShiftUndetermined;
    if (named(kind)) continue;
    const Eigen::Vector3d direction = turns ? d.head<3>() : d.tail<3>();
    out->push_back(Weak(kind,
                        object,
                        (o.scene_from_object.R.transpose() * direction).normalized(),
                        sigma * (turns ? options.turn_rad : shift)));
  }
}

double MedianOf(std::vector<double> values) {
  const auto middle = values.begin() + static_cast<long>(values.size() / 2);
  std::nth_element(values.begin(), middle, values.end());
  return *middle;
}

// Of the edge points found, working px; an object of which nothing is found fits nothing.
std::vector<double> ScatterOfObjects(const SceneBundle& bundle) {
  std::vector<std::vector<double>> residuals(bundle.objects.size());
  for (const EdgeObservation& o : bundle.edges) {
    residuals[o.object].push_back(std::abs(o.residual_px));
  }
  std::vector<double> scatter;
  for (auto& r : residuals) {
    scatter.push_back(r.empty() ? 1e9 : kNormalFromMad * MedianOf(std::move(r)));
  }
  return scatter;
}

// Share of an object's visible samples that have an edge point within found_px: median over the
// views that show enough of it; 1 without such a view.
std::vector<double> FoundShares(const SceneBundle& bundle,
                                std::span<const VisibleSamples> visible,
                                const MisfitAcceptance& acceptance) {
  std::map<std::pair<int, int>, double> found;
  for (const EdgeObservation& o : bundle.edges) {
    found[{o.object, o.view}] += std::abs(o.residual_px) < acceptance.found_px ? 1.0 : 0.0;
  }
  std::vector<std::vector<double>> shares(bundle.objects.size());
  for (const VisibleSamples& seen : visible) {
    if (static_cast<int>(seen.samples.size()) < acceptance.min_samples) continue;
    shares[seen.object].push_back(found[{seen.object, seen.view}] /
                                  static_cast<double>(seen.samples.size()));
  }
  std::vector<double> out;
  for (auto& s : shares) out.push_back(s.empty() ? 1.0 : MedianOf(std::move(s)));
  return out;
}

// The camera that knows an object best, -1: none, and the covariance of the object in it.
struct BestView {
  int view = -1;
  Matrix6d covariance = Matrix6d::Zero();
};

// A camera that sees little is itself uncertain.
BestView FindBestView(const SceneBundle& bundle, const SceneCovariance& covariance, int k) {
  BestView best;
  for (int v = 0; v < static_cast<int>(bundle.views.size()); ++v) {
    if (!bundle.views[v].known) continue;
    const Matrix6d in_view = InCamera(bundle, covariance, v, k);
    if (best.view >= 0 &&
        in_view.topLeftCorner<3, 3>().trace() >= best.covariance.topLeftCorner<3, 3>().trace()) {
      continue;
    }
    best = {v, in_view};
  }
  return best;
}

// pose: camera_from_object, C: its covariance.
void AddOpenTurns(const Rigid3& pose,
                  const Matrix6d& C,
                  int k,
                  const FindingOptions& options,
                  std::vector<Finding>* out) {
  const Eigen::SelfAdjointEigenSolver<Eigen::Matrix3d> turn(C.topLeftCorner<3, 3>());
  for (int i = 2; i >= 0; --i) {
    const double sigma = std::sqrt(std::max(0.0, turn.eigenvalues()(i)));
    if (sigma < options.turn_rad) break;
    out->push_back(Weak(
        FindingKind::kTurnUndetermined, k, pose.R.transpose() * turn.eigenvectors().col(i), sigma));
  }
}

// Across the line of sight, or in another object's frame: depth alone is the focal length's.
void AddOpenShift(const SceneBundle& bundle,
                  const SceneCovariance& covariance,
                  const Rigid3& pose,
                  const Matrix6d& C,
                  int k,
                  const FindingOptions& options,
                  std::vector<Finding>* out) {
  const double limit = options.shift_diameters * bundle.objects[k].model->model.diameter_m;
  Eigen::Matrix3d shift;
  Eigen::Matrix3d object_from_frame;
  // From a shift to the way in space that goes with it.
  Eigen::Matrix3d in_space = Eigen::Matrix3d::Identity();
  if (bundle.objects.size() > 1) {
    const int other = k == 0 ? 1 : 0;
    shift = InObject(bundle, covariance, other, k).bottomRightCorner<3, 3>();
    object_from_frame = bundle.objects[k].scene_from_object.R.transpose() *
                        bundle.objects[other].scene_from_object.R;
  } else {
    const Eigen::Vector3d sight = (pose * bundle.objects[k].model->center).normalized();
    const Eigen::Matrix3d across = Eigen::Matrix3d::Identity() - sight * sight.transpose();
    in_space = C.bottomRightCorner<3, 3>();
    shift = across * in_space * across;
    object_from_frame = pose.R.transpose();
  }
  const Eigen::SelfAdjointEigenSolver<Eigen::Matrix3d> eigen(shift);
  const double sigma = std::sqrt(std::max(0.0, eigen.eigenvalues()(2)));
  if (sigma > limit) {
    out->push_back(Weak(FindingKind::kShiftUndetermined,
                        k,
                        (object_from_frame * in_space * eigen.eigenvectors().col(2)).normalized(),
                        sigma));
  }
}

void AddOpenFocalLengths(const SceneBundle& bundle,
                         const SceneCovariance& covariance,
                         const FindingOptions& options,
                         std::vector<Finding>* out) {
  for (int v = 0; v < static_cast<int>(bundle.views.size()); ++v) {
    if (!bundle.views[v].known) continue;
    const int at = covariance.layout.view[v] + 6;
    const double sigma = std::sqrt(std::max(0.0, covariance.matrix(at, at)));
    if (sigma <= options.focal_log) continue;
    Finding f;
    f.kind = FindingKind::kFocalAndDepth;
    f.view = v;
    f.value = sigma;
    f.detail =
        absl::StrFormat("image %d: focal length and depth compensate each other, known to %.1f %%",
                        v,
                        100.0 * sigma);
    out->push_back(f);
  }
}

}  // namespace

std::vector<Finding> FindWeakDirections(const SceneBundle& bundle,
                                        const SceneCovariance& covariance,
                                        const FindingOptions& options) {
  std::vector<Finding> out;
  if (covariance.matrix.size() == 0) return out;
  for (int k = 0; k < static_cast<int>(bundle.objects.size()); ++k) {
    const auto [view, C] = FindBestView(bundle, covariance, k);
    if (view < 0) break;
    const Rigid3 pose = bundle.views[view].camera_from_scene * bundle.objects[k].scene_from_object;
    AddOpenTurns(pose, C, k, options, &out);
    AddOpenShift(bundle, covariance, pose, C, k, options, &out);
    AddLoneDirections(bundle, k, options, &out);
  }
  AddOpenFocalLengths(bundle, covariance, options, &out);
  return out;
}

std::vector<ScaleSource> EstimateScales(const SceneBundle& bundle,
                                        const NoiseOptions& noise,
                                        const FindingOptions& options,
                                        int threads) {
  const int n = static_cast<int>(bundle.objects.size());
  std::vector<ScaleSource> out(n);
  for (int k = 0; k < n; ++k) out[k].index = k;
  if (n < 2) return out;
  SceneBundle scaled = bundle;
  SceneBundleOptions adjust = options.scale_bundle;
  adjust.threads = threads;
  if (!AdjustBundle(adjust, &scaled)) return out;
  const SceneCovariance c = ComputeSceneCovariance(scaled, noise, /*scales_fixed=*/false);
  if (c.matrix.size() == 0) return out;
  const auto sigma_between = [&](int i, int j) {
    const int a = c.layout.object[i] + 6, b = c.layout.object[j] + 6;
    return std::sqrt(std::max(0.0, c.matrix(a, a) + c.matrix(b, b) - 2.0 * c.matrix(a, b)));
  };
  const auto agree = [&](int i, int j) {
    const double off = std::abs(scaled.log_scale[i] - scaled.log_scale[j]);
    return off < std::max(options.scale_log, options.scale_sigmas * sigma_between(i, j));
  };
  int base = 0, most = -1;
  for (int i = 0; i < n; ++i) {
    int agreeing = 0;
    for (int j = 0; j < n; ++j) agreeing += agree(i, j);
    if (agreeing > most) {
      most = agreeing;
      base = i;
    }
  }
  for (int k = 0; k < n; ++k) {
    out[k].log_ratio = scaled.log_scale[k] - scaled.log_scale[base];
    out[k].log_sigma = k == base ? 0.0 : sigma_between(k, base);
    // Two that disagree: nobody says which is right.
    out[k].agrees = agree(k, base) && most > 1;
  }
  return out;
}

std::vector<int> FindMisfits(const SceneBundle& bundle,
                             std::span<const VisibleSamples> visible,
                             const MisfitAcceptance& acceptance) {
  const int n = static_cast<int>(bundle.objects.size());
  std::vector<int> out;
  if (n < 3) return out;
  const std::vector<double> scatter = ScatterOfObjects(bundle);
  const std::vector<double> found = FoundShares(bundle, visible, acceptance);
  for (int k = 0; k < n; ++k) {
    std::vector<double> other_scatter, other_found;
    for (int j = 0; j < n; ++j) {
      if (j == k) continue;
      other_scatter.push_back(scatter[j]);
      other_found.push_back(found[j]);
    }
    const double typical = MedianOf(std::move(other_scatter));
    if (scatter[k] > std::max(acceptance.least_px, acceptance.factor * typical) ||
        found[k] < acceptance.least_found * MedianOf(std::move(other_found))) {
      out.push_back(k);
    }
  }
  return out;
}

}  // namespace horopter
