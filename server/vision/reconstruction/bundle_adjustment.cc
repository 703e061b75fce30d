#include "server/vision/reconstruction/bundle_adjustment.h"

#include <Eigen/Dense>
#include <algorithm>
#include <cmath>
#include <vector>

#include "server/vision/reconstruction/bundle_residuals.h"
#include "server/vision/reconstruction/robust_curvature.h"

namespace horopter {
namespace {

// Parameters of a camera that the bundle does not move: the principal point, which MoveCamera has
// between the focal length and k1.
constexpr int kCenter = kLogFocal + 1;
static_assert(kRadial == kCenter + 2);

struct PlaneState {
  std::vector<CalibratedCamera> cameras;
  std::vector<Eigen::Vector3d> points;
};

struct LensPrior {
  Eigen::Vector2d mean, sigma;  // log f, k1

  // In sigmas.
  Eigen::Vector2d Residual(const PinholeCamera& c) const {
    return (Eigen::Vector2d(std::log(c.focal_px), c.k1) - mean).cwiseQuotient(sigma);
  }
};

LensPrior LensPriorOf(const BundleView& view, const BundleOptions& options) {
  const ViewPrior& given = view.prior;
  LensPrior out{{std::log(options.focal_prior_widths * view.size.width), 0.0},
                {options.focal_prior_log_sigma, options.k1_sigma}};
  if (given.focal_px) {
    out.mean[0] = std::log(*given.focal_px);
    out.sigma[0] = given.focal_log_sigma;
  }
  if (given.k1) {
    out.mean[1] = *given.k1;
    out.sigma[1] = given.k1_sigma;
  }
  return out;
}

// A point's observations as the solver wants them, cameras ascending.
std::vector<PointObservation> ObservationsOf(const BundlePoint& point) {
  std::vector<PointObservation> out;
  for (const TrackObservation& o : point.track.observations)
    out.push_back({o.view, -1, o.point, 1.0});
  std::stable_sort(
      out.begin(), out.end(), [](const auto& x, const auto& y) { return x.view < y.view; });
  return out;
}

// MinimizeBundle's model. Points are Euclidean: the fourth parameter of the solver's features does
// not move, the third not where they lie on the plane. The bundle must outlive it.
class PlaneModel {
 public:
  PlaneModel(const BundleOptions& options, const Bundle& bundle)
      : bundle_(bundle), loss_px_(options.loss_px) {
    layout_.cameras = static_cast<int>(bundle.views.size());
    for (const BundlePoint& point : bundle.points) {
      for (const PointObservation& o : ObservationsOf(point)) {
        observations_.push_back(o);
        layout_.camera.push_back(o.view);
      }
      layout_.first.push_back(static_cast<int>(observations_.size()));
    }
    for (const BundleView& view : bundle.views) priors_.push_back(LensPriorOf(view, options));
  }

  const BundleLayout& layout() const { return layout_; }

  PlaneState Start() const {
    PlaneState state;
    for (const BundleView& v : bundle_.views) {
      const Eigen::Vector2d center = v.PrincipalPoint();
      state.cameras.push_back(
          {{v.size.width, v.size.height, v.focal_px, center.x(), center.y(), v.k1},
           v.camera_from_world});
    }
    for (const BundlePoint& point : bundle_.points) state.points.push_back(point.point_in_world);
    return state;
  }

  double Cost(const PlaneState& state) const {
    constexpr double kLeastDepth = 1e-6;  // units of the world
    double cost = 0.0;
    for (std::size_t i = 0; i < state.cameras.size(); ++i)
      cost += 0.5 * priors_[i].Residual(state.cameras[i].camera).squaredNorm();
    for (int f = 0; f < layout_.Features(); ++f) {
      for (int k = layout_.first[f]; k < layout_.first[f + 1]; ++k) {
        const CalibratedCamera& view = state.cameras[layout_.camera[k]];
        const Eigen::Vector3d c = view.camera_from_scene * state.points[f];
        if (!(c.z() >= kLeastDepth)) return INFINITY;
        const double r = (Project(view.camera, c) - observations_[k].pixel).norm();
        cost += RobustCost(RobustLoss::kCauchy, r, loss_px_);
      }
    }
    return cost;
  }

  void Linearize(const PlaneState& state, Bend bend, NormalEquations<kMetricCamera>* normal) const {
    Linearize(state, bend, false, normal);
  }

