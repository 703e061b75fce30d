#include "server/vision/recognition/interpretation/routes.h"

#include <algorithm>
#include <limits>
#include <utility>

#include "server/base/parallel_for.h"
#include "server/base/status_macros.h"
#include "server/vision/recognition/candidates/shortlist.h"
#include "server/vision/recognition/candidates/view_hypotheses.h"
#include "server/vision/recognition/initialization/bottom_up_route.h"
#include "server/vision/recognition/initialization/plane_initialization.h"
#include "server/vision/recognition/initialization/rig_initialization.h"
#include "server/vision/recognition/initialization/view_linking.h"
#include "server/vision/recognition/interpretation/decision.h"
#include "server/vision/recognition/interpretation/scene_growth.h"
#include "server/vision/recognition/scene/scene_refine.h"

namespace horopter {
namespace {

constexpr int kExpandedHypotheses = 8;   // distinct ones, best first; for time
constexpr double kOtherScaleGain = 0.5;  // of the best scene's description-length gain: below it an
                                         // initial hypothesis is not tried
constexpr double kSameHypothesisPx = 10.0;  // working pixels

// Searches the given views (one flag each) for the given objects.
void FindAllViewHypotheses(const std::vector<bool>& wanted_views,
                           const std::vector<bool>& wanted_objects,
                           const JointContext& context,
                           HypothesisTable* hypotheses) {
  BeginStep(context, "view_hypotheses");
  const int views = static_cast<int>(context.views.size());
  const int objects = static_cast<int>(context.objects.size());
  std::vector<std::vector<ImagePath>> paths(views);
  const ViewHypothesisOptions& options = context.options.search.views;
  for (int v = 0; v < views; ++v) {
    if (!wanted_views[v]) continue;
    const auto& flags = context.matching->segment_on_plane;
    paths[v] = FindImagePaths(*context.views[v].features,
                              v < static_cast<int>(flags.size()) ? flags[v] : std::vector<bool>{},
                              context.views[v].maps.working_from_image,
                              options.max_paths);
  }
  const std::vector<bool> promising = PromisingInViews(context, paths, wanted_objects);
  ParallelFor(views * objects, context.options.threads, [&](int i) {
    const int v = i / objects, k = i % objects;
    if (!wanted_views[v] || !promising[k]) return;
    ViewHypothesisOptions of_view = options;
    of_view.refine.focal_log_sigma = context.focal_log_sigma[v];
    (*hypotheses)[v][k] = FindViewHypotheses(*context.objects[k],
                                             k,
                                             context.views[v],
                                             v,
                                             paths[v],
                                             context.start_cameras[v],
                                             of_view,
                                             context.give_up);
  });
}

bool SameHypothesis(const JointContext& context, const SceneModel& a, const SceneModel& b) {
  if (a.objects[0].object != b.objects[0].object) return false;
  const PreparedObject& object = *context.objects[a.objects[0].object];
  for (std::size_t v = 0; v < a.views.size(); ++v) {
    if (a.views[v].has_value() != b.views[v].has_value()) return false;
    if (!a.views[v]) continue;
    if (ProjectionDistance(object,
                           a.views[v]->camera,
                           a.views[v]->camera_from_scene,
                           b.views[v]->camera,
                           b.views[v]->camera_from_scene,
                           context.views[v].maps.working_from_image) > kSameHypothesisPx) {
      return false;
    }
  }
  return true;
}

// Expands scenes that differ in scale; the one that chance explains least. (What is explained says
// less: among many objects some fit at any scale.)
FoundScene BestScale(const JointContext& context,
                     const HypothesisTable& hypotheses,
                     const std::vector<SceneModel>& starts) {
  FoundScene best;
  double best_odds = -std::numeric_limits<double>::infinity();
  for (const SceneModel& start : starts) {
    if (IsStopRequested(context.stop)) return {};
    if (!best.scene.objects.empty() &&
        (start.description_gain < kOtherScaleGain * best.scene.description_gain ||
         IsStopRequested(context.give_up))) {
      break;
    }
    FoundScene found;
    found.scene = ExpandScene(context, hypotheses, start, true, &found.verified);
    found.best_competing = BestCompeting(context, found.scene, found.verified);
    const double odds = SceneLogOdds(context, found.scene, found.best_competing);
    if (found.scene.objects.empty() || odds <= best_odds) continue;
    best_odds = odds;
    best = std::move(found);
  }
  return best;
}

// The routes in the cameras of the reconstruction. Views that these lack (the table's: they show no
// part of the plane's texture) are registered by what the parts found say of them.
FoundScene InKnownCameras(const JointContext& context,
                          HypothesisTable* hypotheses,
                          const std::vector<SceneModel>& starts,
                          RecognitionRoute route) {
  FoundScene found = BestScale(context, *hypotheses, starts);
  found.route = route;
  const SceneModel& best = found.scene;
  if (best.objects.empty() || best.registered() == static_cast<int>(best.views.size()))
    return found;
  std::vector<bool> missing, wanted(context.objects.size(), false);
  for (const auto& view : best.views) missing.push_back(!view.has_value());
  for (const PlacedObject& o : best.objects) wanted[o.object] = true;
  FindAllViewHypotheses(missing, wanted, context, hypotheses);
  if (RegisterMissingViews(context, *hypotheses, &found.scene) == 0) return found;
  FoundScene again;
  again.route = route;
  again.scene = best;
  RefineScene(context, &again.scene);
  again.scene = ExpandScene(context, *hypotheses, again.scene, true, &again.verified);
  FoundScene& better = again.scene.description_gain > best.description_gain ? again : found;
  better.best_competing = BestCompeting(context, better.scene, better.verified);
  return std::move(better);
}

// Expands the best distinct initial hypotheses with the verified hypotheses only and returns the
// scene that explains most.
SceneModel BestExpansion(const JointContext& context,
                         const HypothesisTable& hypotheses,
                         const std::vector<SceneModel>& starts) {
  std::vector<SceneModel> distinct;
  for (const SceneModel& s : starts) {
    if (static_cast<int>(distinct.size()) >= kExpandedHypotheses) break;
    if (std::none_of(distinct.begin(), distinct.end(), [&](const SceneModel& d) {
          return SameHypothesis(context, d, s);
        })) {
      distinct.push_back(s);
    }
  }
  std::vector<SceneModel> expanded(distinct.size());
  ParallelFor(static_cast<int>(distinct.size()), context.options.threads, [&](int i) {
    expanded[i] = ExpandScene(context, hypotheses, distinct[i], false, nullptr);
  });
  const auto best =
      std::max_element(expanded.begin(), expanded.end(), [](const auto& x, const auto& y) {
        return x.description_gain < y.description_gain;
      });
  return best == expanded.end() ? SceneModel{} : *best;
}

FoundScene Grow(const JointContext& context,
                const HypothesisTable& hypotheses,
                const std::vector<SceneModel>& starts,
                RecognitionRoute route) {
  BeginStep(context, "hypothesis_expansion");
  SceneModel start = BestExpansion(context, hypotheses, starts);
  FoundScene found;
  if (start.objects.empty()) return found;
  found.route = route;
  found.scene = ExpandScene(context, hypotheses, start, true, &found.verified);
  if (found.scene.description_gain < start.description_gain) found.scene = std::move(start);
  found.best_competing = BestCompeting(context, found.scene, found.verified);
  return found;
}

// The catalog's keys for the routes that ask them.
absl::StatusOr<RouteCatalog> CatalogOf(const RouteInput& input, const JointContext& context) {
  return MakeRouteCatalog(context.objects, input.keys, input.slots);
}

BottomUpOptions OptionsOf(const RouteInput& input) {
  return input.bottom_up != nullptr ? *input.bottom_up : BottomUpOptions();
}

}  // namespace

bool IsOpen(const JointContext& context, const FoundScene& found) {
  return found.scene.objects.empty() ||
         !ReasonToDoubt(context, found.scene, found.best_competing).empty();
}

void TakeIfBetter(const JointContext& context, FoundScene other, FoundScene* best) {
  if (best->scene.objects.empty() && best->verified.empty()) {
    *best = std::move(other);
    return;
  }
  if (other.scene.objects.empty()) return;
  const bool open = IsOpen(context, other), was_open = IsOpen(context, *best);
  if (open == was_open ? other.scene.description_gain > best->scene.description_gain : !open)
    *best = std::move(other);
}

absl::StatusOr<FoundScene> MetricRoute(const RouteInput& input,
                                       const JointContext& context,
                                       RouteWork* work) {
  HOROPTER_ASSIGN_OR_RETURN(const RouteCatalog catalog, CatalogOf(input, context));
  return InKnownCameras(
      context,
      &work->hypotheses,
      MetricInitialScenes(context, *input.reconstruction, catalog, OptionsOf(input)),
      RecognitionRoute::kMetric);
}

absl::StatusOr<FoundScene> PlaneRoute(const RouteInput& input,
                                      const JointContext& context,
                                      RouteWork* work) {
  return InKnownCameras(context,
                        &work->hypotheses,
                        PlaneInitialScenes(context, *input.reconstruction),
                        RecognitionRoute::kSupportingPlane);
}

absl::StatusOr<FoundScene> ProjectiveRoute(const RouteInput& input,
                                           const JointContext& context,
                                           RouteWork* work) {
  HOROPTER_ASSIGN_OR_RETURN(const RouteCatalog catalog, CatalogOf(input, context));
  return Grow(context,
              work->hypotheses,
              ProjectiveInitialScenes(context, input.features, catalog, OptionsOf(input)),
              RecognitionRoute::kProjective);
}

absl::StatusOr<FoundScene> ViewLedRoute(const RouteInput& input,
                                        const JointContext& context,
                                        RouteWork* work) {
  FindAllViewHypotheses(std::vector<bool>(context.views.size(), true),
                        std::vector<bool>(context.objects.size(), true),
                        context,
                        &work->hypotheses);
  if (IsStopRequested(context.stop)) return absl::CancelledError("stopped during view hypotheses");
  if (IsStopRequested(context.give_up)) return FoundScene();
  for (const bool through_plane : {true, false}) {
    BeginStep(context, "linking");
    std::vector<SceneModel> starts = LinkedInitialScenes(context, work->hypotheses, through_plane);
    if (through_plane && input.reconstruction != nullptr) {
      for (SceneModel& start : RigInitialScenes(context, work->hypotheses, *input.reconstruction))
        starts.push_back(std::move(start));
      std::stable_sort(starts.begin(), starts.end(), [](const auto& x, const auto& y) {
        return x.description_gain > y.description_gain;
      });
    }
    if (IsStopRequested(context.stop))
      return absl::CancelledError("stopped while views were linked");
    work->initial_count += starts.size();
    FoundScene found = Grow(context, work->hypotheses, starts, RecognitionRoute::kViewLed);
    if (!found.scene.objects.empty()) return found;
  }
  return FoundScene();
}

}  // namespace horopter
