#include "server/pipeline/recognition_stage.h"

#include <algorithm>
#include <map>
#include <memory>
#include <string_view>
#include <utility>

#include "server/base/status_macros.h"
#include "server/pipeline/answer.h"
#include "server/pipeline/clocks.h"
#include "server/pipeline/given_cameras.h"
#include "server/pipeline/texture_stage.h"
#include "server/vision/matching/ground_motion.h"
#include "server/vision/recognition/camera_recognition.h"
#include "server/vision/recognition/explained_recognition.h"
#include "server/vision/recognition/ground_question.h"

namespace horopter {

namespace {

// What recognition says of the scene as a whole, in terms of the answer.
void TellState(const RecognitionResult& recognition, SceneAnswer* answer) {
  switch (recognition.state) {
    case RecognitionState::kRecognized:
      return;
    case RecognitionState::kNothingFound:
      return AddReason(ReasonKind::kNothingFound, recognition.detail, answer);
    case RecognitionState::kAmbiguous:
      return AddReason(ReasonKind::kAmbiguous, recognition.detail, answer);
    case RecognitionState::kTooFewFeatures:
      return AddReason(ReasonKind::kTooFewFeatures, recognition.detail, answer);
    case RecognitionState::kNoParallax:
      return AddReason(ReasonKind::kNoParallax, recognition.detail, answer);
  }
}

// How the ground moves: part of matching, without features. Where time is short, what is known.
PlaneInViews AskGround(const SceneRequest& request,
                       const PipelineOptions& options,
                       const StopRequested& stop,
                       std::vector<StageReport>* stages) {
  StageClock clock("matching", stages);
  PlaneInViews ground = FindGround(request.images, options.matching, [&] {
    return IsStopRequested(stop) || IsStopRequested(options.recognition.hurry);
  });
  const auto linked = std::count_if(
      ground.begin(), ground.end(), [](const auto& view) { return view.has_value(); });
  clock.Finish({{"ground_views", static_cast<double>(linked)}});
  return ground;
}

// What the images' texture tells of their cameras, which is left in the trace where it is trusted.
absl::StatusOr<KnownCameras> CamerasOfTexture(const PipelineOptions& options,
                                              const SceneRequest& request,
                                              const StopRequested& stop,
                                              SceneTrace* trace,
                                              std::vector<StageReport>* stages) {
  if (!options.cameras_from_texture || request.images.size() < 2 ||
      IsStopRequested(options.recognition.hurry)) {
    return KnownCameras{};
  }
  HOROPTER_ASSIGN_OR_RETURN(Reconstruction texture,
                            ReconstructTexture(request, options, stop, stages));
  KnownCameras known = CamerasOfReconstruction(texture);
  if (texture.trusted) trace->reconstruction = std::move(texture);
  return known;
}

int Registered(const RecognitionResult& recognition) {
  return static_cast<int>(std::count_if(recognition.views.begin(),
                                        recognition.views.end(),
                                        [](const auto& view) { return view.has_value(); }));
}

// Views that show one of the objects.
int Showing(const RecognitionResult& recognition) {
  int showing = 0;
  for (std::size_t v = 0; v < recognition.views.size(); ++v) {
    showing +=
        std::any_of(recognition.objects.begin(), recognition.objects.end(), [&](const auto& o) {
          return v < o.view_scores.size() && o.view_scores[v] >= 0.0;
        });
  }
  return showing;
}

// Matching and reconstruction; under cameras that the texture has given along their epipolar lines.
absl::Status Reconstruct(const SceneRequest& request,
                         const PipelineOptions& options,
                         const StopRequested& stop,
                         SceneTrace* trace,
                         std::vector<StageReport>* stages) {
  if (trace->reconstruction.trusted) {
    HOROPTER_ASSIGN_OR_RETURN(
        trace->matching,
        MatchUnderCameras(request, trace->features, trace->reconstruction, options, stop, stages));
    return absl::OkStatus();
  }
  StageClock matching_clock("matching", stages);
  HOROPTER_ASSIGN_OR_RETURN(trace->matching,
                            MatchViews(request.images, trace->features, options.matching, stop));
  matching_clock.Finish(trace->matching.counts);

  StageClock reconstruction_clock("reconstruction", stages);
  std::vector<ImageSize> sizes;
  for (const cv::Mat& image : request.images) sizes.push_back({image.cols, image.rows});
  HOROPTER_ASSIGN_OR_RETURN(trace->reconstruction,
                            ReconstructViews(trace->matching,
                                             trace->features,
                                             sizes,
                                             PriorsOf(request),
                                             options.reconstruction,
                                             stop));
  reconstruction_clock.Finish(trace->reconstruction.counts);
  return absl::OkStatus();
}

// Whether any route looks at what views have in common.
bool AskMatches(const RecognitionRoutes& routes) {
  return routes.metric || routes.supporting_plane || routes.view_led || routes.projective;
}

// One call of recognition, by(input, options, stop, listener, log), with the time of its steps.
template <typename By>
absl::StatusOr<RecognitionResult> TimedRecognition(const By& by,
                                                   const RecognitionInput& input,
                                                   const PipelineOptions& options,
                                                   const StopRequested& stop,
                                                   HurryWatch* watch,
                                                   RefusalLog* log,
                                                   std::vector<StageReport>* stages) {
  StageClock clock("recognition", stages);
  StepClock steps;
  HOROPTER_ASSIGN_OR_RETURN(RecognitionResult result,
                            by(
                                input,
                                options.recognition,
                                stop,
                                [&](std::string_view step) {
                                  steps.Begin(step);
                                  watch->Begin(step);
                                },
                                log));
  steps.End();
  std::map<std::string, double> counts = steps.seconds();
  counts.insert(result.counts.begin(), result.counts.end());
  clock.Finish(std::move(counts));
  return result;
}

}  // namespace

std::vector<ViewPrior> PriorsOf(const SceneRequest& request) {
  if (request.hints.empty() && request.camera_poses.empty()) return {};
  std::vector<ViewPrior> priors(request.images.size());
  for (std::size_t i = 0; i < request.hints.size(); ++i) {
    const CameraHint& hint = request.hints[i];
    priors[i].focal_px = hint.focal_px;
    priors[i].focal_log_sigma = FocalLogSigma(hint);
    priors[i].principal_point_px = hint.principal_point;
    if (hint.principal_point_sigma_px) {
      if (!hint.principal_point) {
        const cv::Mat& image = request.images[i];
        priors[i].principal_point_px = Eigen::Vector2d(image.cols - 1, image.rows - 1) / 2.0;
      }
      priors[i].principal_point_sigma_px = *hint.principal_point_sigma_px;
    }
    priors[i].k1 = hint.k1;
  }
  for (std::size_t i = 0; i < request.camera_poses.size(); ++i) {
    if (!request.camera_poses[i]) continue;
    priors[i].camera_from_world = request.camera_poses[i]->camera_from_base;
    priors[i].rotation_sigma_rad = request.camera_poses[i]->rotation_sigma_rad;
    priors[i].position_sigma_m = request.camera_poses[i]->position_sigma_m;
  }
  return priors;
}

absl::Status RunRecognition(PipelineOptions options,
                            const SceneRequest& request,
                            const KnownCameras& cameras,
                            const StopRequested& stop,
                            RefusalLog* log,
                            RecognitionInput* input,
                            PipelineResult* result) {
  SceneTrace& trace = result->trace;
  SceneAnswer& answer = result->answer;
  HurryWatch watch(options.recognition.hurry);
  options.recognition.hurry = watch.Token();
  const auto recognize = [&](const auto& by) {
    return TimedRecognition(by, *input, options, stop, &watch, log, &answer.stages);
  };
  std::vector<std::string> unasked;
  const std::shared_ptr<AspectWork> work = MakeAspectWork();
  bool aspects_first = AspectsComeFirst(input->objects, options.recognition);
  PlaneInViews ground;
  if (aspects_first && GroundComesFirst(trace.features, options.recognition.aspects)) {
    watch.Begin("matching");
    ground = AskGround(request, options, stop, &answer.stages);
    if (IsStopRequested(stop)) return absl::CancelledError("stopped while the ground was asked");
  }
  const bool have_aspects = options.recognition.routes.aspects &&
                            std::all_of(input->objects.begin(),
                                        input->objects.end(),
                                        [](const auto& o) { return o->aspects != nullptr; });
  // Cameras before any part: a station's, else those whose places the request gives, else what the
  // images' texture tells. The answer tests them all.
  RecognitionResult in_cameras;
  const auto look_under = [&](const KnownCameras& known,
                              int (*believed)(const RecognitionResult&)) {
    if (known.views.empty()) return absl::OkStatus();
    input->ground = ground;
    HOROPTER_ASSIGN_OR_RETURN(trace.recognition,
                              recognize([&](const RecognitionInput& of, const auto&... given) {
                                return RecognizeWithCameras(of, known, given..., work.get());
                              }));
    input->ground = {};
    // A station's cameras are asked of the images by whoever gave them.
    const bool doubted =
        cameras.views.empty() && believed(trace.recognition) < std::ssize(request.images);
    if (!doubted) return absl::OkStatus();
    if (in_cameras.objects.empty()) in_cameras = std::move(trace.recognition);
    trace.recognition = {};
    return absl::OkStatus();
  };
  if (!cameras.views.empty()) {
    HOROPTER_RETURN_IF_ERROR(look_under(cameras, Registered));
  } else if (have_aspects) {
    // A place that no part confirms may be wrong.
    HOROPTER_RETURN_IF_ERROR(look_under(CamerasOfRequest(request), Showing));
    if (trace.recognition.objects.empty()) {
      watch.Begin("matching");
      HOROPTER_ASSIGN_OR_RETURN(const KnownCameras known,
                                CamerasOfTexture(options, request, stop, &trace, &answer.stages));
      HOROPTER_RETURN_IF_ERROR(look_under(known, Registered));
    }
  }
  aspects_first = aspects_first && trace.recognition.objects.empty();
  if (aspects_first) {
    input->ground = ground;
    HOROPTER_ASSIGN_OR_RETURN(trace.recognition, recognize([&](const auto&... given) {
                                return RecognizeByAspectsAlone(given..., work.get());
                              }));
    // Of a large catalog the images may say that it need not have been.
    aspects_first = trace.recognition.searched_objects > 0;
    input->ground = {};
  }
  if (trace.recognition.objects.empty() && IsStopRequested(options.recognition.hurry)) {
    unasked = {"matching", "reconstruction", "recognition"};
  } else if (trace.recognition.objects.empty() && AskMatches(options.recognition.routes)) {
    watch.Begin("matching");
    HOROPTER_RETURN_IF_ERROR(Reconstruct(request, options, stop, &trace, &answer.stages));
    // No route would be asked any more.
    const bool late = IsStopRequested(options.recognition.hurry);
    if (late) {
      unasked = {"recognition"};
      trace.recognition.views.resize(request.images.size());
    }
    if (!late && (!aspects_first || trace.reconstruction.trusted)) {
      input->matching = &trace.matching;
      input->reconstruction = &trace.reconstruction;
      HOROPTER_ASSIGN_OR_RETURN(RecognitionResult found, recognize([](const auto&... given) {
                                  return RecognizeObjects(given...);
                                }));
      unasked = found.unasked;
      if (!aspects_first || !found.objects.empty()) trace.recognition = std::move(found);
    }
  }
  // What leaves out views stands only where parts alone say nothing.
  if (trace.recognition.objects.empty() && !in_cameras.objects.empty())
    trace.recognition = std::move(in_cameras);
  const bool brief = IsBrief(options.recognition) && trace.recognition.searched_objects > 0;
  answer.time_limited = watch.heard() || brief;
  if (!watch.step().empty() || brief) {
    answer.unsearched.push_back(
        {UnsearchedCause::kTime, watch.step().empty() ? "aspect_search" : watch.step()});
  }
  for (std::string& step : unasked) {
    answer.unsearched.push_back({UnsearchedCause::kTime, std::move(step)});
  }
  if (options.recognition.routes.aspects &&
      std::ssize(input->objects) > options.recognition.aspects.max_objects) {
    answer.unsearched.push_back({UnsearchedCause::kCatalogSize, "aspects"});
  }
  StateProbabilities(&trace.recognition);
  TellState(trace.recognition, &answer);
  return absl::OkStatus();
}

}  // namespace horopter
