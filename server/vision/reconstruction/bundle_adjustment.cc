#include "server/vision/reconstruction/bundle_adjustment.h"

#include <ceres/ceres.h>
#include <ceres/rotation.h>

#include <Eigen/Dense>
#include <algorithm>
#include <cmath>
#include <memory>

namespace horopter {
namespace {

// Parameters of a view: log f, k1 | rotation vector w (R = R0 exp(w)) | centre.
struct ViewParameters {
  double intrinsics[2];
  double rotation[3];
  double center[3];
};

struct ReprojectionError {
  ReprojectionError(const Eigen::Vector2d& pixel, const ImageSize& size, const Eigen::Matrix3d& R0)
      : pixel_(pixel), cx_(0.5 * (size.width - 1)), cy_(0.5 * (size.height - 1)), R0_(R0) {}

  template <typename T>
  bool operator()(
      const T* intrinsics, const T* rotation, const T* center, const T* point, T* residual) const {
    const T d[3] = {point[0] - center[0], point[1] - center[1], point[2] - center[2]};
    T q[3];
    ceres::AngleAxisRotatePoint(rotation, d, q);
    T c[3];
    for (int r = 0; r < 3; ++r) c[r] = R0_(r, 0) * q[0] + R0_(r, 1) * q[1] + R0_(r, 2) * q[2];
    if (c[2] < T(1e-6)) return false;
    const T x = c[0] / c[2], y = c[1] / c[2];
    const T scale = exp(intrinsics[0]) * (T(1.0) + intrinsics[1] * (x * x + y * y));
    residual[0] = scale * x + cx_ - pixel_.x();
    residual[1] = scale * y + cy_ - pixel_.y();
    return true;
  }

