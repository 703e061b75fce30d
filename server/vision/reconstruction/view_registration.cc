#include "server/vision/reconstruction/view_registration.h"

#include <Eigen/Dense>
#include <algorithm>
#include <cmath>
#include <optional>
#include <string>

#include "server/vision/reconstruction/alternation.h"
#include "server/vision/reconstruction/camera_resection.h"
#include "server/vision/reconstruction/matched_tracks.h"
#include "server/vision/reconstruction/structure.h"
#include "server/vision/reconstruction/trust.h"

namespace horopter {
namespace {

struct Sights {
  std::vector<PointSight> points;
  std::vector<LineSight> lines;
};

Sights SightsOf(const MultiviewTracks& tracks,
                const TrackIndex& index,
                const Structure& structure,
                int view) {
  Sights out;
  for (const int k : index.points_in_view[view]) {
    const PointObservation& o = tracks.point_observations[k];
    if (structure.points[o.point]) out.points.push_back({*structure.points[o.point], o.pixel});
  }
  for (const int k : index.lines_in_view[view]) {
    const LineObservation& o = tracks.line_observations[k];
    if (structure.lines[o.line]) out.lines.push_back({*structure.lines[o.line], o.start, o.end});
  }
  return out;
}

double WorstKnownFocalSigma(const Reconstruction& r) {
  double worst = 0.0;
  for (const auto& view : r.views) {
    if (view) worst = std::max(worst, view->focal_log_sigma);
  }
  return worst;
}

}  // namespace

int RegisterRemainingViews(const MatchingResult& matching,
                           std::span<const ImageFeatures> features,
                           std::span<const ImageSize> sizes,
                           std::span<const ViewPrior> priors,
                           const ReconstructionOptions& options,
                           const StopRequested& stop,
                           Reconstruction* reconstruction) {
  Reconstruction& r = *reconstruction;
  const int views = static_cast<int>(r.views.size());
  r.view_refusals.assign(views, "");
  const auto known = std::count_if(
      r.views.begin(), r.views.end(), [](const auto& view) { return view.has_value(); });
  if (known < 2) r.view_refusals.assign(views, r.refusal);
  if (known < 2 || known == views) return 0;
  const MultiviewTracks tracks =
      TracksOfMatches(matching, MatchedPairs::kAll, features, sizes).tracks;
  const TrackIndex index = IndexTracks(tracks);
  ResectionOptions resection = options.registration;
  resection.seed = options.seed;
  resection.focal_prior_widths = options.focal_prior_widths;
  resection.focal_prior_log_sigma = options.focal_prior_log_sigma;
  const double others = WorstKnownFocalSigma(r);
  int added = 0;
  std::vector<bool> failed(views, false);
  while (!IsStopRequested(stop)) {
    const Structure structure = TriangulateAll(tracks, index, r.views);
    int next = -1;
    Sights most;
    for (int v = 0; v < views; ++v) {
      if (r.views[v] || failed[v]) continue;
      Sights sights = SightsOf(tracks, index, structure, v);
      if (next >= 0 && sights.points.size() <= most.points.size()) continue;
      next = v;
      most = std::move(sights);
    }
    if (next < 0) break;
    const ViewPrior prior = priors.empty() ? ViewPrior() : priors[next];
    const auto found = ResectPinhole(most.points, most.lines, sizes[next], prior, resection, stop);
    failed[next] = true;
    if (!found.ok()) {
      r.view_refusals[next] = std::string(found.status().message());
      continue;
    }
    const double sigma = std::hypot(kFocalInflation * found->focal_log_sigma, others);
    if (r.trusted && sigma > std::max(kMaxTrustedFocalSigma, others)) {
      r.view_refusals[next] = "focal length known to " +
                              std::to_string(std::lround(100.0 * sigma)) + " %, need " +
                              std::to_string(std::lround(100.0 * kMaxTrustedFocalSigma)) + " %";
      continue;
    }
    r.view_refusals[next].clear();
    r.views[next] = CalibratedView{*found, sigma};
    ++added;
    for (int v = 0; v < views; ++v) failed[v] = failed[v] && r.views[v].has_value();
  }
  r.counts["views_resected"] = added;
  r.counts["views"] = static_cast<double>(known + added);
  return added;
}

}  // namespace horopter
