#include "server/vision/reconstruction/calibrated_bundle.h"

#include <ceres/ceres.h>
#include <ceres/rotation.h>

#include <Eigen/Dense>
#include <algorithm>
#include <array>
#include <cmath>
#include <map>

#include "server/vision/reconstruction/bundle_manifolds.h"

namespace horopter {
namespace {

// View block: rotation increment w (R <- exp(w) R0), translation, log f, cx, cy, k1.
constexpr int kView = 10;
constexpr int kLogFocal = 6;
constexpr double kMaxTrustRegion = 1e7;  // keeps the damping that a free gauge needs

template <typename T>
Eigen::Matrix<T, 3, 1> IntoCamera(const T* view, const Eigen::Matrix3d& R0, const T* X) {
  const Eigen::Matrix<T, 3, 1> turned = R0.cast<T>() * Eigen::Map<const Eigen::Matrix<T, 3, 1>>(X);
  Eigen::Matrix<T, 3, 1> out;
  ceres::AngleAxisRotatePoint(view, turned.data(), out.data());
  for (int i = 0; i < 3; ++i) out[i] += view[3 + i] * X[3];
  return out;
}

struct PointCost {
  PointObservation o;
  Eigen::Matrix3d R0;

  template <typename T>
  bool operator()(const T* view, const T* X, T* residual) const {
    const Eigen::Matrix<T, 3, 1> c = IntoCamera(view, R0, X);
    if (c[2] == T(0)) return false;
    const T x = c[0] / c[2], y = c[1] / c[2];
    const T s = exp(view[kLogFocal]) * (T(1) + view[9] * (x * x + y * y));
    residual[0] = (s * x + view[7] - T(o.pixel.x())) / T(o.sigma_px);
    residual[1] = (s * y + view[8] - T(o.pixel.y())) / T(o.sigma_px);
    return true;
  }
};

struct LineCost {
  LineObservation o;
  Eigen::Matrix3d R0;

  template <typename T>
  bool operator()(const T* view, const T* span, T* residual) const {
    const Eigen::Matrix<T, 3, 1> p = IntoCamera(view, R0, span);
    const Eigen::Matrix<T, 3, 1> q = IntoCamera(view, R0, span + 4);
    const Eigen::Matrix<T, 3, 1> l = p.cross(q);
    const T f = exp(view[kLogFocal]);
    const T norm = sqrt(l[0] * l[0] + l[1] * l[1]);
    if (norm == T(0)) return false;
    for (int e = 0; e < 2; ++e) {
      const Eigen::Vector2d& end = e == 0 ? o.start : o.end;
      const T dx = (T(end.x()) - view[7]) / f, dy = (T(end.y()) - view[8]) / f;
      T x = dx, y = dy;
      for (int i = 0; i < 2; ++i) {  // the ends are undistorted: the projected line is straight
        const T scale = T(1) + view[9] * (x * x + y * y);
        x = dx / scale;
        y = dy / scale;
      }
      residual[e] = f * (l[0] * x + l[1] * y + l[2]) / (norm * T(o.sigma_px));
    }
    return true;
  }
};

struct IntrinsicsPrior {
  std::array<double, 4> mean, sigma;  // log f, cx, cy, k1

  template <typename T>
  bool operator()(const T* view, T* residual) const {
    for (int i = 0; i < 4; ++i) residual[i] = (view[kLogFocal + i] - T(mean[i])) / T(sigma[i]);
    return true;
  }
};

// R = exp(w) R0 about the given rotation, and the centre -R^T t about the given one.
struct PosePrior {
  Eigen::Matrix3d R0;
  Rigid3 camera_from_world;
  double rotation_sigma, position_sigma;

