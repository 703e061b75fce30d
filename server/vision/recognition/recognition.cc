#include "server/vision/recognition/recognition.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <string>

#include "absl/strings/str_cat.h"
#include "server/base/parallel_for.h"
#include "server/base/status_macros.h"
#include "server/vision/recognition/bottom_up_route.h"
#include "server/vision/recognition/prepared_object.h"
#include "server/vision/recognition/prospects.h"
#include "server/vision/recognition/rig_seeds.h"
#include "server/vision/recognition/rivals.h"
#include "server/vision/recognition/scene_growth.h"
#include "server/vision/recognition/scene_model.h"
#include "server/vision/recognition/scene_refine.h"
#include "server/vision/recognition/surface_texture.h"
#include "server/vision/recognition/symmetric_views.h"
#include "server/vision/recognition/table_search.h"
#include "server/vision/recognition/table_seeds.h"
#include "server/vision/recognition/verdict.h"
#include "server/vision/recognition/view_hypotheses.h"
#include "server/vision/recognition/view_linking.h"

namespace horopter {
namespace {

constexpr int kMinSegments = 5;  // fewer in every view: nothing can be said
constexpr int kExpandedSeeds = 8;
constexpr int kTableScales = 3;
constexpr double kRivalScaleGain = 0.5;  // of the best scene's gain: below it a seed is not tried
constexpr double kSameSeedPx = 10.0;     // working pixels

JointContext MakeContext(const RecognitionInput& input,
                         const RecognitionOptions& options,
                         const StopRequested& stop,
                         const StepListener& on_step) {
  JointContext context;
  context.on_step = on_step;
  BeginStep(context, "edge_maps");
  context.objects = input.objects;
  context.matching = input.matching;
  context.options = options;
  context.stop = stop;
  context.give_up = [stop, hurry = options.hurry] {
    return IsStopRequested(stop) || IsStopRequested(hurry);
  };
  const int views = static_cast<int>(input.features.size());
  context.views.resize(views);
  context.hypotheses.assign(views, std::vector<ViewHypotheses>(input.objects.size()));
  for (int v = 0; v < views; ++v)
    context.views[v] = BuildViewEvidence(input.features[v], options.threads);
  for (int v = 0; v < views; ++v) {
    const ImageFeatures& f = input.features[v];
    PinholeCamera camera = CenteredCamera(f.width, f.height, options.focal_start_widths * f.width);
    double sigma = options.focal_log_sigma;
    if (input.reconstruction != nullptr && input.reconstruction->trusted &&
        input.reconstruction->views[v]) {
      camera = input.reconstruction->views[v]->camera;
      sigma = std::min(sigma, std::max(0.02, input.reconstruction->views[v]->focal_log_sigma));
    }
    if (!input.hints.empty()) {
      const CameraHint& hint = input.hints[v];
      if (hint.focal_px) {
        camera.focal_px = *hint.focal_px;
        sigma = hint.focal_log_sigma.value_or(0.02);
      }
      if (hint.principal_point)
        camera.cx = hint.principal_point->x(), camera.cy = hint.principal_point->y();
      if (hint.k1) camera.k1 = *hint.k1;
    }
    context.start_cameras.push_back(camera);
    context.focal_log_sigma.push_back(sigma);
  }
  return context;
}

// Searches the given views (one flag each) for the given objects.
void FindAllViewHypotheses(const std::vector<bool>& wanted_views,
                           const std::vector<bool>& wanted_objects,
                           JointContext* context) {
  BeginStep(*context, "view_hypotheses");
  const int views = static_cast<int>(context->views.size());
  const int objects = static_cast<int>(context->objects.size());
  std::vector<std::vector<ImagePath>> paths(views);
  ViewHypothesisOptions options;
  for (int v = 0; v < views; ++v) {
    if (!wanted_views[v]) continue;
    const auto& flags = context->matching->segment_on_plane;
    paths[v] = FindImagePaths(*context->views[v].features,
                              v < static_cast<int>(flags.size()) ? flags[v] : std::vector<bool>{},
                              context->views[v].maps.working_from_image,
                              options.max_paths);
  }
  const std::vector<bool> promising = PromisingInViews(*context, paths, wanted_objects, {});
  ParallelFor(views * objects, context->options.threads, [&](int i) {
    const int v = i / objects, k = i % objects;
    if (!wanted_views[v] || !promising[k]) return;
    ViewHypothesisOptions of_view = options;
    of_view.focal_log_sigma = context->focal_log_sigma[v];
    context->hypotheses[v][k] = FindViewHypotheses(*context->objects[k],
                                                   k,
                                                   context->views[v],
                                                   v,
                                                   paths[v],
                                                   context->start_cameras[v],
                                                   of_view,
                                                   context->give_up);
  });
}

bool SameSeed(const JointContext& context, const SceneModel& a, const SceneModel& b) {
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
                           context.views[v].maps.working_from_image) > kSameSeedPx) {
      return false;
    }
  }
  return true;
}

