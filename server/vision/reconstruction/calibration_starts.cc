#include "server/vision/reconstruction/calibration_starts.h"

#include <Eigen/Dense>
#include <algorithm>
#include <array>
#include <cmath>

#include "server/base/stop_scope.h"

namespace horopter {
namespace {

// Deviations at which the plausibility of a camera is measured: relative aspect, skew, and
// principal point (image widths). Wider than the priors: starts are coarse.
constexpr double kAspectSigma = 0.05;
constexpr double kSkewSigma = 0.05;
constexpr double kCenterSigma = 0.1;
constexpr double kViewCap = 25.0;          // one wrong view does not decide
constexpr double kDistinct = 0.08;         // log focal lengths
constexpr double kMinShareInFront = 0.65;  // of all points before all cameras; mirrored views fail

// Cameras in units of the image width about its centre (or the given principal point).
struct Frame {
  Eigen::Matrix3d unit_from_pixel;
  double width = 1.0;
};

std::vector<Frame> Frames(const MultiviewTracks& tracks, std::span<const ViewPrior> priors) {
  std::vector<Frame> frames;
  for (size_t v = 0; v < tracks.sizes.size(); ++v) {
    const ImageSize& size = tracks.sizes[v];
    Eigen::Vector2d c(0.5 * (size.width - 1), 0.5 * (size.height - 1));
    if (!priors.empty() && priors[v].principal_point_px) c = *priors[v].principal_point_px;
    Frame frame;
    frame.width = size.width;
    frame.unit_from_pixel << 1.0, 0, -c.x(), 0, 1.0, -c.y(), 0, 0, frame.width;
    frame.unit_from_pixel /= frame.width;
    frames.push_back(frame);
  }
  return frames;
}

// Squared focal length (widths^2) and implausibility of a camera K R up to scale.
struct Judged {
  double focal2 = 0.0;
  double cost = kViewCap;
};

Judged Judge(const Eigen::Matrix3d& M) {
  const Eigen::Matrix3d dual = M * M.transpose();  // ~ K K^T
  const double s = 1.0 / dual(2, 2);
  const double cx = dual(0, 2) * s, cy = dual(1, 2) * s;
  const double fx2 = dual(0, 0) * s - cx * cx, fy2 = dual(1, 1) * s - cy * cy;
  Judged out;
  out.focal2 = 0.5 * (fx2 + fy2);
  if (!(fx2 > 0.0) || !(fy2 > 0.0)) return out;
  const double aspect = (fx2 - fy2) / (fx2 + fy2) / kAspectSigma;
  const double skew = (dual(0, 1) * s - cx * cy) / out.focal2 / kSkewSigma;
  const double center = (cx * cx + cy * cy) / (kCenterSigma * kCenterSigma);
  out.cost = std::min(kViewCap, aspect * aspect + skew * skew + center);
  return out;
}

struct Hypothesis {
  double cost = 0.0;
  Eigen::Matrix4d H;  // projective from metric
  std::vector<double> log_focal;
};

double PriorCost(double log_focal_widths,
                 const Frame& frame,
                 const ViewPrior& prior,
                 const SelfCalibrationOptions& options) {
  double mean = std::log(options.bundle.focal_prior_widths);
  double sigma = options.bundle.focal_prior_log_sigma;
  if (prior.focal_px) {
    mean = std::log(*prior.focal_px / frame.width);
    sigma = std::max(prior.focal_log_sigma, 0.05);
  }
  const double d = (log_focal_widths - mean) / sigma;
  return d * d;
}

std::vector<double> FocalGrid(const SelfCalibrationOptions& options,
                              const ViewPrior& prior,
                              const Frame& frame) {
  if (prior.focal_px) return {*prior.focal_px / frame.width};
  std::vector<double> grid;
  const double ratio = options.max_focal_widths / options.min_focal_widths;
  for (int k = 0; k < options.focal_steps; ++k) {
    grid.push_back(options.min_focal_widths *
                   std::pow(ratio, static_cast<double>(k) / (options.focal_steps - 1)));
  }
  return grid;
}

// Pairs of views spread over the set: all of them when there are few.
std::vector<std::array<int, 2>> SomePairs(const std::vector<int>& views, int most) {
  std::vector<std::array<int, 2>> pairs;
  const int n = static_cast<int>(views.size());
  for (int gap = n - 1; gap >= 1; --gap) {  // far ones first: their baselines are long
    for (int i = 0; i + gap < n; ++i) pairs.push_back({views[i], views[i + gap]});
  }
  if (static_cast<int>(pairs.size()) > most) pairs.resize(most);
  return pairs;
}

// Points of a projective scene in a metric frame, and where they lie.
struct MetricPoints {
  std::vector<std::optional<Eigen::Vector3d>> of_scene;
  std::vector<Eigen::Vector3d> known;
  Eigen::Vector3d mean = Eigen::Vector3d::Zero();
  double spread = 0.0;  // root of the mean squared distance from `mean`
};

// nullopt: none, or all in one place.
std::optional<MetricPoints> UpgradePoints(const ProjectiveScene& unit,
                                          const Eigen::Matrix4d& metric_from_projective) {
  MetricPoints out;
  out.of_scene.resize(unit.points.size());
  for (size_t j = 0; j < unit.points.size(); ++j) {
    if (!unit.points[j]) continue;
    const Eigen::Vector4d X = metric_from_projective * *unit.points[j];
    const Eigen::Vector3d x = X.head<3>() / X.w();
    if (!x.allFinite()) continue;
    out.of_scene[j] = x;
    out.known.push_back(x);
    out.mean += x;
  }
  if (out.known.empty()) return std::nullopt;
  out.mean /= static_cast<double>(out.known.size());
  for (const Eigen::Vector3d& x : out.known) out.spread += (x - out.mean).squaredNorm();
  out.spread = std::sqrt(out.spread / static_cast<double>(out.known.size()));
  if (!(out.spread > 0.0) || !std::isfinite(out.spread)) return std::nullopt;
  return out;
}

// Metric cameras and structure of a plane at infinity; nullopt when a camera is not plausible.
std::optional<CalibratedScene> Upgrade(const MultiviewTracks& tracks,
                                       const ProjectiveScene& unit,
                                       const std::vector<Frame>& frames,
                                       std::span<const ViewPrior> priors,
                                       const Hypothesis& hypothesis) {
  CalibratedScene out;
  out.views.resize(unit.cameras.size());
  out.lines.resize(unit.lines.size());
  const Eigen::Matrix4d metric_from_projective = hypothesis.H.inverse();
  if (!metric_from_projective.allFinite()) return std::nullopt;
  std::optional<MetricPoints> points = UpgradePoints(unit, metric_from_projective);
  if (!points) return std::nullopt;
  out.points = std::move(points->of_scene);
  int votes = 0;  // depths in front minus behind
  for (size_t v = 0; v < unit.cameras.size(); ++v) {
    if (!unit.cameras[v]) continue;
    const CameraMatrix P = *unit.cameras[v] * hypothesis.H;
    const Judged judged = Judge(P.leftCols<3>());
    if (!(judged.focal2 > 0.0)) return std::nullopt;
    const double f = std::sqrt(judged.focal2);
    CameraMatrix N = Eigen::Vector3d(1.0 / f, 1.0 / f, 1.0).asDiagonal() * P;
    if (N.leftCols<3>().determinant() < 0.0) N = -N;
    const Eigen::JacobiSVD<Eigen::Matrix3d> svd(N.leftCols<3>(),
                                                Eigen::ComputeFullU | Eigen::ComputeFullV);
    CalibratedView view;
    view.camera =
        CenteredCamera(tracks.sizes[v].width, tracks.sizes[v].height, f * frames[v].width);
    if (!priors.empty() && priors[v].principal_point_px) {
      view.camera.cx = priors[v].principal_point_px->x();
      view.camera.cy = priors[v].principal_point_px->y();
    }
    if (!priors.empty() && priors[v].k1) view.camera.k1 = *priors[v].k1;
    view.camera_from_scene.R = svd.matrixU() * svd.matrixV().transpose();
    view.camera_from_scene.t = N.col(3) / svd.singularValues().mean();
    if (!view.camera_from_scene.t.allFinite()) return std::nullopt;
    for (const Eigen::Vector3d& x : points->known) {
      votes += (view.camera_from_scene * x).z() > 0.0 ? 1 : -1;
    }
    out.views[v] = view;
  }
  // Depths decide between the scene and its reflection in a point.
  const double sign = votes < 0 ? -1.0 : 1.0, spread = points->spread;
  const Eigen::Vector3d& mean = points->mean;
  Eigen::Matrix4d S = Eigen::Matrix4d::Identity();
  S.topLeftCorner<3, 3>() *= sign / spread;
  S.topRightCorner<3, 1>() = -sign / spread * mean;
  for (auto& x : out.points) {
    if (x) x = Eigen::Vector3d(sign / spread * (*x - mean));
  }
  for (auto& view : out.views) {
    if (!view) continue;
    Rigid3& pose = view->camera_from_scene;
    pose.t = sign / spread * (pose.R * mean + pose.t);
  }
  const Eigen::Matrix4d to_scene = S * metric_from_projective;
  for (size_t j = 0; j < unit.lines.size(); ++j) {
    if (unit.lines[j]) out.lines[j] = MapLine(to_scene, *unit.lines[j]).normalized();
  }
  return out;
}

double ShareInFront(const CalibratedScene& scene) {
  int front = 0, all = 0;
  for (const auto& view : scene.views) {
    if (!view) continue;
    for (const auto& x : scene.points) {
      if (!x) continue;
      front += (view->camera_from_scene * *x).z() > 0.0;
      ++all;
    }
  }
  return all > 0 ? static_cast<double>(front) / all : 0.0;
}

// Planes at infinity by pairs of cameras and a grid of their focal lengths, with what each costs in
// all views.
std::vector<Hypothesis> PlanesOfPairs(const ProjectiveScene& unit,
                                      const std::vector<int>& views,
                                      const std::vector<Frame>& frames,
                                      std::span<const ViewPrior> priors,
                                      const SelfCalibrationOptions& options) {
  const auto prior = [&](int view) { return priors.empty() ? ViewPrior() : priors[view]; };
  std::vector<Hypothesis> hypotheses;
  for (const auto& [a, b] : SomePairs(views, options.max_pairs)) {
    const Eigen::Matrix4d canonical = CanonicalFrame(*unit.cameras[a]);
    if (!canonical.allFinite()) continue;
    for (const double fa : FocalGrid(options, prior(a), frames[a])) {
      LeaveIfStopped();
      for (const double fb : FocalGrid(options, prior(b), frames[b])) {
        for (const double sign : {1.0, -1.0}) {
          const Eigen::Matrix3d K_a = Eigen::Vector3d(fa, fa, 1.0).asDiagonal();
          const Eigen::Matrix3d K_b = Eigen::Vector3d(fb, fb, 1.0).asDiagonal();
          const auto v = PlaneAtInfinity(sign * *unit.cameras[b] * canonical, K_a, K_b);
          if (!v) continue;
          Eigen::Matrix4d upgrade = Eigen::Matrix4d::Identity();
          upgrade.topLeftCorner<3, 3>() = K_a;
          upgrade.bottomLeftCorner<1, 3>() = v->transpose();
          Hypothesis h;
          h.H = canonical * upgrade;
          for (const int view : views) {
            const Judged judged = Judge((*unit.cameras[view] * h.H).leftCols<3>());
            const double log_focal = judged.focal2 > 0.0 ? 0.5 * std::log(judged.focal2) : 0.0;
            h.log_focal.push_back(log_focal);
            h.cost += judged.cost + PriorCost(log_focal, frames[view], prior(view), options);
          }
          if (std::isfinite(h.cost)) hypotheses.push_back(std::move(h));
        }
      }
    }
  }
  return hypotheses;
}

}  // namespace

std::optional<Eigen::Vector3d> PlaneAtInfinity(const CameraMatrix& P_b,
                                               const Eigen::Matrix3d& K_a,
                                               const Eigen::Matrix3d& K_b) {
  const Eigen::Matrix3d inverse = K_b.inverse();
  const Eigen::Matrix3d Q = inverse * P_b.leftCols<3>() * K_a;
  const Eigen::Vector3d q = inverse * P_b.col(3);
  const double length = q.norm();
  if (!(length > 1e-12)) return std::nullopt;
  // A rotation that takes q to the x axis.
  const Eigen::Matrix3d R =
      Eigen::Quaterniond::FromTwoVectors(q, Eigen::Vector3d::UnitX()).toRotationMatrix();
  const Eigen::Matrix3d W = R * Q;
  const Eigen::Vector3d w1 = W.row(0), w2 = W.row(1), w3 = W.row(2);
  const double w3_norm = w3.norm();
  if (!(w3_norm > 1e-12)) return std::nullopt;
  const Eigen::Vector3d v = (w2.cross(w3) / w3_norm - w1) / length;
  return v.allFinite() ? std::optional<Eigen::Vector3d>(v) : std::nullopt;
}

std::vector<CalibratedScene> FindCalibrationStarts(const MultiviewTracks& tracks,
                                                   const ProjectiveScene& scene,
                                                   std::span<const ViewPrior> priors,
                                                   const SelfCalibrationOptions& options) {
  const std::vector<Frame> frames = Frames(tracks, priors);
  ProjectiveScene unit = scene;
  std::vector<int> views;
  for (size_t v = 0; v < unit.cameras.size(); ++v) {
    if (!unit.cameras[v]) continue;
    unit.cameras[v] = frames[v].unit_from_pixel * *unit.cameras[v];
    unit.cameras[v] = CameraMatrix(*unit.cameras[v] / unit.cameras[v]->norm());
    views.push_back(static_cast<int>(v));
  }
  std::vector<Hypothesis> hypotheses = PlanesOfPairs(unit, views, frames, priors, options);
  std::stable_sort(hypotheses.begin(), hypotheses.end(), [](const auto& x, const auto& y) {
    return x.cost < y.cost;
  });
  std::vector<CalibratedScene> starts;
  std::vector<std::vector<double>> taken;
  constexpr size_t kExamined = 200;  // of the cheapest; the rest only repeats them
  for (size_t k = 0; k < std::min(hypotheses.size(), kExamined); ++k) {
    if (static_cast<int>(starts.size()) >= options.max_starts) break;
    LeaveIfStopped();
    const Hypothesis& h = hypotheses[k];
    const bool known = std::any_of(taken.begin(), taken.end(), [&](const auto& other) {
      double worst = 0.0;
      for (size_t i = 0; i < other.size(); ++i) {
        worst = std::max(worst, std::abs(other[i] - h.log_focal[i]));
      }
      return worst < kDistinct;
    });
    if (known) continue;
    auto start = Upgrade(tracks, unit, frames, priors, h);
    // The other sign of the same plane, which has half of the scene behind its cameras.
    if (!start || ShareInFront(*start) < kMinShareInFront) continue;
    taken.push_back(h.log_focal);
    starts.push_back(std::move(*start));
  }
  return starts;
}

}  // namespace horopter
