#include "server/vision/recognition/recognition.h"

#include <algorithm>
#include <optional>
#include <string>
#include <vector>

#include "absl/strings/str_cat.h"
#include "server/base/status_macros.h"
#include "server/vision/recognition/initialization/view_linking.h"
#include "server/vision/recognition/interpretation/answer.h"
#include "server/vision/recognition/interpretation/aspect_route.h"
#include "server/vision/recognition/interpretation/decision.h"
#include "server/vision/recognition/interpretation/rivals.h"
#include "server/vision/recognition/interpretation/routes.h"
#include "server/vision/recognition/interpretation/symmetric_views.h"
#include "server/vision/recognition/scene/surface_texture.h"

namespace horopter {
namespace {

constexpr int kMinSegments = 5;  // fewer in every view: nothing can be said

// A way to a scene's first part. table_found: the search on the plane has found parts, so that
// whoever needs no plane need not look.
struct Route {
  const char* name;
  bool (*applies)(const RecognitionInput& input, const RecognitionRoutes& on, bool table_found);
  absl::StatusOr<FoundScene> (*run)(const RouteInput&, JointContext*);
};

bool CamerasTrusted(const RecognitionInput& input) {
  return input.reconstruction != nullptr && input.reconstruction->trusted;
}

// By cost; each is asked while nothing is found that chance does not explain.
constexpr Route kRoutes[] = {
    {"metric",
     [](const RecognitionInput& input, const RecognitionRoutes& on, bool) {
       return on.metric && input.reconstruction != nullptr;
     },
     MetricRoute},
    {"table",
     [](const RecognitionInput& input, const RecognitionRoutes& on, bool) {
       return on.table && input.reconstruction != nullptr && input.reconstruction->has_plane;
     },
     TableRoute},
    {"view_led",
     [](const RecognitionInput&, const RecognitionRoutes& on, bool table_found) {
       return on.view_led && !table_found;
     },
     ViewLedRoute},
    // In cameras that are trusted the metric route has asked for the same parts at lower cost.
    {"projective",
     [](const RecognitionInput& input, const RecognitionRoutes& on, bool) {
       return on.projective && !(on.metric && CamerasTrusted(input));
     },
     ProjectiveRoute},
};

// The best scene of the routes; empty where none finds one. Errors: CANCELLED.
absl::StatusOr<FoundScene> FindScene(const RecognitionInput& input,
                                     const RecognitionRoutes& routes,
                                     JointContext* context) {
  const RouteInput route_input{
      input.features, input.reconstruction, input.keys, input.slots, input.bottom_up};
  FoundScene best;
  bool table_found = false;
  for (const Route& route : kRoutes) {
    if (IsStopRequested(context->give_up) || !IsOpen(*context, best)) break;
    if (!route.applies(input, routes, table_found)) continue;
    HOROPTER_ASSIGN_OR_RETURN(FoundScene found, route.run(route_input, context));
    if (found.route == RecognitionRoute::kTable) table_found = !found.scene.objects.empty();
    TakeIfBetter(*context, std::move(found), &best);
    if (IsStopRequested(context->stop))
      return absl::CancelledError(absl::StrCat("stopped during the route ", route.name));
  }
  if (IsStopRequested(context->stop)) return absl::CancelledError("stopped between routes");
  return best;
}

void ReportHypotheses(const JointContext& context, RecognitionResult* result) {
  double hypotheses = 0;
  for (const auto& view : context.hypotheses) {
    for (const ViewHypotheses& object : view) {
      hypotheses += static_cast<double>(object.pool.size());
      const int kept = std::min<int>(context.options.hypotheses_per_object,
                                     static_cast<int>(object.best.size()));
      result->hypotheses.insert(
          result->hypotheses.end(), object.best.begin(), object.best.begin() + kept);
    }
  }
  result->counts["view_hypotheses"] = hypotheses;
  result->counts["seeds"] = static_cast<double>(context.seed_count);
}

// What is answered of the best scene: symmetric views aligned, rivals heard, what chance explains
// left out.
RecognitionResult Conclude(const RecognitionInput& input, FoundScene best, JointContext* context) {
  SceneModel& scene = best.scene;
  scene.views.resize(input.features.size());
  BeginStep(*context, "symmetric_views");
  if (!scene.objects.empty())
    context->surface_images = MakeSurfaceImages(input.images, context->options.threads);
  AlignSymmetricViews(*context, &scene);
  DropChanceObjects(*context, best.verified, &scene);
  BeginStep(*context, "rivals");
  std::vector<Rival> rivals = ContestObjects(*context, best.verified, {}, &scene);
  if (DropContradictedViews(*context, &scene) > 0) EvaluateTogether(*context, &scene);
  BeginStep(*context, "surfaces");
  JudgeTexture(*context, &scene);
  DropUnlikelyObjects(&scene, &rivals);
  best.runners_up = RunnersUp(*context, scene, best.verified, rivals);
  const std::string doubt = ReasonToDoubt(*context, scene, best.runners_up);
  if (!doubt.empty()) {
    scene.objects.clear();
    scene.views.assign(input.features.size(), std::nullopt);
  }
  // A single part that the cameras hang on leaves them free to adapt to a wrong pose of it.
  const bool trusted = scene.objects.size() > 1 || CamerasTrusted(input);
  BeginStep(*context, "result");
  RecognitionResult result =
      MakeResult(*context, scene, best.verified, best.runners_up, rivals, trusted);
  if (!result.objects.empty()) result.route = best.route;
  ReportHypotheses(*context, &result);
  result.counts["placements"] = static_cast<double>(best.verified.size());
  result.counts["objects"] = static_cast<double>(result.objects.size());
  result.counts["views"] = scene.registered();
  if (result.state == RecognitionState::kNothingFound) {
    result.detail = !doubt.empty() ? doubt
                                   : absl::StrCat(context->seed_count,
                                                  " linked hypotheses, none with a joint score of ",
                                                  context->options.accept_score);
    if (IsStopRequested(context->options.hurry))
      result.detail += "; time ran short before all was tried";
  }
  return result;
}

// What the given routes answer.
absl::StatusOr<RecognitionResult> ByRoutes(const RecognitionInput& input,
                                           const RecognitionRoutes& routes,
                                           JointContext* context) {
  HOROPTER_ASSIGN_OR_RETURN(FoundScene found, FindScene(input, routes, context));
  return Conclude(input, std::move(found), context);
}

int Registered(const RecognitionResult& result) {
  return static_cast<int>(std::count_if(
      result.views.begin(), result.views.end(), [](const auto& v) { return v.has_value(); }));
}

// Objects with few edges are asked for by the routes in the cameras of the reconstruction: where a
// table's texture gives these they are quick. Their answer is judged by what the cameras should see
// of it; unless that confirms it, the aspects give theirs, and the one that explains more is taken.
// What neither finds the dearer routes are asked for. Rich ones have been asked for by their
// aspects before (AspectsComeFirst): here only what trusted cameras say is added.
absl::StatusOr<RecognitionResult> WithAspects(const RecognitionInput& input,
                                              JointContext* context) {
  const AspectRouteOptions& options = context->options.aspects;
  const bool rich = AreRich(input.objects, options);
  RecognitionRoutes quick = context->options.routes, dear = quick;
  quick.view_led = quick.projective = false;
  if (rich) quick.table = false;
  dear.metric = dear.table = false;
  BeginStep(*context, "aspect_images");
  // Judged with all edges: stripes and a block's own edges can be parallel.
  const std::vector<AspectImage> images =
      MakeAspectImages(input.images, false, context->options.threads);
  HOROPTER_ASSIGN_OR_RETURN(RecognitionResult result, ByRoutes(input, quick, context));
  AspectJudgement judged = JudgeAnswer(*context, images, result);
  if (judged.median >= options.confirming_score || rich || IsStopRequested(context->give_up)) {
    RefuseContradicted(
        judged, rich ? options.confirming_score : options.contradicting_score, &result);
    return result;
  }
  BeginStep(*context, "aspect_images");
  const std::vector<AspectImage> plain =
      MakeAspectImages(input.images, true, context->options.threads);
  HOROPTER_ASSIGN_OR_RETURN(AspectAnswer aspects, RecognizeByAspects(*context, plain));
  // An answer that leaves out views explains what is easy.
  if (!aspects.result.objects.empty() && aspects.score > judged.score &&
      Registered(aspects.result) >= Registered(result)) {
    return aspects.result;
  }
  if (result.objects.empty()) {
    HOROPTER_ASSIGN_OR_RETURN(result, ByRoutes(input, dear, context));
    judged = JudgeAnswer(*context, images, result);
  }
  RefuseContradicted(judged, options.contradicting_score, &result);
  return result.objects.empty() && !aspects.result.detail.empty() ? aspects.result : result;
}

// Nothing can be said of images without edges. Errors: INVALID_ARGUMENT.
absl::Status CheckInput(const RecognitionInput& input, const RecognitionOptions& options) {
  if (!input.hints.empty() && input.hints.size() != input.features.size())
    return absl::InvalidArgumentError("hints: one per image or none");
  return Validate(options);
}

std::optional<RecognitionResult> TooFewFeatures(const RecognitionInput& input) {
  std::size_t most_segments = 0;
  for (const ImageFeatures& f : input.features)
    most_segments = std::max(most_segments, f.segments.size());
  if (most_segments >= kMinSegments) return std::nullopt;
  RecognitionResult result;
  result.views.resize(input.features.size());
  result.state = RecognitionState::kTooFewFeatures;
  result.detail =
      absl::StrCat("at most ", most_segments, " segments in an image, need ", kMinSegments);
  return result;
}

}  // namespace

bool AspectsComeFirst(std::span<const std::shared_ptr<const PreparedObject>> objects,
                      const RecognitionOptions& options) {
  return options.routes.aspects && HaveAspects(objects, options.aspects) &&
         AreRich(objects, options.aspects);
}

absl::StatusOr<RecognitionResult> RecognizeByAspectsAlone(const RecognitionInput& input,
                                                          const RecognitionOptions& options,
                                                          const StopRequested& stop,
                                                          const StepListener& on_step) {
  HOROPTER_RETURN_IF_ERROR(CheckInput(input, options));
  if (input.images.size() != input.features.size())
    return absl::InvalidArgumentError("images: one per list of features");
  if (!HaveAspects(input.objects, options.aspects))
    return absl::InvalidArgumentError("objects: not all have aspects");
  if (auto result = TooFewFeatures(input)) return *std::move(result);
  const JointContext context =
      MakeContext({input.features, input.hints, nullptr, nullptr, input.objects, false},
                  options,
                  stop,
                  on_step);
  BeginStep(context, "aspect_images");
  const std::vector<AspectImage> images = MakeAspectImages(input.images, true, options.threads);
  HOROPTER_ASSIGN_OR_RETURN(AspectAnswer aspects, RecognizeByAspects(context, images));
  return std::move(aspects.result);
}

absl::StatusOr<RecognitionResult> RecognizeObjects(const RecognitionInput& input,
                                                   const RecognitionOptions& options,
                                                   const StopRequested& stop,
                                                   const StepListener& on_step) {
  HOROPTER_RETURN_IF_ERROR(CheckInput(input, options));
  if (input.matching == nullptr) return absl::InvalidArgumentError("matching: missing");
  if (auto result = TooFewFeatures(input)) return *std::move(result);
  JointContext context = MakeContext(
      {input.features, input.hints, input.matching, input.reconstruction, input.objects},
      options,
      stop,
      on_step);
  if (options.routes.aspects && HaveAspects(input.objects, options.aspects) &&
      input.images.size() == input.features.size()) {
    return WithAspects(input, &context);
  }
  return ByRoutes(input, options.routes, &context);
}

}  // namespace horopter
