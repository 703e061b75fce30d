#include "server/vision/reconstruction/calibrated_bundle.h"

#include <Eigen/Dense>
#include <algorithm>
#include <cmath>
#include <map>
#include <utility>

#include "server/vision/reconstruction/bundle_model.h"

namespace horopter {
namespace {

using CalibratedState = BundleState<CalibratedCamera>;

Eigen::Vector4d IntrinsicsOf(const PinholeCamera& c) {
  return {std::log(c.focal_px), c.cx, c.cy, c.k1};
}

struct IntrinsicsPrior {
  Eigen::Vector4d mean, sigma;  // log f, cx, cy, k1

  // In sigmas.
  Eigen::Vector4d Residual(const PinholeCamera& c) const {
    return (IntrinsicsOf(c) - mean).cwiseQuotient(sigma);
  }
};

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

// Views of the layout that one camera took.
using OneCamera = std::vector<int>;

struct Priors {
  std::vector<IntrinsicsPrior> intrinsics;  // per view of the layout
  std::vector<std::optional<PosePrior>> poses;
  std::vector<OneCamera> cameras;                        // of two views and more
  Eigen::Vector4d tied_sigma = Eigen::Vector4d::Ones();  // of the same parameters about their mean
  int Residuals() const {
    int tied = 0;
    for (const OneCamera& views : cameras) tied += 4 * (static_cast<int>(views.size()) - 1);
    return tied + static_cast<int>(4 * intrinsics.size() +
                                   6 * std::count_if(poses.begin(), poses.end(), [](const auto& p) {
                                     return p.has_value();
                                   }));
  }
};

Priors PriorsOf(const MultiviewTracks& tracks,
                const BundleObservations& used,
                std::span<const ViewPrior> priors,
                const CalibratedBundleOptions& options) {
  Priors out;
  for (const int v : used.view) {
    const ViewPrior given = priors.empty() ? ViewPrior() : priors[v];
    out.intrinsics.push_back(PriorOf(tracks.sizes[v], given, options));
    out.poses.emplace_back();
    if (!given.camera_from_world) continue;
    out.poses.back() =
        PosePrior{*given.camera_from_world, given.rotation_sigma_rad, given.position_sigma_m};
  }
  std::map<int, OneCamera> of_camera;
  for (size_t i = 0; i < used.view.size() && !options.camera_of_view.empty(); ++i)
    of_camera[options.camera_of_view[used.view[i]]].push_back(static_cast<int>(i));
  for (auto& [camera, views] : of_camera) {
    if (views.size() > 1) out.cameras.push_back(std::move(views));
  }
  out.tied_sigma << options.tied_focal_log_sigma, options.tied_principal_point_sigma_px,
      options.tied_principal_point_sigma_px, options.tied_k1_sigma;
  return out;
}

// The mean lens of one camera's views.
Eigen::Vector4d MeanOf(const CalibratedState& state, const OneCamera& views) {
  Eigen::Vector4d sum = Eigen::Vector4d::Zero();
  for (const int i : views) sum += IntrinsicsOf(state.cameras[i].camera);
  return sum / static_cast<double>(views.size());
}

class CalibratedModel : public BundleModel<kMetricCamera, CalibratedCamera> {
 public:
  CalibratedModel(const MultiviewTracks& tracks,
                  const BundleObservations& used,
                  const Priors& priors,
                  bool estimate_k1,
                  RobustLoss loss,
                  double loss_scale)
      : BundleModel(tracks, used, loss, loss_scale), priors_(priors), estimate_k1_(estimate_k1) {}

  double Cost(const CalibratedState& state) const {
    double cost = BundleModel::Cost(state);
    for (size_t i = 0; i < state.cameras.size(); ++i) {
      const auto& [camera, pose] = state.cameras[i];
      cost += 0.5 * priors_.intrinsics[i].Residual(camera).squaredNorm();
      if (priors_.poses[i]) cost += 0.5 * Residual(*priors_.poses[i], pose).squaredNorm();
    }
    for (const OneCamera& views : priors_.cameras) {
      const Eigen::Vector4d mean = MeanOf(state, views);
      for (const int i : views)
        cost += 0.5 * (IntrinsicsOf(state.cameras[i].camera) - mean)
                          .cwiseQuotient(priors_.tied_sigma)
                          .squaredNorm();
    }
    return cost;
  }

