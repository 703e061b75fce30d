#include "server/pipeline/recognition_stage.h"

#include <algorithm>
#include <map>
#include <memory>
#include <optional>
#include <string_view>
#include <utility>

#include "server/base/status_macros.h"
#include "server/pipeline/answer.h"
#include "server/pipeline/clocks.h"
#include "server/pipeline/finer_images.h"
#include "server/pipeline/given_cameras.h"
#include "server/pipeline/texture_stage.h"
#include "server/vision/matching/ground_motion.h"
#include "server/vision/recognition/recognition.h"

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

// What the images' texture tells of their cameras; none where it is not asked.
absl::StatusOr<std::vector<Reconstruction>> SolutionsByTexture(const PipelineOptions& options,
                                                               const SceneRequest& request,
                                                               const StopRequested& stop,
                                                               std::vector<StageReport>* stages) {
  if (!options.cameras_from_texture || request.images.size() < 2 ||
      IsStopRequested(options.recognition.hurry)) {
    return std::vector<Reconstruction>();
  }
  return ReconstructTexture(request, options, stop, stages);
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

// Whether structure in space is asked, which needs matches.
bool AskStructure(const RecognitionRoutes& routes) {
  return routes.metric || routes.projective;
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

// One attempt at recognition: ways to look for the parts, each while those before it find none.
class Attempt {
 public:
  Attempt(PipelineOptions options,
          const SceneRequest& request,
          const StopRequested& stop,
          RefusalLog* log,
          RecognitionInput* input,
          PipelineResult* result)
      : options_(std::move(options)),
        request_(request),
        stop_(stop),
        log_(log),
        input_(*input),
        trace_(result->trace),
        answer_(result->answer),
        watch_(options_.recognition.hurry) {
    options_.recognition.hurry = watch_.Token();
    options_.recognition.unknown_share = request.unknown_share;
  }

  absl::Status Run(const KnownCameras& of_station) {
    HOROPTER_RETURN_IF_ERROR(LookAtGround());
    HOROPTER_RETURN_IF_ERROR(LookUnderCameras(of_station));
    HOROPTER_RETURN_IF_ERROR(LookWithoutCameras());
    HOROPTER_RETURN_IF_ERROR(LookFiner(of_station));
    // What leaves out views stands only where parts alone say nothing.
    if (trace_.recognition.objects.empty() && !doubted_.objects.empty())
      trace_.recognition = std::move(doubted_);
    TellUnsearched();
    StateProbabilities(&trace_.recognition);
    TellState(trace_.recognition, &answer_);
    return absl::OkStatus();
  }

 private:
  bool IsLate() const { return IsStopRequested(options_.recognition.hurry); }

  template <typename By>
  absl::StatusOr<RecognitionResult> Recognize(const By& by) {
    return TimedRecognition(by, input_, options_, stop_, &watch_, log_, &answer_.stages);
  }

  absl::Status LookAtGround() {
    if (!GroundComesFirst(trace_.features, options_.recognition.aspects)) return absl::OkStatus();
    watch_.Begin("matching");
    ground_ = AskGround(request_, options_, stop_, &answer_.stages);
    return IsStopRequested(stop_) ? absl::CancelledError("stopped while the ground was asked")
                                  : absl::OkStatus();
  }

  // Cameras before any part: a station's, else those whose places the request gives, else what the
  // images' texture tells. The answer tests them all.
  absl::Status LookUnderCameras(const KnownCameras& of_station) {
    // A station's cameras are asked of the images by whoever gave them.
    if (!of_station.views.empty()) return LookUnder(of_station);
    HOROPTER_RETURN_IF_ERROR(LookUnder(CamerasOfRequest(request_)));
    // A place that no part confirms may be wrong.
    DoubtUnless(Showing(trace_.recognition) == std::ssize(request_.images));
    if (!trace_.recognition.objects.empty()) return absl::OkStatus();
    watch_.Begin("matching");
    if (!of_texture_) {
      HOROPTER_ASSIGN_OR_RETURN(of_texture_,
                                SolutionsByTexture(options_, request_, stop_, &answer_.stages));
    }
    HOROPTER_RETURN_IF_ERROR(LookUnderSolutions());
    DoubtUnless(trace_.recognition.registered() == std::ssize(request_.images));
    return absl::OkStatus();
  }

  absl::Status LookUnder(const KnownCameras& known) {
    if (known.views.empty()) return absl::OkStatus();
    input_.ground = ground_;
    HOROPTER_ASSIGN_OR_RETURN(trace_.recognition,
                              Recognize([&](const RecognitionInput& of, const auto&... given) {
                                return RecognizeWithCameras(of, known, given..., work_.get());
                              }));
    input_.ground = {};
    return absl::OkStatus();
  }

  // Of solutions that texture cannot tell apart the one whose parts more images show; it is left in
  // the trace where it is trusted.
  absl::Status LookUnderSolutions() {
    RecognitionResult best;
    for (std::size_t k = 0; k < of_texture_->size(); ++k) {
      const Reconstruction& solution = (*of_texture_)[k];
      if (k > 0 && IsLate()) break;
      trace_.recognition = {};
      HOROPTER_RETURN_IF_ERROR(LookUnder(CamerasOfReconstruction(solution)));
      if (k > 0 && !IsShownByMore(trace_.recognition, best)) continue;
      best = std::move(trace_.recognition);
      if (solution.trusted) trace_.reconstruction = solution;
    }
    trace_.recognition = std::move(best);
    return absl::OkStatus();
  }

  // What is doubted is kept for the end.
  void DoubtUnless(bool believed) {
    if (believed) return;
    if (doubted_.objects.empty()) doubted_ = std::move(trace_.recognition);
    trace_.recognition = {};
  }

  // What is matched between the images proposes cameras, single images propose parts: each is
  // verified in all images.
  absl::Status LookWithoutCameras() {
    if (!trace_.recognition.objects.empty()) return absl::OkStatus();
    // Cameras of texture need no matches: what they show has been looked for.
    const bool of_texture = of_texture_ && !of_texture_->empty() &&
                            CamerasOfReconstruction(of_texture_->front()).known() > 1;
    if (!matched_ && !IsLate() && (!of_texture || AskStructure(options_.recognition.routes))) {
      watch_.Begin("matching");
      HOROPTER_RETURN_IF_ERROR(Reconstruct(request_, options_, stop_, &trace_, &answer_.stages));
      matched_ = true;
    }
    input_.ground = ground_;
    if (matched_) input_.matching = &trace_.matching;
    if (matched_) input_.reconstruction = &trace_.reconstruction;
    HOROPTER_ASSIGN_OR_RETURN(trace_.recognition, Recognize([&](const auto&... given) {
                                return RecognizeObjects(given..., work_.get());
                              }));
    input_.ground = {};
    input_.matching = nullptr;
    input_.reconstruction = nullptr;
    return absl::OkStatus();
  }

  // Parts that are small in large images need more pixels than others are searched in. Their answer
  // is taken where more of its objects can be expected to be right. Where nothing is found in the
  // whole images, windows of them are searched larger still.
  absl::Status LookFiner(const KnownCameras& of_station) {
    if (IsLate() || trace_.recognition.effort_spent ||
        !MayShowMore(request_.images, request_.searched, input_.objects, trace_.recognition))
      return absl::OkStatus();
    const std::shared_ptr<AspectWork> coarse = work_;
    input_.aspects = &finer_;
    HOROPTER_RETURN_IF_ERROR(LookAgain(of_station));
    if (trace_.recognition.objects.empty() && request_.searched.empty() && !IsLate() &&
        !trace_.recognition.effort_spent) {
      const Attention attention = Attended(*coarse);
      input_.searched = attention.parts;
      HOROPTER_RETURN_IF_ERROR(LookAgain(of_station));
      input_.searched = request_.searched;
    }
    input_.aspects = nullptr;
    return absl::OkStatus();
  }

  // What is looked at enlarged, told as a step of its own.
  Attention Attended(const AspectWork& coarse) {
    StageClock clock("attention", &answer_.stages);
    std::vector<OffPlaneGroup> standing_off;
    if (trace_.reconstruction.has_plane) {
      const KnownCameras known = CamerasOfReconstruction(trace_.reconstruction);
      standing_off = FindOffPlane(PointsInSpace(known.points, known.views), {}, known.views);
    }
    const std::vector<std::vector<ImageBox>> things =
        SmallThings(request_.images, coarse, kMostWindowSide, kMostWindows);
    Attention attention = Attend(request_.images, things, standing_off);
    clock.Finish({{"windows", attention.windows},
                  {"standing_off", attention.standing_off},
                  {"share", attention.share}});
    return attention;
  }

  absl::Status LookAgain(const KnownCameras& of_station) {
    RecognitionResult before = std::move(trace_.recognition);
    trace_.recognition = {};
    work_ = MakeAspectWork(work_.get());
    HOROPTER_RETURN_IF_ERROR(LookUnderCameras(of_station));
    HOROPTER_RETURN_IF_ERROR(LookWithoutCameras());
    if (ShowMore(trace_.recognition, before)) return absl::OkStatus();
    // What was spent was spent.
    before.effort_spent = trace_.recognition.effort_spent;
    double& told = before.counts["search_effort"];
    told = std::max(told, trace_.recognition.counts["search_effort"]);
    trace_.recognition = std::move(before);
    return absl::OkStatus();
  }

  void TellUnsearched() {
    const RecognitionOptions& options = options_.recognition;
    const bool brief = IsBrief(options) && trace_.recognition.searched_objects > 0;
    const bool short_of = brief || trace_.recognition.effort_spent;
    answer_.time_limited = watch_.heard() || short_of;
    if (!watch_.step().empty() || short_of) {
      answer_.unsearched.push_back(
          {UnsearchedCause::kTime, watch_.step().empty() ? "aspect_search" : watch_.step()});
    }
    if (std::ssize(input_.objects) > options.aspects.max_objects)
      answer_.unsearched.push_back({UnsearchedCause::kCatalogSize, "aspects"});
  }

  PipelineOptions options_;
  const SceneRequest& request_;
  const StopRequested& stop_;
  RefusalLog* log_;
  RecognitionInput& input_;
  SceneTrace& trace_;
  SceneAnswer& answer_;
  HurryWatch watch_;
  std::shared_ptr<AspectWork> work_ = MakeAspectWork();
  std::optional<std::vector<Reconstruction>> of_texture_;  // once they have been asked for
  const AspectRecognitionOptions finer_ = FinerOptions();
  bool matched_ = false;       // features, and what they say of the cameras is reconstructed
  PlaneInViews ground_;        // how it moves, where that is known
  RecognitionResult doubted_;  // found under cameras that it does not bear out
};

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
  return Attempt(std::move(options), request, stop, log, input, result).Run(cameras);
}

}  // namespace horopter