// A scene with what was verified in it, and the route that found its first part.
struct FoundScene {
  SceneModel scene;
  std::vector<PlacedObject> verified;
  RecognitionRoute route = RecognitionRoute::kNone;
};

// Expands scenes that differ in scale; the one that chance explains least. (What is explained says
// less: among many objects some fit at any scale.)
SceneModel BestScale(const JointContext& context,
                     const std::vector<SceneModel>& seeds,
                     std::vector<PlacedObject>* verified) {
  SceneModel best;
  double best_odds = -std::numeric_limits<double>::infinity();
  for (const SceneModel& seed : seeds) {
    if (IsStopRequested(context.stop)) return {};
    if (!best.objects.empty() &&
        (seed.gain < kRivalScaleGain * best.gain || IsStopRequested(context.give_up))) {
      break;
    }
    std::vector<PlacedObject> placements;
    SceneModel scene = ExpandScene(context, seed, true, &placements);
    const double odds = SceneLogOdds(context, scene, RunnersUp(context, scene, placements));
    if (scene.objects.empty() || odds <= best_odds) continue;
    best_odds = odds;
    best = std::move(scene);
    *verified = std::move(placements);
  }
  return best;
}

// The routes in the cameras of the reconstruction. Views that these lack (the table's: they show no
// part of the plane's texture) are registered by what the parts found say of them.
FoundScene InKnownCameras(JointContext* context,
                          const std::vector<SceneModel>& seeds,
                          RecognitionRoute route) {
  FoundScene found;
  found.route = route;
  SceneModel& best = found.scene;
  best = BestScale(*context, seeds, &found.verified);
  if (best.objects.empty() || best.registered() == static_cast<int>(best.views.size()))
    return found;
  std::vector<bool> missing, wanted(context->objects.size(), false);
  for (const auto& view : best.views) missing.push_back(!view.has_value());
  for (const PlacedObject& o : best.objects) wanted[o.object] = true;
  FindAllViewHypotheses(missing, wanted, context);
  if (RegisterMissingViews(*context, &best) == 0) return found;
  SceneModel scene = best;
  RefineScene(*context, {}, &scene);
  std::vector<PlacedObject> placements;
  scene = ExpandScene(*context, scene, true, &placements);
  if (scene.gain <= best.gain) return found;
  best = std::move(scene);
  found.verified = std::move(placements);
  return found;
}

// Expands the best distinct seeds with the verified hypotheses only and returns the scene that
// explains most.
SceneModel BestExpansion(const JointContext& context, const std::vector<SceneModel>& seeds) {
  std::vector<SceneModel> distinct;
  for (const SceneModel& s : seeds) {
    if (static_cast<int>(distinct.size()) >= kExpandedSeeds) break;
    if (std::none_of(distinct.begin(), distinct.end(), [&](const SceneModel& d) {
          return SameSeed(context, d, s);
        })) {
      distinct.push_back(s);
    }
  }
  std::vector<SceneModel> expanded(distinct.size());
  ParallelFor(static_cast<int>(distinct.size()), context.options.threads, [&](int i) {
    expanded[i] = ExpandScene(context, distinct[i], false, nullptr);
  });
  const auto best = std::max_element(expanded.begin(),
                                     expanded.end(),
                                     [](const auto& x, const auto& y) { return x.gain < y.gain; });
  return best == expanded.end() ? SceneModel{} : *best;
}