  void Linearize(const CalibratedState& state,
                 Bend bend,
                 NormalEquations<kMetricCamera>* normal) const {
    BundleModel::Linearize(state, bend, normal);
    for (size_t i = 0; i < state.cameras.size(); ++i) {
      const auto& [camera, pose] = state.cameras[i];
      auto& U = normal->U[i];
      auto& gradient = normal->camera_gradient[i];
      const IntrinsicsPrior& prior = priors_.intrinsics[i];
      const Eigen::Vector4d inverse = prior.sigma.cwiseInverse();
      U.diagonal().tail<4>() += inverse.cwiseAbs2();
      gradient.tail<4>() += inverse.cwiseProduct(prior.Residual(camera));
      if (priors_.poses[i]) {
        const Eigen::Matrix<double, 6, 6> J = Jacobian(*priors_.poses[i], pose);
        U.topLeftCorner<6, 6>() += J.transpose() * J;
        gradient.head<6>() += J.transpose() * Residual(*priors_.poses[i], pose);
      }
    }
    TieCameras(state, normal);
    for (size_t i = 0; i < state.cameras.size() && !estimate_k1_; ++i) {
      normal->U[i].row(kRadial).setZero();
      normal->U[i].col(kRadial).setZero();
      normal->camera_gradient[i](kRadial) = 0.0;
    }
    if (estimate_k1_) return;
    for (auto& K : normal->K) K.row(kRadial).setZero();
  }

  CalibratedState Moved(const CalibratedState& state, const BundleStep<kMetricCamera>& step) const {
    CalibratedState next = state;
    for (size_t i = 0; i < next.cameras.size(); ++i) {
      next.cameras[i] = MoveCamera(state.cameras[i], step.cameras[i]);
    }
    MoveFeatures(step, &next);
    return next;
  }

 private:
  // Deviations of the lenses of one camera's views from their mean.
  void TieCameras(const CalibratedState& state, NormalEquations<kMetricCamera>* normal) const {
    if (priors_.cameras.empty()) return;
    const int size = kMetricCamera * static_cast<int>(state.cameras.size());
    normal->coupling = Eigen::MatrixXd::Zero(size, size);
    const Eigen::Vector4d weight = priors_.tied_sigma.cwiseAbs2().cwiseInverse();
    const int parameters = estimate_k1_ ? 4 : 3;  // k1 comes last
    for (const OneCamera& views : priors_.cameras) {
      const Eigen::Vector4d mean = MeanOf(state, views);
      for (const int i : views) {
        normal->camera_gradient[i].tail<4>() +=
            weight.cwiseProduct(IntrinsicsOf(state.cameras[i].camera) - mean);
        for (const int j : views) {
          const double share = (i == j ? 1.0 : 0.0) - 1.0 / static_cast<double>(views.size());
          for (int p = 0; p < parameters; ++p) {
            normal->coupling(kMetricCamera * i + kLogFocal + p,
                             kMetricCamera * j + kLogFocal + p) += share * weight[p];
          }
        }
      }
    }
  }

