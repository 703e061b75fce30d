#include "server/vision/reconstruction/projective_bundle.h"

#include <ceres/ceres.h>

#include <Eigen/Dense>
#include <array>
#include <cmath>
#include <memory>

#include "server/vision/reconstruction/bundle_manifolds.h"

namespace horopter {
namespace {

// Damping stays above this part of the diagonal, far from the limits of double precision.
constexpr double kMaxTrustRegion = 1e6;

using RowMajorCamera = Eigen::Matrix<double, 3, 4, Eigen::RowMajor>;

// (P X)_{x, y} / (P X)_z - observed, in sigmas.
class PointCost final : public ceres::SizedCostFunction<2, 12, 4> {
 public:
  explicit PointCost(const PointObservation& o) : pixel_(o.pixel), weight_(1.0 / o.sigma_px) {}

  bool Evaluate(double const* const* parameters,
                double* residuals,
                double** jacobians) const override {
    const Eigen::Map<const RowMajorCamera> P(parameters[0]);
    const Eigen::Map<const Eigen::Vector4d> X(parameters[1]);
    const Eigen::Vector3d y = P * X;
    const double inverse = 1.0 / y.z();
    if (!std::isfinite(inverse)) return false;
    const Eigen::Vector2d u(y.x() * inverse, y.y() * inverse);
    residuals[0] = weight_ * (u.x() - pixel_.x());
    residuals[1] = weight_ * (u.y() - pixel_.y());
    if (jacobians == nullptr) return true;
    const double s = weight_ * inverse;
    if (jacobians[0] != nullptr) {
      Eigen::Map<Eigen::Matrix<double, 2, 12, Eigen::RowMajor>> J(jacobians[0]);
      J.setZero();
      J.block<1, 4>(0, 0) = s * X.transpose();
      J.block<1, 4>(1, 4) = s * X.transpose();
      J.block<1, 4>(0, 8) = -s * u.x() * X.transpose();
      J.block<1, 4>(1, 8) = -s * u.y() * X.transpose();
    }
    if (jacobians[1] != nullptr) {
      Eigen::Map<Eigen::Matrix<double, 2, 4, Eigen::RowMajor>> J(jacobians[1]);
      J.row(0) = s * (P.row(0) - u.x() * P.row(2));
      J.row(1) = s * (P.row(1) - u.y() * P.row(2));
    }
    return true;
  }

 private:
  Eigen::Vector2d pixel_;
  double weight_;
};

// Distances of both ends from l = (P A) x (P B), in sigmas.
class LineCost final : public ceres::SizedCostFunction<2, 12, 8> {
 public:
  explicit LineCost(const LineObservation& o)
      : ends_{o.start.homogeneous(), o.end.homogeneous()}, weight_(1.0 / o.sigma_px) {}

  bool Evaluate(double const* const* parameters,
                double* residuals,
                double** jacobians) const override {
    const Eigen::Map<const RowMajorCamera> P(parameters[0]);
    const Eigen::Map<const GrassmannLine::Span> X(parameters[1]);
    const Eigen::Vector3d p = P * X.col(0), q = P * X.col(1);
    const Eigen::Vector3d l = p.cross(q);
    const double norm = l.head<2>().norm();
    if (!(norm > 1e-300) || !std::isfinite(norm)) return false;
    for (int e = 0; e < 2; ++e) {
      const double distance = l.dot(ends_[e]) / norm;
      residuals[e] = weight_ * distance;
      if (jacobians == nullptr) continue;
      // d distance / d l, then through p and q: x . (dp x q) = dp . (q x x).
      Eigen::Vector3d g = ends_[e] / norm;
      g.head<2>() -= l.head<2>() * (distance / (norm * norm));
      g *= weight_;
      const Eigen::Vector3d dp = q.cross(g), dq = g.cross(p);
      if (jacobians[0] != nullptr) {
        Eigen::Map<RowMajorCamera> J(jacobians[0] + 12 * e);
        J = dp * X.col(0).transpose() + dq * X.col(1).transpose();
      }
      if (jacobians[1] != nullptr) {
        Eigen::Map<Eigen::Vector4d>{jacobians[1] + 8 * e} = P.transpose() * dp;
        Eigen::Map<Eigen::Vector4d>{jacobians[1] + 8 * e + 4} = P.transpose() * dq;
      }
    }
    return true;
  }