// Whether the routes that ask the structure have a say: nothing was found, or what chance explains.
bool IsOpen(const JointContext& context, const FoundScene& found) {
  return found.scene.objects.empty() ||
         !ReasonToDoubt(context, found.scene, RunnersUp(context, found.scene, found.verified))
              .empty();
}

FoundScene Grow(const JointContext& context,
                const std::vector<SceneModel>& seeds,
                RecognitionRoute route) {
  BeginStep(context, "seed_expansion");
  SceneModel start = BestExpansion(context, seeds);
  FoundScene found;
  if (start.objects.empty()) return found;
  found.route = route;
  found.scene = ExpandScene(context, start, true, &found.verified);
  if (found.scene.gain < start.gain) found.scene = std::move(start);
  return found;
}

// Keeps the scene that nothing speaks against, of two such or neither the one that explains more.
void TakeIfBetter(const JointContext& context, FoundScene other, FoundScene* best) {
  if (other.scene.objects.empty()) return;
  const bool open = IsOpen(context, other), was_open = IsOpen(context, *best);
  if (open == was_open ? other.scene.gain > best->scene.gain : !open) *best = std::move(other);
}

// What the metric or the projective route finds.
absl::StatusOr<FoundScene> BottomUp(const RecognitionInput& input,
                                    JointContext* context,
                                    RecognitionRoute route) {
  HOROPTER_ASSIGN_OR_RETURN(const RouteCatalog catalog,
                            MakeRouteCatalog(input.objects, input.keys, input.slots));
  return route == RecognitionRoute::kMetric
             ? InKnownCameras(context, MetricSeeds(*context, *input.reconstruction, catalog), route)
             : Grow(*context, ProjectiveSeeds(*context, input.features, catalog), route);
}

absl::StatusOr<FoundScene> ViewLed(const RecognitionInput& input,
                                   JointContext* context,
                                   std::size_t* seed_count) {
  FindAllViewHypotheses(std::vector<bool>(context->views.size(), true),
                        std::vector<bool>(context->objects.size(), true),
                        context);
  if (IsStopRequested(context->stop)) return absl::CancelledError("stopped during view hypotheses");
  if (IsStopRequested(context->give_up)) return FoundScene();
  for (const bool through_plane : {true, false}) {
    BeginStep(*context, "linking");
    std::vector<SceneModel> seeds = LinkSeeds(*context, through_plane);
    if (through_plane && input.reconstruction != nullptr) {
      for (SceneModel& seed : RigSeeds(*context, *input.reconstruction, {}))
        seeds.push_back(std::move(seed));
      std::stable_sort(
          seeds.begin(), seeds.end(), [](const auto& x, const auto& y) { return x.gain > y.gain; });
    }
    if (IsStopRequested(context->stop))
      return absl::CancelledError("stopped while views were linked");
    *seed_count += seeds.size();
    FoundScene found = Grow(*context, seeds, RecognitionRoute::kViewLed);
    if (!found.scene.objects.empty()) return found;
  }
  return FoundScene();
}

}  // namespace