  const Priors& priors_;
  bool estimate_k1_;
};

CalibratedState ReadCalibrated(const CalibratedScene& scene, const BundleObservations& used) {
  CalibratedState state;
  for (const int v : used.view) {
    state.cameras.push_back({scene.views[v]->camera, scene.views[v]->camera_from_scene});
  }
  for (const auto& X : scene.points) {
    state.points.push_back(X ? Eigen::Vector4d(X->homogeneous().normalized())
                             : Eigen::Vector4d(Eigen::Vector4d::Zero()));
  }
  for (const auto& L : scene.lines) state.lines.push_back(L ? SpanOf(*L) : LineSpan::Zero());
  return state;
}

// False when something is not finite.
bool WriteCalibrated(const CalibratedState& state,
                     const BundleObservations& used,
                     CalibratedScene* scene) {
  bool finite = true;
  for (size_t i = 0; i < used.view.size(); ++i) {
    CalibratedView& view = *scene->views[used.view[i]];
    const auto& [camera, pose] = state.cameras[i];
    view.camera = camera;
    view.camera_from_scene.R = Eigen::Quaterniond(pose.R).normalized().toRotationMatrix();
    view.camera_from_scene.t = pose.t;
    finite = finite && pose.R.allFinite() && pose.t.allFinite() && camera.focal_px > 0.0 &&
             Eigen::Vector4d(camera.focal_px, camera.cx, camera.cy, camera.k1).allFinite();
  }
  for (size_t j = 0; j < scene->points.size(); ++j) {
    if (!scene->points[j]) continue;
    const Eigen::Vector3d x = state.points[j].hnormalized();
    // A point that went to infinity has no place in a metric scene.
    scene->points[j] = x.allFinite() ? std::optional<Eigen::Vector3d>(x) : std::nullopt;
  }
  for (size_t j = 0; j < scene->lines.size(); ++j) {
    if (!scene->lines[j]) continue;
    scene->lines[j] = LineOf(state.lines[j]);
    finite = finite && scene->lines[j]->allFinite();
  }
  return finite;
}

// Freedoms that neither images nor pose priors fix.
int GaugeFreedom(const Priors& priors) {
  const auto poses = std::count_if(
      priors.poses.begin(), priors.poses.end(), [](const auto& p) { return p.has_value(); });
  return poses == 0 ? 7 : poses == 1 ? 1 : 0;
}

void FillCovariance(const MultiviewTracks& tracks,
                    const BundleObservations& used,
                    const Priors& priors,
                    bool estimate_k1,
                    const CalibratedState& state,
                    CalibratedScene* scene,
                    CalibratedBundleSummary* summary) {
  // Deviations of normal residuals: no loss.
  const CalibratedModel model(tracks, used, priors, estimate_k1, RobustLoss::kNone, 1.0);
  const double cost = model.Cost(state);
  if (!std::isfinite(cost)) return;
  NormalEquations<kMetricCamera> normal;
  normal.SetZero(used.layout);
  model.Linearize(state, Bend::kWeights, &normal);
  const int tangent = estimate_k1 ? kMetricCamera : kMetricCamera - 1;  // k1 comes last
  TangentBases<kMetricCamera> bases = model.FeatureBases(state);
  bases.cameras.assign(
      used.layout.cameras,
      Eigen::Matrix<double, kMetricCamera, kMetricCamera>::Identity().leftCols(tangent));
  const int gauge = GaugeFreedom(priors);
  summary->covariance = InvertBundle<kMetricCamera>(used.layout, normal, bases, gauge);
  if (!summary->covariance) return;
  BundleCovariance& covariance = *summary->covariance;
  covariance.redundancy = Redundancy(used, bases, gauge) + priors.Residuals();
  covariance.variance_factor = 2.0 * cost / std::max(1, covariance.redundancy);
  summary->camera_tangent = tangent;
  // Residuals above the stated deviations widen the answer, smaller ones do not narrow it.
  const double factor = std::max(1.0, covariance.variance_factor);
  for (int i = 0; i < used.layout.cameras; ++i) {
    const int k = tangent * i + kLogFocal;
    scene->views[used.view[i]]->focal_log_sigma =
        std::sqrt(std::max(0.0, covariance.cameras(k, k) * factor));
  }
}

}  // namespace

CalibratedBundleSummary AdjustCalibrated(const MultiviewTracks& tracks,
                                         const ProjectiveScene& inliers,
                                         std::span<const ViewPrior> priors,
                                         const CalibratedBundleOptions& options,
                                         CalibratedScene* scene) {
  CalibratedBundleSummary summary;
  const BundleObservations used =
      SelectObservations(tracks, inliers, Known(scene->views, scene->points, scene->lines));
  if (used.observation.empty()) return summary;
  const Priors of_views = PriorsOf(tracks, used, priors, options);
  CalibratedState state = ReadCalibrated(*scene, used);
  const CalibratedModel model(
      tracks, used, of_views, options.estimate_k1, options.loss, options.loss_scale);
  BundleSolverOptions solver;
  solver.max_iterations = options.max_iterations;
  const BundleReport report = MinimizeBundle<kMetricCamera>(used.layout, solver, model, &state);
  if (!report.usable) return summary;
  CalibratedScene next = *scene;
  if (!WriteCalibrated(state, used, &next)) return summary;
  summary.usable = true;
  summary.cost = report.cost;
  double sigma2 = 0.0, px2 = 0.0;
  model.ForEachResidual(state, [&](int k, int f, double squared) {
    const int o = used.observation[k];
    const double sigma_px = f < used.points ? tracks.point_observations[o].sigma_px
                                            : tracks.line_observations[o].sigma_px;
    sigma2 += squared;
    px2 += squared * sigma_px * sigma_px;
  });
  const double rows = 2.0 * static_cast<double>(used.observation.size());
  summary.rms_sigma = std::sqrt(sigma2 / rows);
  summary.rms_px = std::sqrt(px2 / rows);
  if (options.covariance) {
    FillCovariance(tracks, used, of_views, options.estimate_k1, state, &next, &summary);
  }
  *scene = std::move(next);
  return summary;
}

}  // namespace horopter
