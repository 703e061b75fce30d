#include "server/vision/station/station_adjustment.h"

#include <optional>
#include <utility>

#include "server/base/status_macros.h"

namespace horopter {
namespace {

// A prior that is right loses no edges and moves them by little.
constexpr double kLeastEdgesKept = 0.93;
constexpr double kMostRmsRatio = 1.25;

// The scene in which prior and images are compared is adjusted with the focal lengths constrained
// near to the known ones: near enough that what the images say is linear there, and far too loose
// to hide a change. A scene of one part alone would wander off by 30 %.
std::vector<CameraHint> NearHints(const RecognitionInput& input,
                                  const StationState& state,
                                  const StationViews& views,
                                  const StationOptions& options) {
  std::vector<CameraHint> hints(input.hints.begin(), input.hints.end());
  hints.resize(views.size());
  for (std::size_t v = 0; v < views.size(); ++v) {
    const int c = views[v];
    if (c < 0 || state.cameras[c].zooming || hints[v].focal_px) continue;
    if (DeviationsOf(state, c).log_focal > options.near_log_focal) continue;
    hints[v].focal_px = state.cameras[c].camera.focal_px;
    hints[v].focal_log_sigma = options.near_log_focal;
  }
  return hints;
}

// What is known of the cameras when those that the test names are forgotten; nothing where it names
// none, or another order.
std::optional<StationState> WithoutChanged(StationState state,
                                           const StationTest& test,
                                           const StationOptions& options) {
  if (test.changes.empty()) return std::nullopt;
  for (const StationChange& change : test.changes) {
    if (change.kind == StationChangeKind::kSwapped) return std::nullopt;
    for (const int c : change.cameras) {
      if (change.kind == StationChangeKind::kMoved) ForgetPlace(c, &state);
      if (change.kind == StationChangeKind::kLens) ForgetLens(c, options, &state);
    }
  }
  return state;
}

bool KeepsEdges(const MetricScene& under_prior, const MetricScene& alone) {
  const auto edges = [](const MetricScene& m) { return m.counts.at("edge_observations"); };
  return edges(under_prior) >= kLeastEdgesKept * edges(alone) &&
         under_prior.rms_px <= kMostRmsRatio * alone.rms_px &&
         under_prior.objects.size() == alone.objects.size();
}

}  // namespace

absl::StatusOr<StationScene> RefineUnderStation(const RecognitionInput& input,
                                                const RecognitionResult& recognition,
                                                const StationState& state,
                                                const StationViews& views,
                                                const StationOptions& station,
                                                EuclideanOptions options,
                                                const StopRequested& stop) {
  options.camera_evidence = true;
  // A station remembers k1 alone.
  options.lens.estimate = false;
  HOROPTER_RETURN_IF_ERROR(Validate(station));
  if (views.size() != recognition.views.size())
    return absl::InvalidArgumentError("station: one camera per image is needed");
  StationScene out;
  const std::vector<CameraHint> hints = NearHints(input, state, views, station);
  RecognitionInput near = input;
  near.hints = hints;
  HOROPTER_ASSIGN_OR_RETURN(const MetricScene compared,
                            RefineMetricScene(near, recognition, options, stop));
  out.evidence = compared.evidence;
  out.test = TestStation(state, views, out.evidence, station);

  std::vector<bool> known;
  for (const auto& camera : compared.cameras) known.push_back(camera.has_value());
  const CameraGroupPrior prior = PriorOfRequest(state, views, known, station);
  auto under_prior =
      RefineMetricScene(input, AsRecognized(compared, recognition), prior, options, stop);
  if (absl::IsCancelled(under_prior.status())) return under_prior.status();
  bool stands = under_prior.ok() && out.test.agrees;
  if (under_prior.ok() && !out.test.agrees && KeepsEdges(*under_prior, compared)) {
    StationTest again = TestStation(state, views, under_prior->evidence, station);
    stands = again.agrees;
    if (stands) out.test = std::move(again);
  }
  if (!stands) {
    // Of the cameras that have not changed the prior holds, where the images agree with it.
    if (const auto rest = WithoutChanged(state, out.test, station)) {
      const CameraGroupPrior of_rest = PriorOfRequest(*rest, views, known, station);
      auto metric =
          RefineMetricScene(input, AsRecognized(compared, recognition), of_rest, options, stop);
      if (absl::IsCancelled(metric.status())) return metric.status();
      if (metric.ok() && KeepsEdges(*metric, compared) &&
          TestStation(*rest, views, metric->evidence, station).agrees) {
        out.metric = *std::move(metric);
        return out;
      }
    }
    HOROPTER_ASSIGN_OR_RETURN(out.metric, RefineMetricScene(input, recognition, options, stop));
    return out;
  }
  out.metric = *std::move(under_prior);
  for (const Finding& f : compared.findings) {
    if (f.kind == FindingKind::kObjectRejected)
      out.metric.findings.insert(out.metric.findings.begin(), f);
  }
  out.evidence = out.metric.evidence;
  out.prior_used = true;
  return out;
}

}  // namespace horopter