absl::StatusOr<RecognitionResult> RecognizeObjects(const RecognitionInput& input,
                                                   const RecognitionOptions& options,
                                                   const StopRequested& stop,
                                                   const StepListener& on_step) {
  if (!input.hints.empty() && input.hints.size() != input.features.size()) {
    return absl::InvalidArgumentError("hints: one per image or none");
  }
  if (input.matching == nullptr) return absl::InvalidArgumentError("matching: missing");
  HOROPTER_RETURN_IF_ERROR(Validate(options));
  RecognitionResult result;
  result.views.resize(input.features.size());
  std::size_t most_segments = 0;
  for (const ImageFeatures& f : input.features)
    most_segments = std::max(most_segments, f.segments.size());
  if (most_segments < kMinSegments) {
    result.state = RecognitionState::kTooFewFeatures;
    result.detail =
        absl::StrCat("at most ", most_segments, " segments in an image, need ", kMinSegments);
    return result;
  }

  JointContext context = MakeContext(input, options, stop, on_step);
  const RecognitionRoutes& routes = options.routes;
  std::size_t seed_count = 0;
  FoundScene best;
  const auto goes_on = [&] { return !IsStopRequested(context.give_up) && IsOpen(context, best); };
  if (routes.metric && input.reconstruction != nullptr && goes_on()) {
    HOROPTER_ASSIGN_OR_RETURN(best, BottomUp(input, &context, RecognitionRoute::kMetric));
  }
  if (IsStopRequested(stop)) return absl::CancelledError("stopped during the metric route");
  bool on_table = false;
  if (routes.table && goes_on() && input.reconstruction != nullptr &&
      input.reconstruction->has_plane) {
    FoundScene found = InKnownCameras(&context,
                                      TableSeeds(context, *input.reconstruction, {}, kTableScales),
                                      RecognitionRoute::kTable);
    on_table = !found.scene.objects.empty();
    TakeIfBetter(context, std::move(found), &best);
  }
  if (IsStopRequested(stop)) return absl::CancelledError("stopped during the search on the plane");
  if (routes.view_led && !on_table && goes_on()) {
    HOROPTER_ASSIGN_OR_RETURN(FoundScene found, ViewLed(input, &context, &seed_count));
    TakeIfBetter(context, std::move(found), &best);
  }
  // In cameras that are trusted the metric route has asked for the same parts at lower cost.
  const bool asked_metric =
      routes.metric && input.reconstruction != nullptr && input.reconstruction->trusted;
  if (routes.projective && !asked_metric && goes_on()) {
    HOROPTER_ASSIGN_OR_RETURN(FoundScene found,
                              BottomUp(input, &context, RecognitionRoute::kProjective));
    TakeIfBetter(context, std::move(found), &best);
  }
  if (IsStopRequested(stop)) return absl::CancelledError("stopped during the joint search");

  SceneModel& scene = best.scene;
  const std::vector<PlacedObject>& verified = best.verified;
  scene.views.resize(input.features.size());
  BeginStep(context, "symmetric_views");
  if (!scene.objects.empty())
    context.surface_images = MakeSurfaceImages(input.images, options.threads);
  AlignSymmetricViews(context, &scene);
  DropChanceObjects(context, verified, &scene);
  BeginStep(context, "rivals");
  std::vector<Rival> rivals = ContestObjects(context, verified, {}, &scene);
  if (DropContradictedViews(context, &scene) > 0) EvaluateTogether(context, &scene);
  BeginStep(context, "surfaces");
  JudgeTexture(context, &scene);
  DropUnlikelyObjects(&scene, &rivals);
  const std::string doubt =
      ReasonToDoubt(context, scene, RunnersUp(context, scene, verified, rivals));
  if (!doubt.empty()) {
    scene.objects.clear();
    scene.views.assign(input.features.size(), std::nullopt);
  }
  // A single part that the cameras hang on leaves them free to adapt to a wrong pose of it.
  const bool trusted = scene.objects.size() > 1 ||
                       (input.reconstruction != nullptr && input.reconstruction->trusted);
  BeginStep(context, "result");
  result = MakeResult(context, scene, verified, rivals, trusted);
  if (!result.objects.empty()) result.route = best.route;
  double hypotheses = 0;
  for (auto& view : context.hypotheses) {
    for (ViewHypotheses& object : view) {
      hypotheses += static_cast<double>(object.pool.size());
      const int kept =
          std::min<int>(options.hypotheses_per_object, static_cast<int>(object.best.size()));
      result.hypotheses.insert(
          result.hypotheses.end(), object.best.begin(), object.best.begin() + kept);
    }
  }
  result.counts["view_hypotheses"] = hypotheses;
  result.counts["seeds"] = static_cast<double>(seed_count);
  result.counts["placements"] = static_cast<double>(verified.size());
  result.counts["objects"] = static_cast<double>(result.objects.size());
  result.counts["views"] = scene.registered();
  if (result.state == RecognitionState::kNothingFound) {
    result.detail = !doubt.empty() ? doubt
                                   : absl::StrCat(seed_count,
                                                  " linked hypotheses, none with a joint score of ",
                                                  options.accept_score);
    if (IsStopRequested(options.hurry)) result.detail += "; time ran short before all was tried";
  }
  return result;
}

}  // namespace horopter
