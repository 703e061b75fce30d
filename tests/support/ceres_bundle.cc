#include "tests/support/ceres_bundle.h"

#include <ceres/ceres.h>
#include <ceres/rotation.h>

#include <Eigen/Dense>
#include <Eigen/Sparse>
#include <algorithm>
#include <cmath>

namespace horopter {
namespace {

// Parameters of a view: log f, k1 | rotation vector w (R = R0 exp(w)) | centre.
struct ViewParameters {
  double intrinsics[2];
  double rotation[3];
  double center[3];
};

struct ReprojectionError {
  ReprojectionError(const Eigen::Vector2d& pixel, const BundleView& view)
      : pixel_(pixel), center_(view.PrincipalPoint()), R0_(view.camera_from_world.R) {}

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
    residual[0] = scale * x + center_.x() - pixel_.x();
    residual[1] = scale * y + center_.y() - pixel_.y();
    return true;
  }

  Eigen::Vector2d pixel_, center_;
  Eigen::Matrix3d R0_;
};

struct Prior {
  template <typename T>
  bool operator()(const T* intrinsics, T* residual) const {
    residual[0] = (intrinsics[0] - log_focal) / log_sigma;
    residual[1] = (intrinsics[1] - k1) / k1_sigma;
    return true;
  }
  double log_focal, log_sigma, k1, k1_sigma;
};

Prior PriorOf(const BundleView& view, const BundleOptions& options) {
  const ViewPrior& given = view.prior;
  Prior out{std::log(options.focal_prior_widths * view.size.width),
            options.focal_prior_log_sigma,
            0.0,
            options.k1_sigma};
  if (given.focal_px) {
    out.log_focal = std::log(*given.focal_px);
    out.log_sigma = given.focal_log_sigma;
  }
  if (given.k1) {
    out.k1 = *given.k1;
    out.k1_sigma = given.k1_sigma;
  }
  return out;
}

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
      problem->AddResidualBlock(new ceres::AutoDiffCostFunction<ReprojectionError, 2, 2, 3, 3, 3>(
                                    new ReprojectionError(o.point, bundle.views[o.view])),
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
    problem->AddResidualBlock(
        new ceres::AutoDiffCostFunction<Prior, 2, 2>(new Prior(PriorOf(bundle.views[i], options))),
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

using SparseMatrix = Eigen::SparseMatrix<double>;

SparseMatrix FromCeres(const ceres::CRSMatrix& crs) {
  std::vector<Eigen::Triplet<double>> entries;
  for (int r = 0; r < crs.num_rows; ++r) {
    for (int k = crs.rows[r]; k < crs.rows[r + 1]; ++k) {
      entries.emplace_back(r, crs.cols[k], crs.values[k]);
    }
  }
  SparseMatrix out(crs.num_rows, crs.num_cols);
  out.setFromTriplets(entries.begin(), entries.end());
  return out;
}

// By the principal points. A pixel moves as its principal point does. Rows are in the order of
// BuildProblem, scaled as Ceres scales them by the loss; residuals: without the loss.
SparseMatrix CenterJacobian(const BundleOptions& options,
                            const Bundle& bundle,
                            const std::vector<double>& residuals) {
  SparseMatrix J(static_cast<Eigen::Index>(residuals.size()),
                 2 * static_cast<Eigen::Index>(bundle.views.size()));
  std::vector<Eigen::Triplet<double>> entries;
  int row = 0;
  for (const BundlePoint& point : bundle.points) {
    for (const TrackObservation& o : point.track.observations) {
      const double r2 = residuals[row] * residuals[row] + residuals[row + 1] * residuals[row + 1];
      const double weight = 1.0 / std::sqrt(1.0 + r2 / (options.loss_px * options.loss_px));
      for (int k = 0; k < 2; ++k) entries.emplace_back(row + k, 2 * o.view + k, weight);
      row += 2;
    }
  }
  J.setFromTriplets(entries.begin(), entries.end());
  return J;
}
// Fills the deviations of every log f. The principal points are fixed at the images' centres: what
// their own deviation adds is propagated as that of consider parameters (Schmidt 1966),
// C = s^2 N^-1 + S Sigma S^T with S = N^-1 J^T J_c.
void FillFocalDeviations(const BundleOptions& options,
                         double cost,
                         ceres::Problem* problem,
                         Parameters* p,
                         Bundle* bundle) {
  ceres::Problem::EvaluateOptions evaluate;
  evaluate.num_threads = 1;
  std::vector<Eigen::Index> column_of;  // of log f, per view
  int columns = 0;
  for (ViewParameters& v : p->views) {
    if (!problem->HasParameterBlock(v.center)) return;  // a view without observations
    column_of.push_back(columns);
    for (double* block : {v.intrinsics, v.rotation, v.center}) {
      if (problem->IsParameterBlockConstant(block)) continue;
      evaluate.parameter_blocks.push_back(block);
      columns += problem->ParameterBlockTangentSize(block);
    }
  }
  for (Eigen::Vector3d& x : p->points) {
    if (problem->HasParameterBlock(x.data())) evaluate.parameter_blocks.push_back(x.data());
  }
  ceres::CRSMatrix crs;
  std::vector<double> residuals;
  if (!problem->Evaluate(evaluate, nullptr, nullptr, nullptr, &crs)) return;
  evaluate.apply_loss_function = false;
  if (!problem->Evaluate(evaluate, nullptr, &residuals, nullptr, nullptr)) return;
  const SparseMatrix J = FromCeres(crs);
  const auto views = static_cast<Eigen::Index>(bundle->views.size());
  const SparseMatrix J_center = CenterJacobian(options, *bundle, residuals);
  const Eigen::SimplicialLDLT<SparseMatrix> normal(SparseMatrix(J.transpose() * J));
  if (normal.info() != Eigen::Success) return;
  Eigen::MatrixXd units = Eigen::MatrixXd::Zero(J.cols(), views);
  for (Eigen::Index i = 0; i < views; ++i) units(column_of[i], i) = 1.0;
  const Eigen::MatrixXd of_focals = normal.solve(units);  // columns of N^-1
  if (normal.info() != Eigen::Success || !of_focals.allFinite()) return;
  const Eigen::MatrixXd S = of_focals.transpose() * (J.transpose() * J_center);
  const double freedom = std::max<double>(1.0, static_cast<double>(J.rows() - J.cols()));
  const double variance = std::max(2.0 * cost / freedom, 0.01);
  for (Eigen::Index i = 0; i < views; ++i) {
    BundleView& view = bundle->views[i];
    const double noise = of_focals(column_of[i], i) * variance;
    if (!(noise >= 0.0)) continue;
    double center = 0.0;
    for (Eigen::Index k = 0; k < 2 * views; ++k) {
      const double sigma_px = bundle->views[k / 2].PrincipalPointSigmaPx(options);
      center += S(i, k) * S(i, k) * sigma_px * sigma_px;
    }
    view.focal_log_sigma = std::sqrt(noise);
    view.focal_log_sigma_of_center = std::sqrt(center);
  }
}

}  // namespace

BundleSummary AdjustBundleInCeres(const BundleOptions& options, Bundle* bundle) {
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
  if (options.covariance) FillFocalDeviations(options, report.final_cost, &problem, &p, bundle);
  WriteParameters(p, bundle);
  return summary;
}

}  // namespace horopter
