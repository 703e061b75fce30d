#include "server/pipeline/hinted_runs.h"

#include <algorithm>
#include <span>
#include <utility>
#include <vector>

#include "server/base/status_macros.h"
#include "server/pipeline/clocks.h"
#include "server/pipeline/euclidean_stage.h"
#include "server/pipeline/given_cameras.h"
#include "server/pipeline/presumed_focal.h"
#include "server/pipeline/recognition_stage.h"

namespace horopter {
namespace {

const KnownCameras kNoCameras;

// Takes back what an attempt at recognition has answered.
void ForgetAttempt(RecognitionInput* input, PipelineResult* result) {
  result->trace.recognition = {};
  result->trace.matching = {};
  result->trace.reconstruction = {};
  result->trace.metric.reset();
  result->answer.reasons.clear();
  result->answer.unsearched.clear();
  result->answer.findings.clear();
  result->answer.presumed_focal.clear();
  input->matching = nullptr;
  input->reconstruction = nullptr;
}

// By the images and what the request says of its cameras.
absl::Status RecognizeAndAdjust(const PipelineOptions& options,
                                const SceneRequest& request,
                                const StopRequested& stop,
                                RefusalLog* log,
                                RecognitionInput* input,
                                PipelineResult* result) {
  input->hints = request.hints;
  HOROPTER_RETURN_IF_ERROR(RunRecognition(options, request, kNoCameras, stop, log, input, result));
  return RunEuclidean(options, request, *input, stop, result);
}

// Recognition with the focal lengths that the images' files give, and again without them where that
// finds nothing or the images contradict them.
absl::Status RunPresumed(const PipelineOptions& options,
                         const SceneRequest& request,
                         const SceneRequest& stripped,
                         const StopRequested& stop,
                         RefusalLog* log,
                         RecognitionInput* input,
                         PipelineResult* result) {
  HOROPTER_RETURN_IF_ERROR(RecognizeAndAdjust(options, request, stop, log, input, result));
  std::vector<int> contradicted;
  if (result->trace.metric) {
    input->hints = stripped.hints;
    const absl::StatusOr<MetricScene> free =
        RefineMetricScene(*input, result->trace.recognition, options.euclidean, stop);
    input->hints = request.hints;
    if (absl::IsCancelled(free.status())) return free.status();
    if (free.ok()) contradicted = ContradictedFocals(request.hints, free->cameras);
    if (contradicted.empty()) {
      TellPresumed(request.hints, result->trace.metric->cameras, &result->answer);
      return absl::OkStatus();
    }
  }
  ForgetAttempt(input, result);
  HOROPTER_RETURN_IF_ERROR(RecognizeAndAdjust(options, stripped, stop, log, input, result));
  if (result->trace.metric) {
    // What fits the files' focal lengths was not found with them: they misled the search.
    contradicted = ContradictedFocals(request.hints, result->trace.metric->cameras);
  }
  TellContradicted(request.hints, contradicted, &result->answer);
  return absl::OkStatus();
}

// Recognition with what is known of the station, and again without it where it finds nothing or the
// images contradict it. Both answer by the images alone what they say of the cameras.
absl::Status RunStation(const PipelineOptions& options,
                        const SceneRequest& request,
                        const StopRequested& stop,
                        RefusalLog* log,
                        RecognitionInput* input,
                        PipelineResult* result) {
  const SceneRequest hinted = WithStationHints(request);
  const auto lenses = [](const SceneRequest& r) {
    return std::count_if(
        r.hints.begin(), r.hints.end(), [](const CameraHint& h) { return h.focal_px.has_value(); });
  };
  const bool anything_known =
      lenses(hinted) > lenses(request) || hinted.camera_poses.size() > request.camera_poses.size();
  // What the caller says of a lens or a place goes before what is known of it.
  const bool asks_alone = request.hints.empty() && request.camera_poses.empty();
  const KnownCameras rig = asks_alone ? CamerasOfStation(*request.station) : KnownCameras();
  result->station.emplace();
  for (const bool with_prior : {true, false}) {
    if (with_prior && !anything_known) continue;
    const SceneRequest& asked = with_prior ? hinted : request;
    ForgetAttempt(input, result);
    input->hints = asked.hints;
    const KnownCameras& tried = with_prior ? rig : kNoCameras;
    HOROPTER_RETURN_IF_ERROR(RunRecognition(options, asked, tried, stop, log, input, result));
    input->hints = request.hints;
    HOROPTER_RETURN_IF_ERROR(RunEuclidean(options, request, *input, stop, result));
    if (!result->trace.metric) continue;
    // Under the rig every camera that was moved has been found again by the images.
    if (result->station->prior_used || result->station->test.agrees ||
        result->trace.recognition.under_known_cameras) {
      return absl::OkStatus();
    }
  }
  // What was found under a prior that the images contradict teaches nothing.
  if (!result->trace.metric) result->station->evidence = {};
  return absl::OkStatus();
}

// Recognition with what a request says of its cameras and what is known of its station; stripped:
// without presumed focal lengths.
absl::Status RunAlone(const PipelineOptions& options,
                      const SceneRequest& request,
                      const SceneRequest& stripped,
                      const StopRequested& stop,
                      RefusalLog* log,
                      RecognitionInput* input,
                      PipelineResult* result) {
  if (request.station) return RunStation(options, request, stop, log, input, result);
  if (HasPresumed(request.hints))
    return RunPresumed(options, request, stripped, stop, log, input, result);
  return RecognizeAndAdjust(options, request, stop, log, input, result);
}

// What the images of a recognised scene say of their cameras against what the caller says.
absl::StatusOr<HintTest> AskImages(const PipelineOptions& options,
                                   const SceneRequest& request,
                                   RecognitionInput input,
                                   const StopRequested& stop,
                                   PipelineResult* result) {
  StageClock clock("hints", &result->answer.stages);
  const std::vector<CameraHint> loosened = LoosenedClaims(request.hints, request.images);
  input.hints = loosened;
  EuclideanOptions euclidean = options.euclidean;
  euclidean.camera_evidence = true;
  euclidean.lens.estimate = false;
  const absl::StatusOr<MetricScene> free =
      RefineMetricScene(input, result->trace.recognition, euclidean, stop);
  if (absl::IsCancelled(free.status())) return free.status();
  HintTest test;
  if (free.ok()) test = TestHints(request.hints, free->evidence);
  clock.Finish({{"squared", test.squared}, {"limit", test.limit}});
  return test;
}

// Recognition with what the caller says of the lenses, and again without it where that finds
// nothing or the images contradict it.
absl::Status RunClaimed(const PipelineOptions& options,
                        const CameraKnowledge& known,
                        const StopRequested& stop,
                        RefusalLog* log,
                        RecognitionInput* input,
                        PipelineResult* result,
                        HintTest* test) {
  HOROPTER_RETURN_IF_ERROR(
      RunAlone(options, known.request, known.without_files, stop, log, input, result));
  if (result->trace.metric) {
    HOROPTER_ASSIGN_OR_RETURN(*test, AskImages(options, known.request, *input, stop, result));
    if (test->agrees) return absl::OkStatus();
  }
  ForgetAttempt(input, result);
  HOROPTER_RETURN_IF_ERROR(
      RunAlone(options, known.without_claims, known.without_both, stop, log, input, result));
  if (!result->trace.metric) return absl::OkStatus();
  HOROPTER_ASSIGN_OR_RETURN(*test, AskImages(options, known.request, *input, stop, result));
  if (!test->agrees) return absl::OkStatus();
  // The claims are right, and misled the search.
  input->hints = known.request.hints;
  return RunEuclidean(options, known.request, *input, stop, result);
}

}  // namespace

CameraKnowledge KnowledgeOf(const SceneRequest& request) {
  SceneRequest without_claims = WithoutClaims(request);
  SceneRequest without_both = WithoutPresumed(without_claims);
  return {request, WithoutPresumed(request), std::move(without_claims), std::move(without_both)};
}

absl::Status RunWithHints(const PipelineOptions& options,
                          const CameraKnowledge& known,
                          const StopRequested& stop,
                          RefusalLog* log,
                          RecognitionInput* input,
                          PipelineResult* result,
                          HintTest* test) {
  if (HasClaims(known.request.hints))
    return RunClaimed(options, known, stop, log, input, result, test);
  return RunAlone(options, known.request, known.without_files, stop, log, input, result);
}

}  // namespace horopter
