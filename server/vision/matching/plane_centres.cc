#include "server/vision/matching/plane_centres.h"

#include <Eigen/Dense>
#include <algorithm>
#include <cmath>
#include <random>
#include <tuple>
#include <utility>

#include "server/base/stop_scope.h"
#include "server/vision/matching/homography.h"
#include "server/vision/matching/plane_bundle.h"
#include "server/vision/matching/plane_epipole.h"

namespace horopter {
namespace {

constexpr int kMinToAdd = 4;        // points that must agree before a view joins; two always do
constexpr int kCentreRounds = 3;    // of refinement and new inliers
constexpr double kPairScore = 0.5;  // of a point in two views only: always consistent

PlaneEpipoleOptions EpipoleOptions(const PlaneCentresOptions& options) {
  return {options.inlier_px, options.hypotheses};
}

// Two views are the start of a bundle; false when they give nothing.
bool Start(int a, int b, const PlaneCentresOptions& options, std::mt19937* rng, PlaneBundle* out) {
  std::vector<PlaneParallax> shared;
  const Eigen::Matrix3d H = out->cameras[b].H * out->cameras[a].H.inverse();
  for (const PlaneBundlePoint& point : out->points) {
    const PlaneSight *in_a = point.In(a), *in_b = point.In(b);
    if (!in_a || !in_b) continue;
    const Eigen::Vector3d y = H * in_a->p;
    if (y.z() > 0.0) shared.push_back({y / y.z(), in_b->p});
  }
  const auto e = EpipoleFromParallax(shared, EpipoleOptions(options), rng);
  if (!e) return false;
  for (ParallaxCamera& c : out->cameras) c.known = false;
  out->cameras[a].known = out->cameras[b].known = true;
  out->cameras[a].e.setZero();
  out->cameras[b].e = *e;
  out->reference = a;
  out->scaled = b;
  return true;
}

// Adds the view that most points agree with; false when none has enough.
bool AddBestView(const PlaneCentresOptions& options, std::mt19937* rng, PlaneBundle* bundle) {
  int best_view = -1;
  PlaneResection best;
  for (size_t v = 0; v < bundle->cameras.size(); ++v) {
    if (bundle->cameras[v].known) continue;
    LeaveIfStopped();
    std::vector<PlaneResectionSight> sights;
    for (const PlaneBundlePoint& point : bundle->points) {
      const PlaneSight* s = point.In(static_cast<int>(v));
      if (s && point.valid) sights.push_back({point.X, s->p});
    }
    if (sights.size() < kMinToAdd) continue;
    const PlaneResection found =
        EpipoleFromPoints(bundle->cameras[v].H, sights, EpipoleOptions(options), rng);
    if (found.inliers < kMinToAdd || found.inliers < options.min_share * sights.size() ||
        found.inliers <= best.inliers) {
      continue;
    }
    best = found;
    best_view = static_cast<int>(v);
  }
  if (best_view < 0) return false;
  bundle->cameras[best_view].known = true;
  bundle->cameras[best_view].e = best.e;
  return true;
}

// Observations of points seen in >= 3 known views count, and of the others a little.
double BundleScore(const PlaneBundle& bundle) {
  double score = 0.0;
  for (const PlaneBundlePoint& point : bundle.points) {
    if (!point.valid) continue;
    int n = 0;
    for (const PlaneSight& s : point.seen) n += bundle.cameras[s.view].known;
    score += n >= 3 ? n : kPairScore;
  }
  return score;
}

// Evidence for a view over what is asked, at least 1 is enough: of the points that the other views
// fix, enough must be seen where this one sees them.
double Margin(const PlaneBundle& bundle, int view, const PlaneCentresOptions& options) {
  int possible = 0, consistent = 0;
  for (const PlaneBundlePoint& point : bundle.points) {
    const PlaneSight* seen = point.In(view);
    if (!seen) continue;
    const PlaneBundlePoint others = Triangulated(bundle, point, options.inlier_px, view);
    if (!others.valid) continue;
    ++possible;
    consistent +=
        ErrorPx(bundle.cameras[view], others.X, seen->p) < kOthersSlack * options.inlier_px;
  }
  return std::min(static_cast<double>(consistent) / options.min_off_plane,
                  possible > 0 ? consistent / (options.min_share * possible) : 0.0);
}

// Views that the others do not confirm are forgotten again, the least confirmed first.
void DropWeakViews(const PlaneCentresOptions& options, PlaneBundle* bundle) {
  while (true) {
    double worst = 1.0;
    int worst_view = -1;
    for (size_t v = 0; v < bundle->cameras.size(); ++v) {
      if (!bundle->cameras[v].known) continue;
      LeaveIfStopped();
      const double margin = Margin(*bundle, static_cast<int>(v), options);
      if (margin >= worst) continue;
      worst = margin;
      worst_view = static_cast<int>(v);
    }
    if (worst_view < 0) break;
    bundle->cameras[worst_view].known = false;
  }
  TriangulateAll(options.inlier_px, bundle);
}

// Largest displacement of the point against the plane, over the pairs of its views.
double Displacement(std::span<const PlaneView> views, const PlanePoint& point) {
  double largest = 0.0;
  const auto& first = point.observations.front();
  for (const auto& o : point.observations) {
    const Eigen::Matrix3d H =
        views[o.view].view_from_plane * views[first.view].view_from_plane.inverse();
    const double d = (Transfer(H, first.pixel) - o.pixel).norm();
    if (std::isfinite(d)) largest = std::max(largest, d);
  }
  return largest;
}

// What is estimated, in working coordinates.
struct WorkingProblem {
  std::vector<Eigen::Matrix3d> working_from_image;  // per view
  PlaneBundle bundle;                               // the points off the plane
  std::vector<int> point;                           // of those given, per point of the bundle
};

Eigen::Matrix3d Centred(const Eigen::Vector2d& c) {
  constexpr double s = kPlaneUnitPx;
  Eigen::Matrix3d T;
  T << 1 / s, 0, -c.x() / s, 0, 1 / s, -c.y() / s, 0, 0, 1;
  return T;
}

// Empty when a homography cannot be normalised or nothing is seen on the plane.
std::optional<WorkingProblem> Prepare(std::span<const PlaneView> views,
                                      std::span<const PlanePoint> points,
                                      const PlaneCentresOptions& options) {
  const int n = static_cast<int>(views.size());
  std::vector<Eigen::Vector2d> middle(n, Eigen::Vector2d::Zero());
  std::vector<int> count(n, 0);
  Eigen::Vector2d plane_middle = Eigen::Vector2d::Zero();
  int plane_count = 0;
  for (const PlanePoint& point : points) {
    for (const auto& o : point.observations) {
      middle[o.view] += o.pixel;
      ++count[o.view];
      const Eigen::Vector2d x = Transfer(views[o.view].view_from_plane.inverse(), o.pixel);
      if (!x.allFinite() || x.norm() > 1e5) continue;
      plane_middle += x;
      ++plane_count;
    }
  }
  if (plane_count == 0) return std::nullopt;
  plane_middle /= plane_count;
  WorkingProblem out;
  out.bundle.cameras.resize(n);
  for (int v = 0; v < n; ++v) {
    const Eigen::Matrix3d T =
        Centred(count[v] > 0 ? Eigen::Vector2d(middle[v] / count[v]) : Eigen::Vector2d(0, 0));
    const auto H =
        NormalizeDeterminant(T * views[v].view_from_plane * Centred(plane_middle).inverse());
    if (!H) return std::nullopt;
    out.working_from_image.push_back(T);
    out.bundle.cameras[v].H = *H;
  }
  for (size_t k = 0; k < points.size(); ++k) {
    if (points[k].observations.size() < 2 || Displacement(views, points[k]) <= options.on_plane_px)
      continue;
    PlaneBundlePoint point;
    for (const auto& o : points[k].observations)
      point.seen.push_back({o.view, out.working_from_image[o.view] * o.pixel.homogeneous()});
    out.bundle.points.push_back(std::move(point));
    out.point.push_back(static_cast<int>(k));
  }
  return out;
}

// The pairs of views that share most points, most first.
std::vector<std::pair<int, int>> StartPairs(const PlaneBundle& bundle, int max_pairs) {
  const int n = static_cast<int>(bundle.cameras.size());
  std::vector<std::tuple<int, int, int>> starts;
  for (int a = 0; a < n; ++a) {
    for (int b = a + 1; b < n; ++b) {
      int shared = 0;
      for (const PlaneBundlePoint& point : bundle.points) {
        int in = 0;
        for (const PlaneSight& s : point.seen) in += s.view == a || s.view == b;
        shared += in == 2;
      }
      if (shared >= kMinToAdd) starts.emplace_back(-shared, a, b);
    }
  }
  std::sort(starts.begin(), starts.end());
  if (static_cast<int>(starts.size()) > max_pairs) starts.resize(max_pairs);
  std::vector<std::pair<int, int>> out;
  for (const auto& [unused, a, b] : starts) out.emplace_back(a, b);
  return out;
}

// The best of the bundles that grow from the start pairs; empty when none does.
std::optional<PlaneBundle> Grow(const PlaneBundle& problem, const PlaneCentresOptions& options) {
  std::optional<PlaneBundle> best;
  double best_score = 0.0;
  for (const auto& [a, b] : StartPairs(problem, options.starts)) {
    LeaveIfStopped();
    std::mt19937 rng(options.seed);
    PlaneBundle bundle = problem;
    if (!Start(a, b, options, &rng, &bundle)) continue;
    TriangulateAll(options.inlier_px, &bundle);
    while (AddBestView(options, &rng, &bundle)) TriangulateAll(options.inlier_px, &bundle);
    const double score = BundleScore(bundle);
    if (score <= best_score) continue;
    best_score = score;
    best = std::move(bundle);
  }
  return best;
}

}  // namespace

PlaneCentres EstimatePlaneCentres(std::span<const PlaneView> views,
                                  std::span<const PlanePoint> points,
                                  const PlaneCentresOptions& options) {
  PlaneCentres result;
  const int n = static_cast<int>(views.size());
  result.epipoles.resize(n);
  result.point_used.assign(points.size(), false);
  const std::optional<WorkingProblem> problem = Prepare(views, points, options);
  if (!problem) return result;
  const std::vector<Eigen::Matrix3d>& T = problem->working_from_image;
  std::optional<PlaneBundle> best = Grow(problem->bundle, options);
  if (!best) return result;
  for (int round = 0; round < kCentreRounds; ++round) {
    LeaveIfStopped();
    AdjustPlaneBundle(&*best);
    TriangulateAll(options.inlier_px, &*best);
  }
  DropWeakViews(options, &*best);
  AdjustPlaneBundle(&*best);
  for (int a = 0; a < n; ++a) {
    for (int b = a + 1; b < n; ++b) {
      if (!best->cameras[a].known || !best->cameras[b].known) continue;
      PlaneCentres::Pair pair{a, b};
      pair.sigma_px = EpipolarSigmaPx(*best, a, b);
      if (!(pair.sigma_px <= options.max_sigma_px)) continue;
      pair.F = T[b].transpose() * FundamentalOf(best->cameras[a], best->cameras[b]) * T[a];
      pair.F /= pair.F.norm();
      result.pairs.push_back(pair);
    }
  }
  for (int v = 0; v < n; ++v) {
    if (best->cameras[v].known) result.epipoles[v] = T[v].inverse() * best->cameras[v].e;
  }
  for (size_t k = 0; k < best->points.size(); ++k)
    result.point_used[problem->point[k]] = best->points[k].valid;
  result.rms_px = RmsPx(*best);
  return result;
}

}  // namespace horopter