  Eigen::Vector2d pixel_;
  double cx_, cy_;
  Eigen::Matrix3d R0_;
};

struct Prior {
  template <typename T>
  bool operator()(const T* intrinsics, T* residual) const {
    residual[0] = (intrinsics[0] - log_focal) / log_sigma;
    residual[1] = intrinsics[1] / k1_sigma;
    return true;
  }
  double log_focal, log_sigma, k1_sigma;
};

struct Parameters {
  std::vector<ViewParameters> views;
  std::vector<Eigen::Vector3d> points;
};

Parameters ReadParameters(const Bundle& bundle) {
  Parameters p;
  for (const BundleView& v : bundle.views) {
    const Eigen::Vector3d c = v.camera_from_world.Inverse().t;
    p.views.push_back({{std::log(v.focal_px), v.k1}, {0, 0, 0}, {c.x(), c.y(), c.z()}});
  }
  for (const BundlePoint& point : bundle.points) p.points.push_back(point.point_in_world);
  return p;
}

void BuildProblem(const BundleOptions& options,
                  const Bundle& bundle,
                  Parameters* p,
                  ceres::Problem* problem) {
  // Owned by the problem once used.
  ceres::LossFunction* loss = nullptr;
  ceres::Manifold* plane_manifold = nullptr;
  for (size_t k = 0; k < bundle.points.size(); ++k) {
    const BundlePoint& point = bundle.points[k];
    for (const TrackObservation& o : point.track.observations) {
      ViewParameters& v = p->views[o.view];
      if (loss == nullptr) loss = new ceres::CauchyLoss(options.loss_px);
      problem->AddResidualBlock(
          new ceres::AutoDiffCostFunction<ReprojectionError, 2, 2, 3, 3, 3>(new ReprojectionError(
              o.point, bundle.views[o.view].size, bundle.views[o.view].camera_from_world.R)),
          loss,
          v.intrinsics,
          v.rotation,
          v.center,
          p->points[k].data());
    }
    if (point.on_plane && !point.track.observations.empty()) {
      if (plane_manifold == nullptr) plane_manifold = new ceres::SubsetManifold(3, {2});
      problem->SetManifold(p->points[k].data(), plane_manifold);
    }
  }
  for (size_t i = 0; i < bundle.views.size(); ++i) {
    const double start = std::log(options.focal_prior_widths * bundle.views[i].size.width);
    problem->AddResidualBlock(new ceres::AutoDiffCostFunction<Prior, 2, 2>(new Prior{
                                  start, options.focal_prior_log_sigma, options.k1_sigma}),
                              nullptr,
                              p->views[i].intrinsics);
  }
  if (problem->HasParameterBlock(p->views[0].center)) {
    problem->SetParameterBlockConstant(p->views[0].center);
    problem->SetManifold(p->views[0].rotation, new ceres::SubsetManifold(3, {2}));
  }
}

void WriteParameters(const Parameters& p, Bundle* bundle) {
  for (size_t i = 0; i < bundle->views.size(); ++i) {
    BundleView& v = bundle->views[i];
    v.focal_px = std::exp(p.views[i].intrinsics[0]);
    v.k1 = p.views[i].intrinsics[1];
    Eigen::Matrix3d dR;
    ceres::AngleAxisToRotationMatrix(p.views[i].rotation, ceres::ColumnMajorAdapter3x3(dR.data()));
    v.camera_from_world.R = v.camera_from_world.R * dR;
    v.camera_from_world.t =
        -(v.camera_from_world.R * Eigen::Map<const Eigen::Vector3d>(p.views[i].center));
  }
  for (size_t k = 0; k < bundle->points.size(); ++k) bundle->points[k].point_in_world = p.points[k];
}

bool AllFinite(const Parameters& p) {
  for (const ViewParameters& v : p.views) {
    for (double x : {v.intrinsics[0],
                     v.intrinsics[1],
                     v.rotation[0],
                     v.rotation[1],
                     v.rotation[2],
                     v.center[0],
                     v.center[1],
                     v.center[2]}) {
      if (!std::isfinite(x)) return false;
    }
  }
  return std::all_of(p.points.begin(), p.points.end(), [](const auto& x) { return x.allFinite(); });
}

// Posterior deviation of every log f, scaled by the robust residual variance; negative: not
// computable.
std::vector<double> FocalDeviations(ceres::Problem* problem, const Parameters& p, double cost) {
  std::vector<double> sigma(p.views.size(), -1.0);
  ceres::Covariance::Options options;
  options.algorithm_type = ceres::SPARSE_QR;
  options.num_threads = 1;
  ceres::Covariance covariance(options);
  std::vector<std::pair<const double*, const double*>> blocks;
  for (const ViewParameters& v : p.views) blocks.emplace_back(v.intrinsics, v.intrinsics);
  if (!covariance.Compute(blocks, problem)) return sigma;
  const double freedom = std::max(1, problem->NumResiduals() - problem->NumParameters());
  const double variance = std::max(2.0 * cost / freedom, 0.01);
  for (size_t i = 0; i < p.views.size(); ++i) {
    double c[4];
    if (covariance.GetCovarianceBlock(p.views[i].intrinsics, p.views[i].intrinsics, c) &&
        c[0] >= 0.0) {
      sigma[i] = std::sqrt(c[0] * variance);
    }
  }
  return sigma;
}

}  // namespace

BundleSummary AdjustBundle(const BundleOptions& options, Bundle* bundle) {
  BundleSummary summary;
  if (bundle->views.empty()) return summary;
  Parameters p = ReadParameters(*bundle);
  if (!AllFinite(p)) return summary;
  ceres::Problem problem;
  BuildProblem(options, *bundle, &p, &problem);
  ceres::Solver::Options solver;
  solver.linear_solver_type = ceres::DENSE_SCHUR;
  solver.max_num_iterations = options.max_iterations;
  solver.num_threads = 1;  // same sums in the same order on every run
  solver.logging_type = ceres::SILENT;
  solver.function_tolerance = 1e-7;
  ceres::Solver::Summary report;
  ceres::Solve(solver, &problem, &report);
  if (!report.IsSolutionUsable() || !AllFinite(p)) return summary;
  summary.usable = true;
  summary.cost = report.final_cost;
  std::vector<double> sigma;
  if (options.covariance) sigma = FocalDeviations(&problem, p, report.final_cost);
  WriteParameters(p, bundle);
  for (size_t i = 0; i < sigma.size(); ++i) bundle->views[i].focal_log_sigma = sigma[i];
  return summary;
}

std::optional<Eigen::Vector2d> ProjectInto(const BundleView& view,
                                           const Eigen::Vector3d& point_in_world) {
  const Eigen::Vector3d c = view.camera_from_world * point_in_world;
  if (!(c.z() > 1e-6)) return std::nullopt;
  PinholeCamera camera = CenteredCamera(view.size.width, view.size.height, view.focal_px);
  camera.k1 = view.k1;
  return Project(camera, c);
}

double WorstReprojection(const Bundle& bundle, const BundlePoint& point) {
  double worst = 0.0;
  for (const TrackObservation& o : point.track.observations) {
    const auto projected = ProjectInto(bundle.views[o.view], point.point_in_world);
    if (!projected) return 1e9;
    const double e = (*projected - o.point).norm();
    worst = e > worst ? e : worst;
    if (!std::isfinite(e)) return 1e9;
  }
  return worst;
}

namespace {

// Unit ray of a pixel in the world, radial distortion undone by fixed-point iteration.
Eigen::Vector3d WorldRay(const BundleView& view, const Eigen::Vector2d& pixel) {
  const Eigen::Vector2d d((pixel.x() - 0.5 * (view.size.width - 1)) / view.focal_px,
                          (pixel.y() - 0.5 * (view.size.height - 1)) / view.focal_px);
  Eigen::Vector2d n = d;
  for (int i = 0; i < 5; ++i) n = d / std::max(0.2, 1.0 + view.k1 * n.squaredNorm());
  return (view.camera_from_world.R.transpose() * Eigen::Vector3d(n.x(), n.y(), 1.0)).normalized();
}

}  // namespace

std::optional<Eigen::Vector3d> PointOnPlane(const BundleView& view, const Eigen::Vector2d& pixel) {
  const Eigen::Vector3d center = view.camera_from_world.Inverse().t;
  const Eigen::Vector3d ray = WorldRay(view, pixel);
  const double s = -center.z() / ray.z();
  if (!std::isfinite(s) || s <= 0.0) return std::nullopt;
  Eigen::Vector3d p = center + s * ray;
  p.z() = 0.0;
  return p;
}

std::optional<Eigen::Vector3d> Triangulate(const Bundle& bundle,
                                           const Track& track,
                                           double min_angle_rad) {
  Eigen::Matrix3d A = Eigen::Matrix3d::Zero();
  Eigen::Vector3d b = Eigen::Vector3d::Zero();
  std::vector<Eigen::Vector3d> rays;
  for (const TrackObservation& o : track.observations) {
    const BundleView& view = bundle.views[o.view];
    const Eigen::Vector3d ray = WorldRay(view, o.point);
    const Eigen::Matrix3d across = Eigen::Matrix3d::Identity() - ray * ray.transpose();
    A += across;
    b += across * view.camera_from_world.Inverse().t;
    rays.push_back(ray);
  }
  double widest = 0.0;
  for (size_t i = 0; i < rays.size(); ++i) {
    for (size_t j = i + 1; j < rays.size(); ++j) {
      widest = std::max(widest, rays[i].cross(rays[j]).norm());
    }
  }
  if (widest < std::sin(min_angle_rad)) return std::nullopt;
  Eigen::Vector3d x = A.ldlt().solve(b);
  if (!x.allFinite()) return std::nullopt;
  // Two Gauss-Newton steps on the reprojection error, numeric derivatives.
  for (int iteration = 0; iteration < 3; ++iteration) {
    Eigen::Matrix3d N = Eigen::Matrix3d::Zero();
    Eigen::Vector3d g = Eigen::Vector3d::Zero();
    for (const TrackObservation& o : track.observations) {
      const BundleView& view = bundle.views[o.view];
      const auto p = ProjectInto(view, x);
      if (!p) return std::nullopt;
      Eigen::Matrix<double, 2, 3> J;
      constexpr double kStep = 1e-6;
      for (int k = 0; k < 3; ++k) {
        const auto q = ProjectInto(view, x + kStep * Eigen::Vector3d::Unit(k));
        if (!q) return std::nullopt;
        J.col(k) = (*q - *p) / kStep;
      }
      N += J.transpose() * J;
      g += J.transpose() * (o.point - *p);
    }
    const Eigen::Vector3d step = N.ldlt().solve(g);
    if (!step.allFinite()) return std::nullopt;
    x += step;
  }
  if (!x.allFinite()) return std::nullopt;
  return x;
}

}  // namespace horopter