  // center: as if the principal points moved, too.
  void Linearize(const PlaneState& state,
                 Bend bend,
                 bool center,
                 NormalEquations<kMetricCamera>* normal) const {
    for (int f = 0; f < layout_.Features(); ++f) {
      const Eigen::Vector4d X = state.points[f].homogeneous();
      for (int k = layout_.first[f]; k < layout_.first[f + 1]; ++k) {
        const int i = layout_.camera[k];
        Linearized<kMetricCamera> l = horopter::Linearize(observations_[k], state.cameras[i], X);
        const double r = l.r.norm();
        const double weight = RobustWeight(RobustLoss::kCauchy, r, loss_px_);
        if (!(weight > 0.0)) continue;
        const double curvature =
            bend == Bend::kCurvature ? RobustCurvature(RobustLoss::kCauchy, r, loss_px_) : 1.0;
        if (!center) l.J_camera.middleCols<2>(kCenter).setZero();
        l.J_feature.rightCols(kFeatureParameters - bundle_.points[f].Coordinates()).setZero();
        normal->Add(k, i, f, weight, curvature, l.r, l.J_camera, l.J_feature);
      }
      Eigen::Matrix4d& V = normal->V[f];
      const double stiff = V.trace();
      for (int d = bundle_.points[f].Coordinates(); d < kFeatureParameters; ++d) V(d, d) = stiff;
    }
    for (std::size_t i = 0; i < priors_.size(); ++i) {
      const Eigen::Vector2d residual = priors_[i].Residual(state.cameras[i].camera);
      for (const auto& [row, d] : {std::pair(kLogFocal, 0), std::pair(kRadial, 1)}) {
        const double inverse = 1.0 / priors_[i].sigma[d];
        normal->U[i](row, row) += inverse * inverse;
        normal->camera_gradient[i](row) += inverse * residual[d];
      }
    }
  }

  PlaneState Moved(const PlaneState& state, const BundleStep<kMetricCamera>& step) const {
    PlaneState next = state;
    for (std::size_t i = 0; i < next.cameras.size(); ++i) {
      Eigen::Matrix<double, kMetricCamera, 1> moves = step.cameras[i];
      moves.segment<2>(kCenter).setZero();
      next.cameras[i] = MoveCamera(state.cameras[i], moves);
    }
    for (std::size_t f = 0; f < next.points.size(); ++f)
      next.points[f].head(bundle_.points[f].Coordinates()) +=
          step.features[f].head(bundle_.points[f].Coordinates());
    return next;
  }

  // Residuals, those of the priors with them, minus unknowns that are not gauge: moves and turns of
  // the plane within itself, and the scale.
  int Redundancy() const {
    constexpr int kMoving = kMetricCamera - 2, kGauge = 4;
    int redundancy =
        2 * static_cast<int>(observations_.size()) + (2 - kMoving) * layout_.cameras + kGauge;
    for (const BundlePoint& point : bundle_.points)
      redundancy -= point.track.observations.empty() ? 0 : point.Coordinates();
    return redundancy;
  }