 private:
  std::array<Eigen::Vector3d, 2> ends_;
  double weight_;
};

struct Parameters {
  std::vector<std::array<double, 12>> cameras;
  std::vector<std::array<double, 4>> points;
  std::vector<std::array<double, 8>> lines;
};

Parameters ReadScene(const ProjectiveScene& scene) {
  Parameters p;
  p.cameras.resize(scene.cameras.size());
  p.points.resize(scene.points.size());
  p.lines.resize(scene.lines.size());
  for (size_t v = 0; v < scene.cameras.size(); ++v) {
    if (scene.cameras[v]) {
      Eigen::Map<RowMajorCamera>{p.cameras[v].data()} =
          *scene.cameras[v] / scene.cameras[v]->norm();
    }
  }
  for (size_t j = 0; j < scene.points.size(); ++j) {
    if (scene.points[j]) {
      Eigen::Map<Eigen::Vector4d>{p.points[j].data()} = scene.points[j]->normalized();
    }
  }
  for (size_t j = 0; j < scene.lines.size(); ++j) {
    if (!scene.lines[j]) continue;
    const auto points = PointsOnLine(ToOrthonormal(*scene.lines[j]));
    Eigen::Map<GrassmannLine::Span>{p.lines[j].data()} << points[0], points[1];
  }
  return p;
}

void WriteScene(const Parameters& p, ProjectiveScene* scene) {
  for (size_t v = 0; v < scene->cameras.size(); ++v) {
    if (scene->cameras[v]) {
      scene->cameras[v] = CameraMatrix(Eigen::Map<const RowMajorCamera>(p.cameras[v].data()));
    }
  }
  for (size_t j = 0; j < scene->points.size(); ++j) {
    if (scene->points[j]) {
      scene->points[j] = Eigen::Vector4d(Eigen::Map<const Eigen::Vector4d>(p.points[j].data()));
    }
  }
  for (size_t j = 0; j < scene->lines.size(); ++j) {
    if (!scene->lines[j]) continue;
    const Eigen::Map<const GrassmannLine::Span> X(p.lines[j].data());
    scene->lines[j] = JoinPoints(Eigen::Vector4d(X.col(0)), Eigen::Vector4d(X.col(1))).normalized();
  }
}

// Inlier observations of each feature in known cameras.
std::vector<int> PointViews(const MultiviewTracks& tracks, const ProjectiveScene& scene) {
  std::vector<int> views(tracks.points, 0);
  for (size_t k = 0; k < tracks.point_observations.size(); ++k) {
    const PointObservation& o = tracks.point_observations[k];
    views[o.point] += scene.point_inlier[k] && scene.cameras[o.view] && scene.points[o.point];
  }
  return views;
}

std::vector<int> LineViews(const MultiviewTracks& tracks, const ProjectiveScene& scene) {
  std::vector<int> views(tracks.lines, 0);
  for (size_t k = 0; k < tracks.line_observations.size(); ++k) {
    const LineObservation& o = tracks.line_observations[k];
    views[o.line] += scene.line_inlier[k] && scene.cameras[o.view] && scene.lines[o.line];
  }
  return views;
}

// Adds observations of points in two and lines in three views: two views of a line always agree.
void BuildProblem(const MultiviewTracks& tracks,
                  const ProjectiveScene& scene,
                  RobustLoss loss_kind,
                  double loss_scale,
                  Parameters* p,
                  ceres::Problem* problem) {
  ceres::LossFunction* loss = nullptr;  // owned by the problem once used
  const auto shared_loss = [&] {
    if (loss == nullptr) loss = MakeCeresLoss(loss_kind, loss_scale);
    return loss;
  };
  const std::vector<int> point_views = PointViews(tracks, scene);
  const std::vector<int> line_views = LineViews(tracks, scene);
  for (size_t k = 0; k < tracks.point_observations.size(); ++k) {
    const PointObservation& o = tracks.point_observations[k];
    if (!scene.point_inlier[k] || !scene.cameras[o.view] || point_views[o.point] < 2) continue;
    problem->AddResidualBlock(
        new PointCost(o), shared_loss(), p->cameras[o.view].data(), p->points[o.point].data());
  }
  for (size_t k = 0; k < tracks.line_observations.size(); ++k) {
    const LineObservation& o = tracks.line_observations[k];
    if (!scene.line_inlier[k] || !scene.cameras[o.view] || line_views[o.line] < 3) continue;
    problem->AddResidualBlock(
        new LineCost(o), shared_loss(), p->cameras[o.view].data(), p->lines[o.line].data());
  }
  SetSharedManifold(new ceres::SphereManifold<12>(), &p->cameras, problem);
  SetSharedManifold(new ceres::SphereManifold<4>(), &p->points, problem);
  SetSharedManifold(new GrassmannLine(), &p->lines, problem);
}

// Features are eliminated first.
std::shared_ptr<ceres::ParameterBlockOrdering> FeaturesFirst(const ceres::Problem& problem,
                                                             Parameters* p) {
  auto ordering = std::make_shared<ceres::ParameterBlockOrdering>();
  for (auto& x : p->points) {
    if (problem.HasParameterBlock(x.data())) ordering->AddElementToGroup(x.data(), 0);
  }
  for (auto& x : p->lines) {
    if (problem.HasParameterBlock(x.data())) ordering->AddElementToGroup(x.data(), 0);
  }
  for (auto& x : p->cameras) {
    if (problem.HasParameterBlock(x.data())) ordering->AddElementToGroup(x.data(), 1);
  }
  return ordering;
}

bool AllFinite(const ProjectiveScene& scene) {
  for (const auto& P : scene.cameras) {
    if (P && !P->allFinite()) return false;
  }
  for (const auto& X : scene.points) {
    if (X && !X->allFinite()) return false;
  }
  for (const auto& L : scene.lines) {
    if (L && !L->allFinite()) return false;
  }
  return true;
}

}  // namespace

ProjectiveBundleSummary AdjustProjective(const MultiviewTracks& tracks,
                                         const ProjectiveBundleOptions& options,
                                         ProjectiveScene* scene) {
  ProjectiveBundleSummary summary;
  if (!AllFinite(*scene)) return summary;
  Parameters p = ReadScene(*scene);
  ceres::Problem problem;
  BuildProblem(tracks, *scene, options.loss, options.loss_scale, &p, &problem);
  if (problem.NumResidualBlocks() == 0) return summary;
  ceres::Solver::Options solver;
  solver.linear_solver_type = ceres::DENSE_SCHUR;
  solver.linear_solver_ordering = FeaturesFirst(problem, &p);
  solver.max_num_iterations = options.max_iterations;
  // One thread keeps the sums in order; the eliminated blocks are ordered by address, so that the
  // last bits of two runs may still differ.
  solver.num_threads = 1;
  solver.logging_type = ceres::SILENT;
  solver.function_tolerance = options.function_tolerance;
  // The gauge is free: without damping the normal equations are singular.
  solver.max_trust_region_radius = kMaxTrustRegion;
  ceres::Solver::Summary report;
  ceres::Solve(solver, &problem, &report);
  if (!report.IsSolutionUsable()) return summary;
  ProjectiveScene next = *scene;
  WriteScene(p, &next);
  if (!AllFinite(next)) return summary;
  *scene = std::move(next);
  summary.usable = true;
  summary.cost = report.final_cost;
  summary.iterations = static_cast<int>(report.iterations.size());
  return summary;
}

std::optional<BundleCovariance> ProjectiveCovariance(const MultiviewTracks& tracks,
                                                     const ProjectiveScene& scene) {
  if (!AllFinite(scene)) return std::nullopt;
  Parameters p = ReadScene(scene);
  ceres::Problem problem;
  BuildProblem(tracks, scene, RobustLoss::kNone, 1.0, &p, &problem);
  ceres::Problem::EvaluateOptions evaluate;
  int camera_parameters = 0;
  for (auto& x : p.cameras) {
    if (!problem.HasParameterBlock(x.data())) continue;
    evaluate.parameter_blocks.push_back(x.data());
    camera_parameters += 11;
  }
  std::vector<int> sizes;
  for (auto& x : p.points) {
    sizes.push_back(problem.HasParameterBlock(x.data()) ? 3 : 0);
    if (sizes.back() > 0) evaluate.parameter_blocks.push_back(x.data());
  }
  for (auto& x : p.lines) {
    sizes.push_back(problem.HasParameterBlock(x.data()) ? 4 : 0);
    if (sizes.back() > 0) evaluate.parameter_blocks.push_back(x.data());
  }
  if (camera_parameters < 22) return std::nullopt;
  double cost = 0.0;
  ceres::CRSMatrix J;
  if (!problem.Evaluate(evaluate, &cost, nullptr, nullptr, &J)) return std::nullopt;
  constexpr int kCollineation = 15;
  std::optional<BundleCovariance> out = InvertBundle(J, camera_parameters, sizes, kCollineation);
  if (!out) return std::nullopt;
  out->redundancy = J.num_rows - (J.num_cols - kCollineation);
  if (out->redundancy <= 0) return std::nullopt;
  out->variance_factor = 2.0 * cost / out->redundancy;
  return out;
}

std::vector<Eigen::Matrix3d> AlignedPointCovariances(const BundleCovariance& covariance,
                                                     const ProjectiveScene& scene,
                                                     const Eigen::Matrix4d& H) {
  std::vector<Eigen::Matrix3d> out(scene.points.size(), Eigen::Matrix3d::Zero());
  std::vector<int> known;
  for (size_t j = 0; j < scene.points.size(); ++j) {
    if (scene.points[j] && covariance.feature_size[j] == 3) known.push_back(static_cast<int>(j));
  }
  const Eigen::Index n = static_cast<Eigen::Index>(known.size());
  // Rows of x = (H X)_xyz / (H X)_w by the tangent parameters, and by the 16 entries of I + E.
  Eigen::MatrixXd J = Eigen::MatrixXd::Zero(3 * n, 3 * n), T(3 * n, 16);
  const ceres::SphereManifold<4> sphere;
  for (Eigen::Index i = 0; i < n; ++i) {
    const Eigen::Vector4d X = scene.points[known[i]]->normalized();
    const Eigen::Vector4d y = H * X;
    Eigen::Matrix<double, 3, 4> to_finite;
    to_finite << Eigen::Matrix3d::Identity() / y.w(), -y.head<3>() / (y.w() * y.w());
    Eigen::Matrix<double, 4, 3, Eigen::RowMajor> tangent;
    if (!sphere.PlusJacobian(X.data(), tangent.data())) return out;
    J.block<3, 3>(3 * i, 3 * i) = to_finite * H * tangent;
    for (int c = 0; c < 4; ++c) T.block<3, 4>(3 * i, 4 * c) = to_finite * y(c);
  }
  Eigen::MatrixXd C = J * covariance.Features(known) * J.transpose();
  // C <- (I - T T^+) C (I - T T^+)
  const Eigen::ColPivHouseholderQR<Eigen::MatrixXd> qr(T);
  const Eigen::MatrixXd Q =
      Eigen::MatrixXd(qr.householderQ()).leftCols(std::min<Eigen::Index>(15, qr.rank()));
  C -= Q * (Q.transpose() * C).eval();
  C -= (C * Q).eval() * Q.transpose();
  for (Eigen::Index i = 0; i < n; ++i) out[known[i]] = C.block<3, 3>(3 * i, 3 * i);
  return out;
}

}  // namespace horopter
