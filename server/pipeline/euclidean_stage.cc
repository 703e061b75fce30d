#include "server/pipeline/euclidean_stage.h"

#include <algorithm>
#include <optional>
#include <utility>
#include <vector>

#include "server/base/status_macros.h"
#include "server/pipeline/clocks.h"
#include "server/pipeline/followed_ground.h"

namespace horopter {
namespace {

// Focal lengths from texture are off by .6 - 5.8 % in photographs, whatever they say (ADR 75).
constexpr double kLeastTextureLogFocal = 0.02;

// Adjusts what was recognised. Of a station under what is known of it.
absl::Status Adjust(const PipelineOptions& options,
                    const SceneRequest& request,
                    const RecognitionInput& input,
                    const StopRequested& stop,
                    PipelineResult* result) {
  SceneTrace& trace = result->trace;
  if (!request.station) {
    HOROPTER_ASSIGN_OR_RETURN(trace.metric,
                              RefineMetricScene(input, trace.recognition, options.euclidean, stop));
    return absl::OkStatus();
  }
  HOROPTER_ASSIGN_OR_RETURN(StationScene scene,
                            RefineUnderStation(input,
                                               trace.recognition,
                                               request.station->state,
                                               request.station->views,
                                               options.station,
                                               options.euclidean,
                                               stop));
  trace.metric = std::move(scene.metric);
  result->station = {std::move(scene.test), scene.prior_used, std::move(scene.evidence)};
  return absl::OkStatus();
}

// The same with the ground that the parts stand on, where it was matched or can be followed and
// contradicts nothing.
absl::Status AdjustWithGround(const PipelineOptions& options,
                              const SceneRequest& request,
                              const RecognitionInput& input,
                              const StopRequested& stop,
                              PipelineResult* result) {
  SceneTrace& trace = result->trace;
  const bool matched = !trace.matching.planes.empty();
  const MatchingResult followed =
      matched ? MatchingResult() : FollowGround(request, *trace.metric, options, stop);
  const MatchingResult& ground = matched ? trace.matching : followed;
  if (ground.planes.empty()) return absl::OkStatus();
  RecognitionInput on_ground = input;
  on_ground.matching = &ground;
  MetricScene without = *std::move(trace.metric);
  std::optional<StationOutcome> station = result->station;
  const absl::Status adjusted =
      Adjust(matched ? options : WithFollowedGround(options), request, on_ground, stop, result);
  if (absl::IsCancelled(adjusted)) return adjusted;
  if (adjusted.ok() && KeepsAnswer(*trace.metric, without)) return absl::OkStatus();
  trace.metric = std::move(without);
  result->station = std::move(station);
  return absl::OkStatus();
}

// What is said of the lenses, and where that is nothing what the images' texture says under which
// the parts were found: they alone leave focal length and depth open.
std::vector<CameraHint> HintsWithTexture(const RecognitionInput& input, const SceneTrace& trace) {
  std::vector<CameraHint> hints(input.hints.begin(), input.hints.end());
  if (!trace.reconstruction.trusted || !trace.recognition.under_known_cameras) return hints;
  hints.resize(input.images.size());
  for (std::size_t v = 0; v < std::min(hints.size(), trace.reconstruction.views.size()); ++v) {
    const auto& view = trace.reconstruction.views[v];
    if (!view || hints[v].focal_px) continue;
    hints[v].focal_px = view->camera.focal_px;
    hints[v].focal_log_sigma = std::max(view->focal_log_sigma, kLeastTextureLogFocal);
    hints[v].presumed = true;  // nobody said so
  }
  return hints;
}

}  // namespace

absl::Status RunEuclidean(const PipelineOptions& options,
                          const SceneRequest& request,
                          const RecognitionInput& input,
                          const StopRequested& stop,
                          PipelineResult* result) {
  SceneTrace& trace = result->trace;
  trace.metric.reset();
  if (trace.recognition.objects.empty()) return absl::OkStatus();
  StageClock clock("euclidean", &result->answer.stages);
  const std::vector<CameraHint> hints = HintsWithTexture(input, trace);
  RecognitionInput hinted = input;
  hinted.hints = hints;
  // What moved against the parts, or what they were not found under, is no witness of theirs.
  if (trace.recognition.under_known_cameras) hinted.reconstruction = &trace.reconstruction;
  HOROPTER_RETURN_IF_ERROR(Adjust(options, request, hinted, stop, result));
  if (options.follow_ground && !IsStopRequested(options.recognition.hurry))
    HOROPTER_RETURN_IF_ERROR(AdjustWithGround(options, request, hinted, stop, result));
  clock.Finish(trace.metric->counts);
  return absl::OkStatus();
}

}  // namespace horopter