 private:
  const Bundle& bundle_;
  double loss_px_;
  BundleLayout layout_;
  std::vector<PointObservation> observations_;
  std::vector<LensPrior> priors_;
};

// Every view's log f moves with the observations' noise and with the principal points, which are
// fixed: what their own deviation adds is propagated as that of consider parameters (Schmidt 1966),
// C = s^2 N^-1 + S Sigma S^T. With the points eliminated, N is the other parameters' block of the
// cameras' system and S = N^-1 times its block beside the principal points.
void FillFocalDeviations(const BundleOptions& options,
                         double cost,
                         const PlaneModel& model,
                         const PlaneState& state,
                         Bundle* bundle) {
  constexpr double kDamping = 1e-9;  // of the diagonal: the gauge is free, and no focal length's
  NormalEquations<kMetricCamera> normal;
  normal.SetZero(model.layout());
  model.Linearize(state, Bend::kWeights, true, &normal);
  SchurComplement<kMetricCamera> schur;
  if (!EliminateFeatures(model.layout(), normal, kDamping, &schur)) return;
  const Eigen::MatrixXd whole = schur.S.selfadjointView<Eigen::Upper>();
  std::vector<int> moving, centers, of_focal;
  for (int i = 0; i < model.layout().cameras; ++i) {
    of_focal.push_back(static_cast<int>(moving.size()) + kLogFocal);
    for (int k = 0; k < kMetricCamera; ++k)
      (k == kCenter || k == kCenter + 1 ? centers : moving).push_back(kMetricCamera * i + k);
  }
  const Eigen::MatrixXd N = whole(moving, moving);
  const Eigen::LLT<Eigen::MatrixXd> llt(N);
  if (llt.info() != Eigen::Success) return;
  Eigen::MatrixXd units = Eigen::MatrixXd::Zero(N.rows(), std::ssize(of_focal));
  for (std::size_t i = 0; i < of_focal.size(); ++i) units(of_focal[i], i) = 1.0;
  const Eigen::MatrixXd of_focals = llt.solve(units);  // columns of N^-1
  if (!of_focals.allFinite()) return;
  const Eigen::MatrixXd S = of_focals.transpose() * whole(moving, centers);
  const double variance = std::max(2.0 * cost / std::max(1, model.Redundancy()), 0.01);
  for (std::size_t i = 0; i < of_focal.size(); ++i) {
    BundleView& view = bundle->views[i];
    const double noise = of_focals(of_focal[i], i) * variance;
    if (!(noise >= 0.0)) continue;
    double center = 0.0;
    for (std::size_t k = 0; k < centers.size(); ++k) {
      const double sigma_px = bundle->views[k / 2].PrincipalPointSigmaPx(options);
      center += S(i, k) * S(i, k) * sigma_px * sigma_px;
    }
    view.focal_log_sigma = std::sqrt(noise);
    view.focal_log_sigma_of_center = std::sqrt(center);
  }
}

bool IsFinite(const PlaneState& state) {
  return std::all_of(state.cameras.begin(),
                     state.cameras.end(),
                     [](const CalibratedCamera& c) {
                       return std::isfinite(c.camera.focal_px) && std::isfinite(c.camera.k1) &&
                              c.camera_from_scene.R.allFinite() &&
                              c.camera_from_scene.t.allFinite();
                     }) &&
         std::all_of(
             state.points.begin(), state.points.end(), [](const auto& x) { return x.allFinite(); });
}

// The similarity of the plane that takes the first view's centre back to where it was and undoes
// its turn about the normal.
void FixGauge(const Rigid3& first, PlaneState* state) {
  const Rigid3& moved = state->cameras[0].camera_from_scene;
  const Eigen::Vector3d was = first.Inverse().t, is = moved.Inverse().t;
  const double scale = was.z() / is.z();
  if (!(scale > 0.0) || !std::isfinite(scale)) return;
  const Eigen::Matrix3d turn = first.R.transpose() * moved.R;  // nearest turn about z
  const double angle = std::atan2(turn(1, 0) - turn(0, 1), turn(0, 0) + turn(1, 1));
  const Eigen::Matrix3d R = Eigen::AngleAxisd(angle, Eigen::Vector3d::UnitZ()).toRotationMatrix();
  const Eigen::Vector3d t = was - scale * (R * is);  // z: 0 but for rounding
  for (CalibratedCamera& c : state->cameras) {
    const Eigen::Vector3d center = scale * (R * c.camera_from_scene.Inverse().t) + t;
    c.camera_from_scene.R = c.camera_from_scene.R * R.transpose();
    c.camera_from_scene.t = -(c.camera_from_scene.R * center);
  }
  for (Eigen::Vector3d& x : state->points) {
    const bool flat = x.z() == 0.0;
    x = scale * (R * x) + t;
    if (flat) x.z() = 0.0;
  }
}

}  // namespace

BundleSummary AdjustBundle(const BundleOptions& options, Bundle* bundle) {
  BundleSummary summary;
  if (bundle->views.empty()) return summary;
  const PlaneModel model(options, *bundle);
  PlaneState state = model.Start();
  if (!IsFinite(state)) return summary;
  BundleSolverOptions solver;
  solver.max_iterations = options.max_iterations;
  const BundleReport report = MinimizeBundle<kMetricCamera>(model.layout(), solver, model, &state);
  if (!report.usable || !IsFinite(state)) return summary;
  summary.usable = true;
  summary.cost = report.cost;
  if (options.covariance) FillFocalDeviations(options, report.cost, model, state, bundle);
  FixGauge(bundle->views[0].camera_from_world, &state);
  for (std::size_t i = 0; i < bundle->views.size(); ++i) {
    BundleView& view = bundle->views[i];
    const auto& [camera, pose] = state.cameras[i];
    view.focal_px = camera.focal_px;
    view.k1 = camera.k1;
    view.camera_from_world = {Eigen::Quaterniond(pose.R).normalized().toRotationMatrix(), pose.t};
  }
  for (std::size_t k = 0; k < bundle->points.size(); ++k)
    bundle->points[k].point_in_world = state.points[k];
  return summary;
}

std::optional<Eigen::Vector2d> ProjectInto(const BundleView& view,
                                           const Eigen::Vector3d& point_in_world) {
  const Eigen::Vector3d c = view.camera_from_world * point_in_world;
  if (!(c.z() > 1e-6)) return std::nullopt;
  const Eigen::Vector2d center = view.PrincipalPoint();
  return Project(
      {view.size.width, view.size.height, view.focal_px, center.x(), center.y(), view.k1}, c);
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
  const Eigen::Vector2d d = (pixel - view.PrincipalPoint()) / view.focal_px;
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
      constexpr double kStep = 1e-6;  // of a numerical derivative, units of the scene
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
