#include "server/vision/reconstruction/plane_route.h"

#include <Eigen/Dense>
#include <algorithm>
#include <cmath>
#include <cstdio>
#include <utility>

#include "server/vision/reconstruction/bundle_adjustment.h"
#include "server/vision/reconstruction/plane_calibration.h"
#include "server/vision/reconstruction/tracks.h"
#include "server/vision/reconstruction/trust.h"

namespace horopter {
namespace {

constexpr double kOtherFocalLog = 0.1;  // log of the ratio of focal lengths that differ
constexpr int kStarts = 8;  // calibrations that are adjusted roughly, the likeliest first; for time
constexpr std::size_t kRefinedStarts = 2;  // of these adjusted with all points; for time
// Three views of a plane leave one unknown to the prior: more starts are tried on the points off
// it.
constexpr std::size_t kRefinedStartsOfFew = 5;
constexpr std::size_t kFewViews = 3;
constexpr int kMaxPlaneTracks = 240;
constexpr int kStartTracks = 80;                 // of them used to choose among the starts
constexpr double kGatesPx[] = {12.0, 5.0, 3.0};  // kept tracks, round by round
constexpr int kMinObservations = 12;             // of a registered view
constexpr double kMinParallaxPx = 4.0;           // of a point off the plane
constexpr double kMinViewAngle = 0.02;           // between two views' rays; less may be noise
constexpr double kTruncationPx = 3.0;            // of the cost that compares two solutions
constexpr double kFocalFloor = 0.005;
constexpr int kMinTrustedPoints = 8;  // off the plane

// Views of the component with most members; its id in `id`.
struct Component {
  int id = -1;
  std::vector<int> views;
};

Component LargestComponent(const std::vector<int>& component) {
  Component best;
  for (int id : component) {
    if (id < 0 || id == best.id) continue;
    std::vector<int> views;
    for (size_t v = 0; v < component.size(); ++v) {
      if (component[v] == id) views.push_back(static_cast<int>(v));
    }
    if (views.size() > best.views.size()) best = {id, std::move(views)};
  }
  return best;
}

void Renumber(const Component& component, std::vector<Track>* tracks) {
  for (Track& track : *tracks) {
    for (TrackObservation& o : track.observations) {
      o.view = static_cast<int>(std::find(component.views.begin(), component.views.end(), o.view) -
                                component.views.begin());
    }
  }
}

struct Solution {
  Bundle bundle;
  double cost = 1e300;
};

double TruncatedCost(const Bundle& bundle,
                     const std::vector<Track>& plane,
                     const std::vector<Track>& junctions) {
  double cost = 0.0;
  const double limit = kTruncationPx * kTruncationPx;
  for (const auto* tracks : {&plane, &junctions}) {
    for (const Track& track : *tracks) {
      BundlePoint point{track, Eigen::Vector3d::Zero(), track.on_plane};
      std::optional<Eigen::Vector3d> x;
      if (track.on_plane) {
        const TrackObservation& o = track.observations.front();
        x = PointOnPlane(bundle.views[o.view], o.point);
      } else {
        x = Triangulate(bundle, track, 0.0);
      }
      double e = kTruncationPx;
      if (x) {
        point.point_in_world = *x;
        e = WorstReprojection(bundle, point);
      }
      cost += std::min(e * e, limit);
    }
  }
  return cost;
}

double FocalPriorCost(const Bundle& bundle, const ReconstructionOptions& options) {
  double cost = 0.0;
  for (const BundleView& view : bundle.views) {
    const ViewPrior& given = view.prior;
    const double mean = given.focal_px.value_or(options.focal_prior_widths * view.size.width);
    const double d = std::log(view.focal_px / mean) /
                     (given.focal_px ? given.focal_log_sigma : options.focal_prior_log_sigma);
    cost += d * d;
  }
  return cost;
}

// Plane points of a start; false when they do not lie in front of the cameras.
bool AddPlanePoints(const std::vector<Track>& tracks, Bundle* bundle) {
  size_t lost = 0;
  for (const Track& track : tracks) {
    Eigen::Vector3d mean = Eigen::Vector3d::Zero();
    int seen = 0;
    for (const TrackObservation& o : track.observations) {
      if (const auto p = PointOnPlane(bundle->views[o.view], o.point)) {
        mean += *p;
        ++seen;
      }
    }
    if (seen == 0 || seen != static_cast<int>(track.observations.size())) {
      ++lost;
      continue;
    }
    bundle->points.push_back({track, mean / seen, true});
  }
  return lost * 5 <= tracks.size();
}

Bundle BundleFromStart(const CalibrationStart& start,
                       std::span<const ImageSize> sizes,
                       std::span<const ViewPrior> priors) {
  Bundle bundle;
  for (size_t i = 0; i < start.focal_px.size(); ++i) {
    BundleView view;
    view.size = sizes[i];
    view.focal_px = start.focal_px[i];
    view.k1 = priors[i].k1.value_or(0.0);
    view.camera_from_world = start.camera_from_world[i];
    view.prior = priors[i];
    bundle.views.push_back(std::move(view));
  }
  return bundle;
}

// Drops the worst observation of a track while it has more than two and does not fit.
bool FitTrack(const Bundle& bundle, double gate_px, BundlePoint* point) {
  while (true) {
    const auto x = Triangulate(bundle, point->track, kMinRayAngle);
    if (!x) return false;
    point->point_in_world = *x;
    if (WorstReprojection(bundle, *point) < gate_px) return true;
    std::vector<TrackObservation>& observations = point->track.observations;
    if (observations.size() <= 2) return false;
    double best = 1e300;
    size_t drop = 0;
    for (size_t k = 0; k < observations.size(); ++k) {
      BundlePoint without = *point;
      without.track.observations.erase(without.track.observations.begin() + static_cast<long>(k));
      const auto y = Triangulate(bundle, without.track, kMinRayAngle);
      if (!y) continue;
      without.point_in_world = *y;
      const double e = WorstReprojection(bundle, without);
      if (e < best) {
        best = e;
        drop = k;
      }
    }
    if (best >= 1e300) return false;
    observations.erase(observations.begin() + static_cast<long>(drop));
  }
}

// Refines one start on all tracks, gates tightening.
bool Refine(const std::vector<Track>& plane,
            const std::vector<Track>& junctions,
            const ReconstructionOptions& options,
            const StopRequested& stop,
            Bundle* bundle) {
  BundleOptions ba = options.bundle;
  ba.focal_prior_widths = options.focal_prior_widths;
  ba.focal_prior_log_sigma = options.focal_prior_log_sigma;
  const int rounds = static_cast<int>(std::size(kGatesPx));
  for (int round = 0; round < rounds; ++round) {
    if (IsStopRequested(stop)) return false;
    Bundle next;
    next.views = bundle->views;
    AddPlanePoints(plane, &next);
    std::erase_if(next.points, [&](const BundlePoint& p) {
      return WorstReprojection(next, p) > kGatesPx[round];
    });
    for (const Track& track : junctions) {
      BundlePoint point{track, Eigen::Vector3d::Zero(), false};
      if (FitTrack(*bundle, kGatesPx[round], &point)) next.points.push_back(std::move(point));
    }
    ba.covariance = round + 1 == rounds;
    if (!AdjustBundle(ba, &next).usable) return false;
    *bundle = std::move(next);
  }
  std::erase_if(bundle->points, [&](const BundlePoint& p) {
    return WorstReprojection(*bundle, p) > kGatesPx[rounds - 1];
  });
  return true;
}

// Best starts after a bundle adjustment on the plane alone, cheapest first.
std::vector<Solution> SolvePlane(const Component& component,
                                 const std::vector<Eigen::Matrix3d>& maps,
                                 std::span<const ImageSize> sizes,
                                 std::span<const ViewPrior> priors,
                                 const std::vector<Track>& plane,
                                 const ReconstructionOptions& options,
                                 const StopRequested& stop) {
  std::vector<ImageSize> component_sizes;
  std::vector<ViewPrior> component_priors;
  for (int v : component.views) {
    component_sizes.push_back(sizes[v]);
    component_priors.push_back(priors.empty() ? ViewPrior() : priors[v]);
  }
  std::vector<Solution> solutions;
  BundleOptions ba = options.start_bundle;
  ba.focal_prior_widths = options.focal_prior_widths;
  ba.focal_prior_log_sigma = options.focal_prior_log_sigma;
  for (const CalibrationStart& start :
       CalibrateFromPlane(maps, component_sizes, component_priors, options, kStarts)) {
    if (IsStopRequested(stop)) break;
    Solution s;
    s.bundle = BundleFromStart(start, component_sizes, component_priors);
    if (!AddPlanePoints(plane, &s.bundle)) continue;
    const BundleSummary summary = AdjustBundle(ba, &s.bundle);
    if (!summary.usable) continue;
    s.cost = summary.cost;
    const bool known = std::any_of(solutions.begin(), solutions.end(), [&](const Solution& other) {
      return std::abs(std::log(other.bundle.views[0].focal_px / s.bundle.views[0].focal_px)) <
                 0.05 &&
             (other.bundle.views[0].camera_from_world.R - s.bundle.views[0].camera_from_world.R)
                     .norm() < 0.1;
    });
    if (!known) solutions.push_back(std::move(s));
  }
  std::stable_sort(solutions.begin(), solutions.end(), [](const Solution& x, const Solution& y) {
    return x.cost < y.cost;
  });
  return solutions;
}

// Widest angle between the rays from two centres to the middle of the points. Moves along a ray do
// not count: a focal length hides them but for noise.
double WidestViewAngle(const Bundle& bundle) {
  Eigen::Vector3d middle = Eigen::Vector3d::Zero();
  for (const BundlePoint& p : bundle.points) middle += p.point_in_world;
  middle /= static_cast<double>(std::max<std::size_t>(1, bundle.points.size()));
  std::vector<Eigen::Vector3d> rays;
  for (const BundleView& v : bundle.views)
    rays.push_back((middle - v.camera_from_world.Inverse().t).normalized());
  double widest = 0.0;
  for (const Eigen::Vector3d& a : rays) {
    for (const Eigen::Vector3d& b : rays)
      widest = std::max(widest, std::atan2(a.cross(b).norm(), a.dot(b)));
  }
  return widest;
}

// A free point has parallax when no point of the plane explains its images.
bool HasParallax(const Bundle& bundle, const BundlePoint& point) {
  const TrackObservation& first = point.track.observations.front();
  const auto on_plane = PointOnPlane(bundle.views[first.view], first.point);
  if (!on_plane) return true;
  BundlePoint flat = point;
  flat.point_in_world = *on_plane;
  return WorstReprojection(bundle, flat) > kMinParallaxPx;
}

void ExportComponent(const Bundle& bundle, const Component& component, Reconstruction* result) {
  double squared = 0.0;
  int observations = 0, off_plane = 0;
  std::vector<int> per_view(bundle.views.size(), 0);
  for (const BundlePoint& p : bundle.points) {
    ReconstructedPoint out;
    out.point_in_world = p.point_in_world;
    out.on_plane = p.on_plane || !HasParallax(bundle, p);
    for (const TrackObservation& o : p.track.observations) {
      out.observations.emplace_back(component.views[o.view], o.junction);
      squared += (*ProjectInto(bundle.views[o.view], p.point_in_world) - o.point).squaredNorm();
      ++observations;
      ++per_view[o.view];
    }
    off_plane += !out.on_plane;
    result->points.push_back(std::move(out));
  }
  result->rms_px = observations > 0 ? std::sqrt(squared / observations) : 0.0;
  for (size_t i = 0; i < bundle.views.size(); ++i) {
    if (per_view[i] < kMinObservations) continue;
    const BundleView& v = bundle.views[i];
    CalibratedView out;
    const Eigen::Vector2d center = v.PrincipalPoint();
    out.camera = {v.size.width, v.size.height, v.focal_px, center.x(), center.y(), v.k1};
    out.camera_from_scene = v.camera_from_world;
    out.focal_log_sigma = v.focal_log_sigma > 0.0
                              ? std::hypot(std::hypot(kFocalFloor, v.focal_log_sigma_of_center),
                                           kFocalInflation * v.focal_log_sigma)
                              : 1e3;
    result->views[component.views[i]] = out;
  }
  result->counts["points_on_plane"] = static_cast<double>(bundle.points.size()) - off_plane;
  result->counts["points_off_plane"] = off_plane;
  result->counts["observations"] = observations;
}

void DecideTrust(const ReconstructionOptions& options,
                 double alternative_ratio,
                 Reconstruction* result) {
  double sigma = 0.0;
  int registered = 0;
  for (const auto& view : result->views) {
    if (!view) continue;
    ++registered;
    sigma = std::max(sigma, view->focal_log_sigma);
  }
  result->counts["views"] = registered;
  result->counts["focal_log_sigma"] = sigma;
  char text[200];
  text[0] = 0;
  if (registered < options.min_views) {
    std::snprintf(
        text, sizeof(text), "%d views registered, need %d", registered, options.min_views);
  } else if (!(result->rms_px <= options.max_rms_px)) {
    std::snprintf(
        text, sizeof(text), "rms %.2f px, need %.2f px", result->rms_px, options.max_rms_px);
  } else if (result->counts["points_off_plane"] < kMinTrustedPoints) {
    std::snprintf(text,
                  sizeof(text),
                  "%.0f points off the plane, need %d",
                  result->counts["points_off_plane"],
                  kMinTrustedPoints);
  } else if (sigma > kMaxTrustedFocalSigma) {
    std::snprintf(text,
                  sizeof(text),
                  "focal length known to %.0f %%, need %.0f %%",
                  100 * std::min(sigma, 10.0),
                  100 * kMaxTrustedFocalSigma);
  } else if (alternative_ratio < 1.1) {
    std::snprintf(text,
                  sizeof(text),
                  "a different calibration costs only %.2f times as much, need 1.1",
                  alternative_ratio);
  }
  result->refusal = text;
  result->trusted = result->refusal.empty();
}

// Cost of the second solution relative to the first, where its focal length is another.
double AlternativeRatio(const std::vector<Solution>& solutions) {
  if (solutions.size() < 2 ||
      !(std::abs(std::log(solutions[0].bundle.views[0].focal_px /
                          solutions[1].bundle.views[0].focal_px)) > kOtherFocalLog))
    return 1e9;
  return (solutions[1].cost + 1e-6) / (solutions[0].cost + 1e-6);
}

// The cheapest starts refined with all tracks, cheapest first; what does not converge costs 1e300.
void RefineSolutions(const std::vector<Track>& plane,
                     const std::vector<Track>& junctions,
                     std::size_t views,
                     const ReconstructionOptions& options,
                     const StopRequested& stop,
                     std::vector<Solution>* solutions) {
  const std::size_t refined = views <= kFewViews ? kRefinedStartsOfFew : kRefinedStarts;
  if (solutions->size() > refined) solutions->resize(refined);
  for (Solution& s : *solutions) {
    s.cost = Refine(plane, junctions, options, stop, &s.bundle)
                 ? TruncatedCost(s.bundle, plane, junctions) + FocalPriorCost(s.bundle, options)
                 : 1e300;
  }
  std::stable_sort(solutions->begin(), solutions->end(), [](const Solution& x, const Solution& y) {
    return x.cost < y.cost;
  });
}

}  // namespace

absl::StatusOr<Reconstruction> ReconstructFromPlane(const MatchingResult& matching,
                                                    std::span<const ImageFeatures> features,
                                                    std::span<const ImageSize> sizes,
                                                    std::span<const ViewPrior> priors,
                                                    const ReconstructionOptions& options,
                                                    const StopRequested& stop) {
  Reconstruction result;
  result.views.resize(sizes.size());
  const Component component = LargestComponent(matching.component);
  if (static_cast<int>(component.views.size()) < std::max(2, options.min_views)) {
    result.refusal = std::to_string(component.views.size()) + " views share a plane, need " +
                     std::to_string(std::max(2, options.min_views));
    return result;
  }
  std::vector<Eigen::Matrix3d> maps;
  for (int v : component.views) maps.push_back(matching.view_from_plane[v]);
  std::vector<Track> plane = PlaneTracks(matching, component.id, kMaxPlaneTracks);
  std::vector<Track> junctions = JunctionTracks(matching, features, component.id);
  Renumber(component, &plane);
  Renumber(component, &junctions);
  result.counts["plane_tracks"] = static_cast<double>(plane.size());
  result.counts["junction_tracks"] = static_cast<double>(junctions.size());

  const std::span<const Track> few(plane.data(), std::min<size_t>(plane.size(), kStartTracks));
  std::vector<Solution> solutions =
      SolvePlane(component, maps, sizes, priors, {few.begin(), few.end()}, options, stop);
  if (IsStopRequested(stop)) return absl::CancelledError("reconstruction: cancelled");
  if (solutions.empty()) {
    result.refusal =
        "no camera geometry fits the plane in " + std::to_string(component.views.size()) + " views";
    return result;
  }
  RefineSolutions(plane, junctions, component.views.size(), options, stop, &solutions);
  if (IsStopRequested(stop)) return absl::CancelledError("reconstruction: cancelled");
  const Bundle& best = solutions.front().bundle;
  if (solutions.front().cost >= 1e300) {
    result.refusal = "bundle adjustment did not converge";
    return result;
  }
  const double angle = WidestViewAngle(best);
  result.counts["widest_view_angle"] = angle;
  if (!(angle >= kMinViewAngle)) {
    char text[120];
    std::snprintf(text,
                  sizeof(text),
                  "no parallax: rays to the plane's middle within %.4f rad, need %.2f",
                  angle,
                  kMinViewAngle);
    result.refusal = text;
    return result;
  }
  result.has_plane = true;
  ExportComponent(best, component, &result);
  DecideTrust(options, AlternativeRatio(solutions), &result);
  return result;
}

}  // namespace horopter
