#include "server/vision/reconstruction/projective_bundle.h"

#include <Eigen/Dense>
#include <algorithm>
#include <cmath>

#include "server/vision/reconstruction/bundle_model.h"

namespace horopter {
namespace {

using CameraVector = Eigen::Matrix<double, kProjectiveCamera, 1>;
using ProjectiveState = BundleState<CameraMatrix>;

CameraVector Stacked(const CameraMatrix& P) {
  CameraVector p;
  for (int r = 0; r < 3; ++r) p.segment<4>(4 * r) = P.row(r).transpose();
  return p;
}

class ProjectiveModel : public BundleModel<kProjectiveCamera, CameraMatrix> {
 public:
  using BundleModel::BundleModel;

  void Linearize(const ProjectiveState& state,
                 Bend bend,
                 NormalEquations<kProjectiveCamera>* normal) const {
    BundleModel::Linearize(state, bend, normal);
    // Scales of cameras, as those of points.
    for (size_t i = 0; i < normal->U.size(); ++i) {
      const CameraVector p = Stacked(state.cameras[i]);
      normal->U[i] += normal->U[i].trace() * p * p.transpose();
    }
  }

  ProjectiveState Moved(const ProjectiveState& state,
                        const BundleStep<kProjectiveCamera>& step) const {
    ProjectiveState next = state;
    for (size_t i = 0; i < next.cameras.size(); ++i) {
      for (int r = 0; r < 3; ++r) {
        next.cameras[i].row(r) += step.cameras[i].segment<4>(4 * r).transpose();
      }
      next.cameras[i] /= next.cameras[i].norm();
    }
    MoveFeatures(step, &next);
    return next;
  }
};

ProjectiveState ReadProjective(const ProjectiveScene& scene, const BundleObservations& used) {
  ProjectiveState state;
  for (const int v : used.view) {
    state.cameras.push_back(*scene.cameras[v] / scene.cameras[v]->norm());
  }
  for (const auto& X : scene.points) {
    state.points.push_back(X ? X->normalized() : Eigen::Vector4d::Zero());
  }
  for (const auto& L : scene.lines) state.lines.push_back(L ? SpanOf(*L) : LineSpan::Zero());
  return state;
}

void WriteProjective(const ProjectiveState& state,
                     const BundleObservations& used,
                     ProjectiveScene* scene) {
  for (size_t i = 0; i < used.view.size(); ++i) scene->cameras[used.view[i]] = state.cameras[i];
  for (size_t j = 0; j < scene->points.size(); ++j) {
    if (scene->points[j]) scene->points[j] = state.points[j];
  }
  for (size_t j = 0; j < scene->lines.size(); ++j) {
    if (scene->lines[j]) scene->lines[j] = LineOf(state.lines[j]);
  }
}

bool AllFinite(const ProjectiveScene& scene) {
  const auto finite = [](const auto& list) {
    return std::all_of(
        list.begin(), list.end(), [](const auto& x) { return !x || x->allFinite(); });
  };
  return finite(scene.cameras) && finite(scene.points) && finite(scene.lines);
}

}  // namespace

ProjectiveBundleSummary AdjustProjective(const MultiviewTracks& tracks,
                                         const ProjectiveBundleOptions& options,
                                         ProjectiveScene* scene) {
  ProjectiveBundleSummary summary;
  if (!AllFinite(*scene)) return summary;
  const BundleObservations used =
      SelectObservations(tracks, *scene, Known(scene->cameras, scene->points, scene->lines));
  if (used.observation.empty()) return summary;
  ProjectiveState state = ReadProjective(*scene, used);
  const ProjectiveModel model(tracks, used, options.loss, options.loss_scale);
  BundleSolverOptions solver;
  solver.max_iterations = options.max_iterations;
  solver.function_tolerance = options.function_tolerance;
  const BundleReport report = MinimizeBundle<kProjectiveCamera>(used.layout, solver, model, &state);
  if (!report.usable) return summary;
  WriteProjective(state, used, scene);
  summary.usable = true;
  summary.cost = report.cost;
  summary.iterations = report.iterations;
  return summary;
}

std::optional<BundleCovariance> ProjectiveCovariance(const MultiviewTracks& tracks,
                                                     const ProjectiveScene& scene) {
  if (!AllFinite(scene)) return std::nullopt;
  const BundleObservations used =
      SelectObservations(tracks, scene, Known(scene.cameras, scene.points, scene.lines));
  if (used.layout.cameras < 2) return std::nullopt;
  const ProjectiveState state = ReadProjective(scene, used);
  const ProjectiveModel model(tracks, used, RobustLoss::kNone, 1.0);
  const double cost = model.Cost(state);
  if (!std::isfinite(cost)) return std::nullopt;
  NormalEquations<kProjectiveCamera> normal;
  normal.SetZero(used.layout);
  model.Linearize(state, Bend::kWeights, &normal);
  TangentBases<kProjectiveCamera> bases = model.FeatureBases(state);
  for (const CameraMatrix& P : state.cameras) {
    bases.cameras.push_back(SphereTangent<kProjectiveCamera>(Stacked(P)));
  }
  constexpr int kCollineation = 15;  // free numbers of the projective frame
  auto out = InvertBundle<kProjectiveCamera>(used.layout, normal, bases, kCollineation);
  if (!out) return std::nullopt;
  out->redundancy = Redundancy(used, bases, kCollineation);
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
  for (Eigen::Index i = 0; i < n; ++i) {
    const Eigen::Vector4d X = scene.points[known[i]]->normalized();
    const Eigen::Vector4d y = H * X;
    Eigen::Matrix<double, 3, 4> to_finite;
    to_finite << Eigen::Matrix3d::Identity() / y.w(), -y.head<3>() / (y.w() * y.w());
    J.block<3, 3>(3 * i, 3 * i) = to_finite * H * SphereTangent<4>(X);
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
