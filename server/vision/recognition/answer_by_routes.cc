#include "server/vision/recognition/answer_by_routes.h"

#include <algorithm>
#include <memory>
#include <optional>
#include <utility>

#include "absl/strings/str_cat.h"
#include "server/base/status_macros.h"
#include "server/vision/recognition/initialization/view_linking.h"
#include "server/vision/recognition/interpretation/alternative_hypotheses.h"
#include "server/vision/recognition/interpretation/answer.h"
#include "server/vision/recognition/interpretation/decision.h"
#include "server/vision/recognition/interpretation/symmetric_views.h"
#include "server/vision/recognition/refusal_notes.h"
#include "server/vision/recognition/scene/surface_texture.h"
#include "server/vision/recognition/scoring/log_odds.h"

namespace horopter {
namespace {

// A way to a scene's first part. plane_found: the search on the plane has found parts, so that
// whoever needs no plane need not look.
struct Route {
  const char* name;
  bool (*applies)(const RecognitionInput& input, const RecognitionRoutes& on, bool plane_found);
  absl::StatusOr<FoundScene> (*run)(const RouteInput&, const JointContext&, RouteWork*);
};

// By cost; each is asked while nothing is found that chance does not explain.
constexpr Route kRoutes[] = {
    {"metric",
     [](const RecognitionInput& input, const RecognitionRoutes& on, bool) {
       return on.metric && input.reconstruction != nullptr;
     },
     MetricRoute},
    {"table",
     [](const RecognitionInput& input, const RecognitionRoutes& on, bool) {
       return on.supporting_plane && input.reconstruction != nullptr &&
              input.reconstruction->has_plane;
     },
     PlaneRoute},
    {"view_led",
     [](const RecognitionInput&, const RecognitionRoutes& on, bool plane_found) {
       return on.view_led && !plane_found;
     },
     ViewLedRoute},
    // In cameras that are trusted the metric route has asked for the same parts at lower cost.
    {"projective",
     [](const RecognitionInput& input, const RecognitionRoutes& on, bool) {
       return on.projective && !(on.metric && CamerasTrusted(input));
     },
     ProjectiveRoute},
};

struct RouteAnswers {
  FoundScene best;  // empty where no route finds one
  std::vector<std::string> unasked;
};

// The routes in their order, while time is left and the scene open. Errors: CANCELLED.
absl::StatusOr<RouteAnswers> AskRoutes(const RecognitionInput& input,
                                       const RecognitionRoutes& routes,
                                       const JointContext& context,
                                       RouteWork* work) {
  const RouteInput route_input{
      input.features, input.reconstruction, input.keys, input.slots, input.bottom_up};
  RouteAnswers answers;
  FoundScene& best = answers.best;
  bool plane_found = false;
  for (const Route& route : kRoutes) {
    if (!IsOpen(context, best)) break;
    if (!route.applies(input, routes, plane_found)) continue;
    if (IsStopRequested(context.give_up)) {
      answers.unasked.push_back(route.name);
      continue;
    }
    HOROPTER_ASSIGN_OR_RETURN(FoundScene found, route.run(route_input, context, work));
    if (found.route == RecognitionRoute::kSupportingPlane)
      plane_found = !found.scene.objects.empty();
    TakeIfBetter(context, std::move(found), &best);
    if (IsStopRequested(context.stop))
      return absl::CancelledError(absl::StrCat("stopped during the route ", route.name));
  }
  if (IsStopRequested(context.stop)) return absl::CancelledError("stopped between routes");
  return answers;
}

void ReportHypotheses(const JointContext& context,
                      const RouteWork& work,
                      RecognitionResult* result) {
  double hypotheses = 0;
  for (const auto& view : work.hypotheses) {
    for (const ViewHypotheses& object : view) {
      hypotheses += static_cast<double>(object.pool.size());
      const int kept = std::min<int>(context.options.hypotheses_per_object,
                                     static_cast<int>(object.best.size()));
      result->hypotheses.insert(
          result->hypotheses.end(), object.best.begin(), object.best.begin() + kept);
    }
  }
  result->counts["view_hypotheses"] = hypotheses;
  result->counts["initial_hypotheses"] = static_cast<double>(work.initial_count);
}

// A scene that is doubtful is not answered at all.
void RefuseScene(const JointContext& context,
                 std::span<const double> best_competing,
                 SceneModel* scene,
                 RefusalNotes* notes) {
  const double probability = SceneProbability(context, *scene, best_competing);
  const double needed = context.options.acceptance.scene.min_probability;
  scene->objects.clear();
  const bool unlikely = probability < needed;
  notes->Left(*scene,
              unlikely ? AcceptanceTest::kChance : AcceptanceTest::kFocal,
              unlikely ? needed : 0.0,
              [&](const PlacedObject&) { return probability; });
  scene->views.assign(scene->views.size(), std::nullopt);
}

// What is answered of the best scene: symmetric views aligned, alternatives heard, what chance
// explains left out.
RecognitionResult Conclude(const RecognitionInput& input,
                           FoundScene best,
                           const JointContext& context,
                           const RouteWork& work,
                           RefusalLog* log) {
  SceneModel& scene = best.scene;
  RefusalNotes notes(log);
  scene.views.resize(input.features.size());
  BeginStep(context, "symmetric_views");
  std::shared_ptr<const SurfaceImages> images;
  if (!scene.objects.empty()) images = MakeSurfaceImages(input.images, context.options.threads);
  AlignSymmetricViews(context, work.hypotheses, images.get(), &scene);
  notes.Begin(scene);
  DropChanceObjects(context, best.verified, &scene);
  notes.Left(scene,
             AcceptanceTest::kChance,
             MultipleTestingPenalty(input.objects.size()),
             LogLikelihoodRatio);
  BeginStep(context, "alternatives");
  std::vector<Alternative> alternatives =
      ContestObjects(context, images.get(), best.verified, &scene);
  notes.Left(scene, AcceptanceTest::kPlace, 0.0, [](const PlacedObject& p) { return p.score; });
  if (DropContradictedViews(context, &scene) > 0) EvaluateTogether(context, &scene);
  BeginStep(context, "surfaces");
  JudgeTexture(context, images.get(), &scene);
  notes.Begin(scene);
  DropUnlikelyObjects(context.options.acceptance.scene, &scene, &alternatives);
  notes.Left(scene, AcceptanceTest::kChance, 0.0, ObjectProbability);
  best.best_competing = BestCompeting(context, scene, best.verified, alternatives);
  const std::string doubt = ReasonToDoubt(context, scene, best.best_competing);
  if (!doubt.empty()) RefuseScene(context, best.best_competing, &scene, &notes);
  // A single part that the cameras hang on leaves them free to adapt to a wrong pose of it.
  const bool trusted = scene.objects.size() > 1 || CamerasTrusted(input);
  BeginStep(context, "result");
  RecognitionResult result =
      MakeResult(context, scene, best.verified, best.best_competing, alternatives, trusted);
  if (!result.objects.empty()) result.route = best.route;
  if (result.state == RecognitionState::kNoParallax) {
    const double parallax = LargestParallax(context, scene);
    notes.Begin(scene);
    notes.Left({scene.views, {}, {}, 0.0},
               AcceptanceTest::kParallax,
               context.options.acceptance.scene.min_parallax_rad,
               [&](const PlacedObject&) { return parallax; });
  }
  ReportHypotheses(context, work, &result);
  for (const ViewHypothesis& h : result.hypotheses) {
    if (log != nullptr && h.object == log->object) log->hypotheses.push_back(h);
  }
  result.counts["placements"] = static_cast<double>(best.verified.size());
  result.counts["objects"] = static_cast<double>(result.objects.size());
  result.counts["views"] = scene.registered();
  if (result.state == RecognitionState::kNothingFound) {
    result.detail = !doubt.empty() ? doubt
                                   : absl::StrCat(work.initial_count,
                                                  " linked hypotheses, none with a joint score of ",
                                                  context.options.acceptance.placements.min_score);
  }
  return result;
}

}  // namespace

bool CamerasTrusted(const RecognitionInput& input) {
  return input.reconstruction != nullptr && input.reconstruction->trusted;
}

absl::StatusOr<RecognitionResult> AnswerByRoutes(const RecognitionInput& input,
                                                 const RecognitionRoutes& routes,
                                                 const JointContext& context,
                                                 RouteWork* work,
                                                 RefusalLog* log) {
  HOROPTER_ASSIGN_OR_RETURN(RouteAnswers answers, AskRoutes(input, routes, context, work));
  RecognitionResult result = Conclude(input, std::move(answers.best), context, *work, log);
  result.unasked = std::move(answers.unasked);
  return result;
}

}  // namespace horopter
