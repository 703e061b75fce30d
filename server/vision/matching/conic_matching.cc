#include "server/vision/matching/conic_matching.h"

#include <algorithm>
#include <cmath>
#include <map>
#include <string>
#include <utility>

#include "server/vision/features/ellipse_frame.h"
#include "server/vision/geometry/fundamental_matrix.h"
#include "server/vision/matching/assignment.h"
#include "server/vision/matching/camera_matching.h"
#include "server/vision/matching/feature_tracks.h"

namespace horopter {
namespace {

constexpr int kPointsOfArc = 16;
constexpr double kCentreShare = 0.35;    // of a semi-axis: an ellipse's centre is not the circle's
constexpr double kOtherViewGate = 2.0;   // times the gate: two views tell depth roughly
constexpr double kOtherViewRatio = 4.0;  // log-likelihood ratio of a view that agrees
constexpr double kDoubt = 4.0;           // of a rival: less is no difference
constexpr std::size_t kLeastViewsOfEllipse = 3;  // two leave an ellipse two constraints

struct UsableArc {
  int arc = -1;
  ConicSight sight;
  Eigen::Vector2d centre;  // without the lens
  double semi_major_px = 0.0;
};

// A match with its circle.
struct Candidate {
  ConicMatch match;
  SpaceConic circle;
};

std::vector<UsableArc> UsableArcs(const ImageFeatures& features,
                                  const CalibratedCamera& view,
                                  const ConicMatchingOptions& options) {
  std::vector<UsableArc> out;
  for (int i = 0; i < std::ssize(features.arcs); ++i) {
    const EllipseArc& arc = features.arcs[i];
    if (arc.sweep_rad < options.min_sweep_rad || arc.semi_minor_px < options.min_semi_minor_px)
      continue;
    const Eigen::Vector2d centre = view.camera.focal_px * NormalizedPoint(view.camera, arc.center) +
                                   Eigen::Vector2d(view.camera.cx, view.camera.cy);
    out.push_back({i, SightOfArc(arc, view), centre, arc.semi_major_px});
  }
  return out;
}

double RmsOf(const std::vector<double>& distances) {
  double sum = 0.0;
  for (const double d : distances) sum += d * d;
  return std::sqrt(sum / static_cast<double>(distances.size()));
}

std::vector<Candidate> CandidatesOf(const std::vector<UsableArc>& a,
                                    const std::vector<UsableArc>& b,
                                    const ConicMatchingOptions& options) {
  std::vector<Candidate> out;
  if (a.empty() || b.empty()) return out;
  const Eigen::Matrix3d F =
      FundamentalFromCameras(MatrixOf(a[0].sight.view), MatrixOf(b[0].sight.view));
  const SpaceConicOptions fit = {options.sigma_px, options.gate_px};
  for (const UsableArc& x : a) {
    for (const UsableArc& y : b) {
      const double reach =
          options.gate_px + kCentreShare * std::max(x.semi_major_px, y.semi_major_px);
      if (SampsonSquared(F, x.centre, y.centre) > reach * reach) continue;
      const auto circle = FitSpaceCircle(std::vector<ConicSight>{x.sight, y.sight}, fit);
      if (!circle || circle->rms_px > options.gate_px) continue;
      const double ratio = 0.5 *
                           (options.gate_px * options.gate_px - circle->rms_px * circle->rms_px) /
                           (options.sigma_px * options.sigma_px);
      out.push_back({{x.arc, y.arc, ratio, 0}, *circle});
    }
  }
  return out;
}

// Counts the other views that show the candidate's circle.
void AskOtherViews(std::span<const std::vector<UsableArc>> arcs,
                   int view_a,
                   int view_b,
                   const ConicMatchingOptions& options,
                   std::vector<Candidate>* candidates) {
  for (Candidate& candidate : *candidates) {
    for (int v = 0; v < std::ssize(arcs); ++v) {
      if (v == view_a || v == view_b) continue;
      candidate.match.other_views +=
          std::any_of(arcs[v].begin(), arcs[v].end(), [&](const UsableArc& arc) {
            return RmsOf(DistancesToImage(candidate.circle, arc.sight)) <=
                   kOtherViewGate * options.gate_px;
          });
    }
    candidate.match.log_ratio += kOtherViewRatio * candidate.match.other_views;
  }
}

// One to one, likeliest first; none that is hardly likelier than a rival and that no other view
// shows.
std::vector<ConicMatch> Choose(const std::vector<Candidate>& candidates) {
  AssignmentProblem problem;
  std::vector<double> likelihood;
  std::map<int, int> columns;  // of arcs of view b
  for (const Candidate& c : candidates) {
    problem.row.push_back(c.match.arc_a);
    problem.column.push_back(
        columns.emplace(c.match.arc_b, static_cast<int>(columns.size())).first->second);
    problem.self.push_back(static_cast<float>(c.match.log_ratio));
    problem.begin.push_back(0);
    likelihood.push_back(c.match.log_ratio);
  }
  std::vector<ConicMatch> out;
  for (const int i : Discretize(problem, likelihood)) {
    const ConicMatch& m = candidates[i].match;
    const bool doubtful =
        m.other_views == 0 &&
        std::any_of(candidates.begin(), candidates.end(), [&](const Candidate& c) {
          const bool rival = (c.match.arc_a == m.arc_a) != (c.match.arc_b == m.arc_b);
          return rival && c.match.log_ratio > m.log_ratio - kDoubt;
        });
    if (!doubtful) out.push_back(m);
  }
  std::sort(out.begin(), out.end(), [](const auto& x, const auto& y) { return x.arc_a < y.arc_a; });
  return out;
}

// The conic of a track; of three views and more the one that fits worst may be left out.
std::optional<TrackedConic> ConicOf(const FeatureTrack& track,
                                    std::span<const ImageFeatures> features,
                                    std::span<const std::optional<CalibratedCamera>> cameras,
                                    const SpaceConicOptions& options) {
  std::vector<ConicSight> sights;
  for (const FeatureTrack::Feature& f : track.features)
    sights.push_back(SightOfArc(features[f.view].arcs[f.feature], *cameras[f.view]));
  const auto fit = [&](const std::vector<ConicSight>& some) -> std::optional<SpaceConic> {
    if (some.size() >= kLeastViewsOfEllipse) return FitSpaceConic(some, options);
    auto circle = FitSpaceCircle(some, options);
    if (circle && circle->rms_px > options.max_rms_px) circle.reset();
    return circle;
  };
  if (auto all = fit(sights)) return TrackedConic{track, *std::move(all)};
  std::optional<TrackedConic> best;
  for (std::size_t left_out = 0; sights.size() > 2 && left_out < sights.size(); ++left_out) {
    std::vector<ConicSight> some = sights;
    some.erase(some.begin() + static_cast<std::ptrdiff_t>(left_out));
    auto found = fit(some);
    if (!found || (best && best->conic.rms_px <= found->rms_px)) continue;
    best = TrackedConic{track, *std::move(found)};
    best->track.features.erase(best->track.features.begin() +
                               static_cast<std::ptrdiff_t>(left_out));
  }
  return best;
}

}  // namespace

ConicSight SightOfArc(const EllipseArc& arc, const CalibratedCamera& view) {
  ConicSight sight;
  sight.view = view;
  const EllipseFrame frame(arc);
  for (int k = 0; k < kPointsOfArc; ++k) {
    const double s = arc.start_rad + arc.sweep_rad * (k + 0.5) / kPointsOfArc;
    sight.points.push_back(frame.PointAt(UnitAt(s)));
  }
  return sight;
}

absl::StatusOr<ConicMatching> MatchConics(std::span<const ImageFeatures> features,
                                          std::span<const std::optional<CalibratedCamera>> cameras,
                                          const ConicMatchingOptions& options,
                                          const StopRequested& stop) {
  if (features.size() != cameras.size()) {
    return absl::InvalidArgumentError("matching: " + std::to_string(features.size()) +
                                      " feature sets and " + std::to_string(cameras.size()) +
                                      " cameras");
  }
  const int views = static_cast<int>(features.size());
  std::vector<std::vector<UsableArc>> arcs(views);
  for (int v = 0; v < views; ++v) {
    if (cameras[v]) arcs[v] = UsableArcs(features[v], *cameras[v], options);
  }
  ConicMatching out;
  std::vector<TrackLink> links;
  for (int a = 0; a < views; ++a) {
    for (int b = a + 1; b < views; ++b) {
      if (!cameras[a] || !cameras[b]) continue;
      if (IsStopRequested(stop)) return absl::CancelledError("matching: cancelled");
      std::vector<Candidate> candidates = CandidatesOf(arcs[a], arcs[b], options);
      AskOtherViews(arcs, a, b, options, &candidates);
      out.pairs.push_back({a, b, Choose(candidates)});
      for (const ConicMatch& m : out.pairs.back().matches)
        links.push_back({a, m.arc_a, b, m.arc_b, m.log_ratio});
    }
  }
  for (const FeatureTrack& track : JoinTracks(std::move(links))) {
    auto conic = ConicOf(track, features, cameras, {options.sigma_px, options.gate_px});
    if (conic) out.conics.push_back(*std::move(conic));
  }
  return out;
}

}  // namespace horopter
