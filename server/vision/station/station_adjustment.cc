#include "server/vision/station/station_adjustment.h"

#include <utility>

#include "server/base/status_macros.h"

namespace horopter {
namespace {

// A prior that is right loses no edges and moves them by little.
constexpr double kLeastEdgesKept = 0.93;
constexpr double kMostRmsRatio = 1.25;

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
                                                const EuclideanOptions& options,
                                                const StopRequested& stop) {
  HOROPTER_RETURN_IF_ERROR(Validate(station));
  if (views.size() != recognition.views.size())
    return absl::InvalidArgumentError("station: one camera per image is needed");
  StationScene out;
  HOROPTER_ASSIGN_OR_RETURN(out.metric, RefineMetricScene(input, recognition, options, stop));
  out.evidence = out.metric.evidence;
  if (state.requests == 0 && state.covariance.size() == 0) return out;
  out.test = TestStation(state, views, out.evidence, station);

  std::vector<bool> known;
  for (const auto& camera : out.metric.cameras) known.push_back(camera.has_value());
  const CameraGroupPrior prior = PriorOfRequest(state, views, known, station);
  auto under_prior = RefineMetricScene(
      input, AsRecognized(out.metric, recognition), prior, options, stop);
  if (absl::IsCancelled(under_prior.status())) return under_prior.status();
  if (!under_prior.ok()) return out;
  if (!out.test.agrees) {
    if (!KeepsEdges(*under_prior, out.metric)) return out;
    StationTest again = TestStation(state, views, under_prior->evidence, station);
    if (!again.agrees) return out;
    out.test = std::move(again);
  }
  for (Finding& f : out.metric.findings) {
    if (f.kind == FindingKind::kObjectRejected)
      under_prior->findings.insert(under_prior->findings.begin(), std::move(f));
  }
  out.metric = *std::move(under_prior);
  out.evidence = out.metric.evidence;
  out.prior_used = true;
  return out;
}

}  // namespace horopter
