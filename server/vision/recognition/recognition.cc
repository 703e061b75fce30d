#include "server/vision/recognition/recognition.h"

#include <algorithm>
#include <cmath>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include "absl/strings/str_cat.h"
#include "server/base/status_macros.h"
#include "server/vision/recognition/answer_by_routes.h"
#include "server/vision/recognition/camera_recognition.h"
#include "server/vision/recognition/explained_recognition.h"
#include "server/vision/recognition/interpretation/aspect_images.h"
#include "server/vision/recognition/interpretation/aspect_route.h"
#include "server/vision/recognition/interpretation/poor_views.h"
#include "server/vision/recognition/interpretation/pose_alternatives.h"
#include "server/vision/recognition/interpretation/routes.h"
#include "server/vision/recognition/interpretation/scale_alternatives.h"
#include "server/vision/recognition/interpretation/shape_rivals.h"
#include "server/vision/recognition/scoring/log_odds.h"

namespace horopter {
namespace {

AspectRecognitionOptions AspectOptionsOf(const RecognitionInput& input) {
  return input.aspects != nullptr ? *input.aspects : AspectRecognitionOptions();
}

bool IsSure(const RecognitionResult& result, const AspectAcceptance& options) {
  return std::any_of(result.objects.begin(), result.objects.end(), [&](const SceneObject& o) {
    return o.score >= options.sure_probability;
  });
}

// How much more likely than not all of an answer's objects are, as each route says of its own.
double SumOfLogOdds(const RecognitionResult& result) {
  constexpr double kMost = 0.999;  // so that no certain object outweighs all others
  double sum = 0.0;
  for (const SceneObject& o : result.objects) {
    const double p = std::clamp(o.score, 1.0 - kMost, kMost);
    sum += std::log(p / (1.0 - p));
  }
  return sum;
}

std::vector<AspectImage> SearchedImages(const RecognitionInput& input,
                                        const JointContext& context) {
  BeginStep(context, "aspect_images");
  return MakeAspectImages(input.images,
                          AspectOptionsOf(input).images,
                          GroundOf(input.ground, input.matching),
                          context.options.threads);
}

// Images and what is searched for, unless they are there.
absl::Status PrepareWork(const RecognitionInput& input,
                         const JointContext& context,
                         AspectWork* work) {
  if (!work->images.empty()) return absl::OkStatus();
  work->images = SearchedImages(input, context);
  HOROPTER_ASSIGN_OR_RETURN(work->search,
                            ChooseObjects(context, work->images, AspectOptionsOf(input).ranking));
  return absl::OkStatus();
}

// The aspects' own answer, in cameras that are known as far as they can be trusted; known: an
// answer of another route that is not contradicted, or null.
absl::StatusOr<RecognitionResult> AspectsOf(const RecognitionInput& input,
                                            const JointContext& context,
                                            AspectWork* work,
                                            const RecognitionResult* known,
                                            RefusalLog* log) {
  // What no route found parts in may be no table: its cameras are not believed, but tried.
  const JointContext unmatched =
      MakeContext({input.features, input.hints, nullptr, nullptr, input.objects, false},
                  context.options,
                  context.stop,
                  context.on_step);
  return RecognizeByAspects(unmatched,
                            work,
                            {CamerasTrusted(input) ? &context : nullptr, known},
                            log,
                            AspectOptionsOf(input));
}

// Objects with few edges are asked for by the routes in the cameras of the reconstruction: where a
// supporting plane's texture gives these they are quick. Their answer is judged by what the cameras
// should see of it; unless that confirms it, the aspects give theirs, and the one that explains
// more is taken. What neither finds, or aspects alone with little to show for it, the dearer routes
// are asked for. Rich ones have been asked for
// by their aspects before (AspectsComeFirst): here only what trusted cameras say is added.
absl::StatusOr<RecognitionResult> WithAspects(const RecognitionInput& input,
                                              std::span<const AspectImage> images,
                                              const JointContext& context,
                                              RouteWork* work,
                                              RefusalLog* log) {
  const AspectRouteOptions& options = context.options.aspects;
  const AspectAcceptance& acceptance = context.options.acceptance.aspects;
  const bool rich = static_cast<int>(input.objects.size()) <= options.max_objects &&
                    AreRich(input.objects, options);
  RecognitionRoutes quick = context.options.routes, dear = quick;
  quick.view_led = quick.projective = false;
  if (rich) quick.supporting_plane = false;
  dear.metric = dear.supporting_plane = false;
  HOROPTER_ASSIGN_OR_RETURN(RecognitionResult result,
                            AnswerByRoutes(input, quick, context, work, log));
  AspectJudgement judged = JudgeAnswer(context, images, result, AspectOptionsOf(input));
  LeaveOutPoorViews(judged, &result);
  const bool confirmed = judged.median >= acceptance.confirming_score;
  const bool enough = confirmed && result.registered() == static_cast<int>(images.size());
  if (rich || IsStopRequested(context.give_up)) {
    if (!rich && !enough) result.unasked = {"aspects", "view_led", "projective"};
    // Rich objects have been asked for by their aspects, in vain.
    RefuseContradicted(judged, !rich, acceptance, log, &result);
    return result;
  }
  AspectWork plain;
  HOROPTER_RETURN_IF_ERROR(PrepareWork(input, context, &plain));
  if (enough) {
    HOROPTER_RETURN_IF_ERROR(
        AddOthers(context, plain.images, plain.search, &result, AspectOptionsOf(input)));
    return result;
  }
  const bool contradicted = judged.median < acceptance.contradicting_score;
  HOROPTER_ASSIGN_OR_RETURN(
      RecognitionResult aspects,
      AspectsOf(input, context, &plain, contradicted ? nullptr : &result, log));
  // An answer that leaves out views explains what is easy.
  const bool explains_more =
      !aspects.objects.empty() &&
      JudgeAnswer(context, images, aspects, AspectOptionsOf(input)).score > judged.score &&
      aspects.registered() >= result.registered();
  if (explains_more) aspects.plane_confirmed = !contradicted && !result.objects.empty();
  if (explains_more && (!result.objects.empty() || IsSure(aspects, acceptance))) return aspects;
  if (result.objects.empty()) {
    HOROPTER_ASSIGN_OR_RETURN(result, AnswerByRoutes(input, dear, context, work, log));
    if (result.objects.empty()) aspects.unasked = result.unasked;
    judged = JudgeAnswer(context, images, result, AspectOptionsOf(input));
    LeaveOutPoorViews(judged, &result);
  }
  RefuseContradicted(judged, !aspects.objects.empty(), acceptance, log, &result);
  if (explains_more) return SumOfLogOdds(result) > SumOfLogOdds(aspects) ? result : aspects;
  return result.objects.empty() && !aspects.detail.empty() ? aspects : result;
}

// Nothing can be said of images without edges. Errors: INVALID_ARGUMENT.
absl::Status CheckInput(const RecognitionInput& input, const RecognitionOptions& options) {
  if (!input.hints.empty() && input.hints.size() != input.features.size())
    return absl::InvalidArgumentError("hints: one per image or none");
  return Validate(options);
}

std::optional<RecognitionResult> TooFewFeatures(const RecognitionInput& input,
                                                const SceneAcceptance& acceptance,
                                                RefusalLog* log) {
  std::size_t most_segments = 0;
  for (const ImageFeatures& f : input.features)
    most_segments = std::max(most_segments, f.segments.size());
  if (static_cast<int>(most_segments) >= acceptance.min_segments) return std::nullopt;
  RecognitionResult result;
  result.views.resize(input.features.size());
  result.state = RecognitionState::kTooFewFeatures;
  result.detail = absl::StrCat(
      "at most ", most_segments, " segments in an image, need ", acceptance.min_segments);
  if (log != nullptr) {
    log->refusals.push_back({AcceptanceTest::kFeatures,
                             {},
                             result.views,
                             static_cast<double>(most_segments),
                             static_cast<double>(acceptance.min_segments)});
  }
  return result;
}

// Turns that the images leave open: the likeliest is taken, the others are said.
void WeighTurns(const JointContext& context,
                std::span<const AspectImage> images,
                RecognitionResult* result) {
  BeginStep(context, "pose_alternatives");
  const std::vector<RatedPoses> rated = TurnToLikeliest(context, images, result);
  SayPoseAlternatives(context, images, rated, result);
  WeighShapes(context, images, result);
}

}  // namespace

std::shared_ptr<AspectWork> MakeAspectWork() {
  return std::make_shared<AspectWork>();
}

bool MayAskAspects(std::span<const std::shared_ptr<const PreparedObject>> objects,
                   const RecognitionOptions& options) {
  return options.routes.aspects && HaveAspects(objects);
}

bool AspectsComeFirst(std::span<const std::shared_ptr<const PreparedObject>> objects,
                      const RecognitionOptions& options) {
  return MayAskAspects(objects, options) && AreRich(objects, options.aspects);
}

absl::StatusOr<RecognitionResult> RecognizeByAspectsAlone(const RecognitionInput& input,
                                                          const RecognitionOptions& options,
                                                          const StopRequested& stop,
                                                          const StepListener& on_step,
                                                          RefusalLog* log,
                                                          AspectWork* work) {
  HOROPTER_RETURN_IF_ERROR(CheckInput(input, options));
  if (input.images.size() != input.features.size())
    return absl::InvalidArgumentError("images: one per list of features");
  if (!HaveAspects(input.objects))
    return absl::InvalidArgumentError("objects: not all have aspects");
  if (auto result = TooFewFeatures(input, options.acceptance.scene, log)) return *std::move(result);
  const JointContext context =
      MakeContext({input.features, input.hints, nullptr, nullptr, input.objects, false},
                  options,
                  stop,
                  on_step);
  AspectWork own;
  if (work == nullptr) work = &own;
  HOROPTER_RETURN_IF_ERROR(PrepareWork(input, context, work));
  if (!work->search.rich) {
    RecognitionResult nothing;
    nothing.views.resize(work->images.size());
    return nothing;
  }
  AspectStarts starts;
  starts.without_ground = IsLinked(input.ground);
  HOROPTER_ASSIGN_OR_RETURN(RecognitionResult aspects,
                            RecognizeByAspects(context, work, starts, log, AspectOptionsOf(input)));
  WeighTurns(context, work->images, &aspects);
  if (!input.scale_known) SayScaleAlternatives(context, &aspects);
  return aspects;
}

absl::StatusOr<RecognitionResult> RecognizeWithCameras(const RecognitionInput& input,
                                                       const KnownCameras& cameras,
                                                       const RecognitionOptions& options,
                                                       const StopRequested& stop,
                                                       const StepListener& on_step,
                                                       RefusalLog* log,
                                                       AspectWork* work) {
  HOROPTER_RETURN_IF_ERROR(CheckInput(input, options));
  if (cameras.views.size() != input.images.size() || input.images.size() != input.features.size())
    return absl::InvalidArgumentError("cameras: one entry per image");
  RecognitionResult nothing;
  nothing.views.resize(input.images.size());
  if (!MayAskAspects(input.objects, options)) return nothing;
  if (cameras.known() < 2) return nothing;
  if (TooFewFeatures(input, options.acceptance.scene, nullptr)) return nothing;
  const JointContext context =
      MakeContext({input.features, input.hints, nullptr, nullptr, input.objects, false},
                  options,
                  stop,
                  on_step);
  AspectWork own;
  if (work == nullptr) work = &own;
  HOROPTER_RETURN_IF_ERROR(PrepareWork(input, context, work));
  HOROPTER_ASSIGN_OR_RETURN(
      RecognitionResult found,
      RecognizeByAspectsWithCameras(context, work, cameras, log, AspectOptionsOf(input)));
  if (found.objects.empty()) return nothing;
  WeighTurns(context, work->images, &found);
  if (!cameras.scale_known) SayScaleAlternatives(context, &found);
  return found;
}

absl::StatusOr<RecognitionResult> RecognizeObjects(const RecognitionInput& input,
                                                   const RecognitionOptions& options,
                                                   const StopRequested& stop,
                                                   const StepListener& on_step,
                                                   RefusalLog* log) {
  HOROPTER_RETURN_IF_ERROR(CheckInput(input, options));
  if (input.matching == nullptr) return absl::InvalidArgumentError("matching: missing");
  if (auto result = TooFewFeatures(input, options.acceptance.scene, log)) return *std::move(result);
  const JointContext context = MakeContext(
      {input.features, input.hints, input.matching, input.reconstruction, input.objects},
      options,
      stop,
      on_step);
  RouteWork work;
  work.hypotheses.assign(input.features.size(), std::vector<ViewHypotheses>(input.objects.size()));
  if (MayAskAspects(input.objects, options) && input.images.size() == input.features.size()) {
    BeginStep(context, "aspect_images");
    // Judged with all edges: stripes and a block's own edges can be parallel.
    const std::vector<AspectImage> images =
        MakeJudgedImages(input.images, AspectOptionsOf(input).images, options.threads);
    HOROPTER_ASSIGN_OR_RETURN(RecognitionResult result,
                              WithAspects(input, images, context, &work, log));
    WeighTurns(context, images, &result);
    if (!input.scale_known) SayScaleAlternatives(context, &result);
    return result;
  }
  HOROPTER_ASSIGN_OR_RETURN(RecognitionResult result,
                            AnswerByRoutes(input, options.routes, context, &work, log));
  if (!input.scale_known) SayScaleAlternatives(context, &result);
  return result;
}

double ExpectedRight(const RecognitionResult& result) {
  double sum = 0.0;
  for (const SceneObject& o : result.objects) sum += StatedProbability(o.score, o.pose_probability);
  return sum;
}

void StateProbabilities(RecognitionResult* result) {
  for (SceneObject& o : result->objects) o.score = StatedProbability(o.score, o.pose_probability);
}

absl::StatusOr<RecognitionResult> RecognizeByAspectsAlone(const RecognitionInput& input,
                                                          const RecognitionOptions& options,
                                                          const StopRequested& stop,
                                                          const StepListener& on_step) {
  return RecognizeByAspectsAlone(input, options, stop, on_step, nullptr, nullptr);
}

absl::StatusOr<RecognitionResult> RecognizeObjects(const RecognitionInput& input,
                                                   const RecognitionOptions& options,
                                                   const StopRequested& stop,
                                                   const StepListener& on_step) {
  return RecognizeObjects(input, options, stop, on_step, nullptr);
}

}  // namespace horopter