  template <typename T>
  bool operator()(const T* view, T* residual) const {
    T R[9];
    ceres::AngleAxisToRotationMatrix(view, ceres::ColumnMajorAdapter3x3(R));
    const Eigen::Matrix<T, 3, 3> full = Eigen::Map<Eigen::Matrix<T, 3, 3>>(R) * R0.cast<T>();
    const Eigen::Matrix<T, 3, 3> off = full * camera_from_world.R.transpose().cast<T>();
    T w[3];
    ceres::RotationMatrixToAngleAxis(ceres::ColumnMajorAdapter3x3(off.data()), w);
    const Eigen::Matrix<T, 3, 1> center =
        -(full.transpose() * Eigen::Map<const Eigen::Matrix<T, 3, 1>>(view + 3));
    const Eigen::Vector3d given = camera_from_world.Inverse().t;
    for (int i = 0; i < 3; ++i) {
      residual[i] = w[i] / T(rotation_sigma);
      residual[3 + i] = (center[i] - T(given[i])) / T(position_sigma);
    }
    return true;
  }
};

struct Parameters {
  std::vector<std::array<double, kView>> views;
  std::vector<std::array<double, 4>> points;
  std::vector<std::array<double, 8>> lines;
};

Parameters ReadScene(const CalibratedScene& scene) {
  Parameters p;
  p.views.resize(scene.views.size());
  p.points.resize(scene.points.size());
  p.lines.resize(scene.lines.size());
  for (size_t v = 0; v < scene.views.size(); ++v) {
    if (!scene.views[v]) continue;
    const PinholeCamera& c = scene.views[v]->camera;
    const Eigen::Vector3d& t = scene.views[v]->camera_from_scene.t;
    p.views[v] = {0, 0, 0, t.x(), t.y(), t.z(), std::log(c.focal_px), c.cx, c.cy, c.k1};
  }
  for (size_t j = 0; j < scene.points.size(); ++j) {
    if (scene.points[j]) {
      Eigen::Map<Eigen::Vector4d>{p.points[j].data()} = scene.points[j]->homogeneous().normalized();
    }
  }
  for (size_t j = 0; j < scene.lines.size(); ++j) {
    if (!scene.lines[j]) continue;
    const auto points = PointsOnLine(ToOrthonormal(*scene.lines[j]));
    Eigen::Map<GrassmannLine::Span>{p.lines[j].data()} << points[0], points[1];
  }
  return p;
}

// False when something is not finite.
bool WriteScene(const Parameters& p, CalibratedScene* scene) {
  bool finite = true;
  for (size_t v = 0; v < scene->views.size(); ++v) {
    if (!scene->views[v]) continue;
    const auto& x = p.views[v];
    CalibratedView& view = *scene->views[v];
    Eigen::Matrix3d dR;
    ceres::AngleAxisToRotationMatrix(x.data(), ceres::ColumnMajorAdapter3x3(dR.data()));
    view.camera_from_scene.R = dR * view.camera_from_scene.R;
    view.camera_from_scene.t = Eigen::Vector3d(x[3], x[4], x[5]);
    view.camera.focal_px = std::exp(x[kLogFocal]);
    view.camera.cx = x[7];
    view.camera.cy = x[8];
    view.camera.k1 = x[9];
    for (const double value : x) finite = finite && std::isfinite(value);
    finite = finite && std::isfinite(view.camera.focal_px) && view.camera.focal_px > 0.0;
  }
  for (size_t j = 0; j < scene->points.size(); ++j) {
    if (!scene->points[j]) continue;
    const Eigen::Map<const Eigen::Vector4d> X(p.points[j].data());
    const Eigen::Vector3d x = X.head<3>() / X.w();
    // A point that went to infinity has no place in a metric scene.
    scene->points[j] = x.allFinite() ? std::optional<Eigen::Vector3d>(x) : std::nullopt;
  }
  for (size_t j = 0; j < scene->lines.size(); ++j) {
    if (!scene->lines[j]) continue;
    const Eigen::Map<const GrassmannLine::Span> X(p.lines[j].data());
    scene->lines[j] = JoinPoints(Eigen::Vector4d(X.col(0)), Eigen::Vector4d(X.col(1))).normalized();
    finite = finite && scene->lines[j]->allFinite();
  }
  return finite;
}

IntrinsicsPrior PriorOf(const ImageSize& size,
                        const ViewPrior& given,
                        const CalibratedBundleOptions& options) {
  IntrinsicsPrior prior;
  const double weak_center = options.principal_point_sigma_widths * size.width;
  prior.mean = {std::log(options.focal_prior_widths * size.width),
                0.5 * (size.width - 1),
                0.5 * (size.height - 1),
                given.k1.value_or(0.0)};
  prior.sigma = {options.focal_prior_log_sigma,
                 weak_center,
                 weak_center,
                 given.k1 ? given.k1_sigma : options.k1_sigma};
  if (given.focal_px) {
    prior.mean[0] = std::log(*given.focal_px);
    prior.sigma[0] = given.focal_log_sigma;
  }
  if (given.principal_point_px) {
    prior.mean[1] = given.principal_point_px->x();
    prior.mean[2] = given.principal_point_px->y();
    prior.sigma[1] = prior.sigma[2] = given.principal_point_sigma_px;
  }
  return prior;
}

struct Observed {
  std::vector<int> points, lines;
};

// Inlier observations of points in two and lines in three known views.
Observed UsedObservations(const MultiviewTracks& tracks,
                          const ProjectiveScene& inliers,
                          const CalibratedScene& scene) {
  std::vector<int> point_views(tracks.points, 0), line_views(tracks.lines, 0);
  const auto use_point = [&](size_t k) {
    const PointObservation& o = tracks.point_observations[k];
    return inliers.point_inlier[k] && scene.views[o.view] && scene.points[o.point];
  };
  const auto use_line = [&](size_t k) {
    const LineObservation& o = tracks.line_observations[k];
    return inliers.line_inlier[k] && scene.views[o.view] && scene.lines[o.line];
  };
  Observed out;
  for (size_t k = 0; k < tracks.point_observations.size(); ++k) {
    point_views[tracks.point_observations[k].point] += use_point(k);
  }
  for (size_t k = 0; k < tracks.line_observations.size(); ++k) {
    line_views[tracks.line_observations[k].line] += use_line(k);
  }
  for (size_t k = 0; k < tracks.point_observations.size(); ++k) {
    if (use_point(k) && point_views[tracks.point_observations[k].point] >= 2) {
      out.points.push_back(static_cast<int>(k));
    }
  }
  for (size_t k = 0; k < tracks.line_observations.size(); ++k) {
    if (use_line(k) && line_views[tracks.line_observations[k].line] >= 3) {
      out.lines.push_back(static_cast<int>(k));
    }
  }
  return out;
}

void BuildProblem(const MultiviewTracks& tracks,
                  const Observed& used,
                  std::span<const ViewPrior> priors,
                  const CalibratedBundleOptions& options,
                  RobustLoss loss_kind,
                  const CalibratedScene& scene,
                  Parameters* p,
                  ceres::Problem* problem) {
  static const ViewPrior kNoPrior;
  ceres::LossFunction* loss = nullptr;  // owned by the problem once used
  const auto shared_loss = [&] {
    if (loss == nullptr) loss = MakeCeresLoss(loss_kind, options.loss_scale);
    return loss;
  };
  for (const int k : used.points) {
    const PointObservation& o = tracks.point_observations[k];
    const Eigen::Matrix3d& R0 = scene.views[o.view]->camera_from_scene.R;
    problem->AddResidualBlock(
        new ceres::AutoDiffCostFunction<PointCost, 2, kView, 4>(new PointCost{o, R0}),
        shared_loss(),
        p->views[o.view].data(),
        p->points[o.point].data());
  }
  for (const int k : used.lines) {
    const LineObservation& o = tracks.line_observations[k];
    const Eigen::Matrix3d& R0 = scene.views[o.view]->camera_from_scene.R;
    problem->AddResidualBlock(
        new ceres::AutoDiffCostFunction<LineCost, 2, kView, 8>(new LineCost{o, R0}),
        shared_loss(),
        p->views[o.view].data(),
        p->lines[o.line].data());
  }
  for (size_t v = 0; v < scene.views.size(); ++v) {
    if (!scene.views[v] || !problem->HasParameterBlock(p->views[v].data())) continue;
    const ViewPrior& given = priors.empty() ? kNoPrior : priors[v];
    problem->AddResidualBlock(new ceres::AutoDiffCostFunction<IntrinsicsPrior, 4, kView>(
                                  new IntrinsicsPrior(PriorOf(tracks.sizes[v], given, options))),
                              nullptr,
                              p->views[v].data());
    if (given.camera_from_world) {
      problem->AddResidualBlock(new ceres::AutoDiffCostFunction<PosePrior, 6, kView>(
                                    new PosePrior{scene.views[v]->camera_from_scene.R,
                                                  *given.camera_from_world,
                                                  given.rotation_sigma_rad,
                                                  given.position_sigma_m}),
                                nullptr,
                                p->views[v].data());
    }
  }
  if (!options.estimate_k1) {
    SetSharedManifold(new ceres::SubsetManifold(kView, {9}), &p->views, problem);
  }
  SetSharedManifold(new ceres::SphereManifold<4>(), &p->points, problem);
  SetSharedManifold(new GrassmannLine(), &p->lines, problem);
}

// Freedoms that neither images nor pose priors fix.
int GaugeFreedom(const CalibratedScene& scene, std::span<const ViewPrior> priors) {
  int poses = 0;
  for (size_t v = 0; v < priors.size(); ++v) poses += scene.views[v] && priors[v].camera_from_world;
  return poses == 0 ? 7 : poses == 1 ? 1 : 0;
}

void FillCovariance(const ceres::Problem::EvaluateOptions& base,
                    const CalibratedBundleOptions& options,
                    int gauge,
                    ceres::Problem* problem,
                    Parameters* p,
                    CalibratedScene* scene,
                    CalibratedBundleSummary* summary) {
  ceres::Problem::EvaluateOptions evaluate = base;
  const int tangent = options.estimate_k1 ? kView : kView - 1;
  std::map<size_t, int> column_of;
  int columns = 0;
  for (size_t v = 0; v < p->views.size(); ++v) {
    if (!problem->HasParameterBlock(p->views[v].data())) continue;
    evaluate.parameter_blocks.push_back(p->views[v].data());
    column_of[v] = columns;
    columns += tangent;
  }
  std::vector<int> sizes;
  for (auto& x : p->points) {
    sizes.push_back(problem->HasParameterBlock(x.data()) ? 3 : 0);
    if (sizes.back() > 0) evaluate.parameter_blocks.push_back(x.data());
  }
  for (auto& x : p->lines) {
    sizes.push_back(problem->HasParameterBlock(x.data()) ? 4 : 0);
    if (sizes.back() > 0) evaluate.parameter_blocks.push_back(x.data());
  }
  double cost = 0.0;
  ceres::CRSMatrix J;
  if (!problem->Evaluate(evaluate, &cost, nullptr, nullptr, &J)) return;
  summary->covariance = InvertBundle(J, columns, sizes, gauge);
  if (!summary->covariance) return;
  summary->covariance->redundancy = J.num_rows - (J.num_cols - gauge);
  summary->covariance->variance_factor = 2.0 * cost / std::max(1, summary->covariance->redundancy);
  summary->camera_tangent = tangent;
  // Residuals above the stated deviations widen the answer, smaller ones do not narrow it.
  const double factor = std::max(1.0, summary->covariance->variance_factor);
  for (const auto& [v, column] : column_of) {
    const double variance =
        summary->covariance->cameras(column + kLogFocal, column + kLogFocal) * factor;
    (*scene).views[v]->focal_log_sigma = std::sqrt(std::max(0.0, variance));
  }
}

void Measure(const MultiviewTracks& tracks,
             const Observed& used,
             ceres::Problem* problem,
             CalibratedBundleSummary* summary) {
  // Residual blocks of observations come first, two residuals each.
  ceres::Problem::EvaluateOptions evaluate;
  evaluate.apply_loss_function = false;
  std::vector<double> r;
  double cost = 0.0;
  if (!problem->Evaluate(evaluate, &cost, &r, nullptr, nullptr)) return;
  double sigma2 = 0.0, px2 = 0.0;
  size_t at = 0;
  const auto add = [&](double sigma_px) {
    const double e = r[at] * r[at] + r[at + 1] * r[at + 1];
    at += 2;
    sigma2 += e;
    px2 += e * sigma_px * sigma_px;
  };
  for (const int k : used.points) add(tracks.point_observations[k].sigma_px);
  for (const int k : used.lines) add(tracks.line_observations[k].sigma_px);
  if (at == 0) return;
  summary->rms_sigma = std::sqrt(sigma2 / static_cast<double>(at));
  summary->rms_px = std::sqrt(px2 / static_cast<double>(at));
}

}  // namespace

CalibratedBundleSummary AdjustCalibrated(const MultiviewTracks& tracks,
                                         const ProjectiveScene& inliers,
                                         std::span<const ViewPrior> priors,
                                         const CalibratedBundleOptions& options,
                                         CalibratedScene* scene) {
  CalibratedBundleSummary summary;
  Parameters p = ReadScene(*scene);
  const Observed used = UsedObservations(tracks, inliers, *scene);
  if (used.points.empty() && used.lines.empty()) return summary;
  ceres::Problem problem;
  BuildProblem(tracks, used, priors, options, options.loss, *scene, &p, &problem);
  ceres::Solver::Options solver;
  solver.linear_solver_type = ceres::DENSE_SCHUR;
  solver.max_num_iterations = options.max_iterations;
  // One thread keeps the sums in order; the eliminated blocks are ordered by address, so that the
  // last bits of two runs may still differ.
  solver.num_threads = 1;
  solver.logging_type = ceres::SILENT;
  solver.function_tolerance = 1e-7;
  solver.max_trust_region_radius = kMaxTrustRegion;
  auto ordering = std::make_shared<ceres::ParameterBlockOrdering>();
  const auto group = [&](auto* blocks, int number) {
    for (auto& x : *blocks) {
      if (problem.HasParameterBlock(x.data())) ordering->AddElementToGroup(x.data(), number);
    }
  };
  group(&p.points, 0);
  group(&p.lines, 0);
  group(&p.views, 1);
  solver.linear_solver_ordering = ordering;
  ceres::Solver::Summary report;
  ceres::Solve(solver, &problem, &report);
  if (!report.IsSolutionUsable()) return summary;
  CalibratedScene next = *scene;
  if (!WriteScene(p, &next)) return summary;
  summary.usable = true;
  summary.cost = report.final_cost;
  Measure(tracks, used, &problem, &summary);
  if (options.covariance) {
    ceres::Problem plain;  // deviations of normal residuals: no loss
    BuildProblem(tracks, used, priors, options, RobustLoss::kNone, *scene, &p, &plain);
    FillCovariance({}, options, GaugeFreedom(*scene, priors), &plain, &p, &next, &summary);
  }
  *scene = std::move(next);
  return summary;
}

}  // namespace horopter
