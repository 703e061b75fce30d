#include "server/vision/recognition/interpretation/scene_growth.h"

#include <algorithm>
#include <cmath>
#include <optional>

#include "server/vision/recognition/initialization/view_linking.h"
#include "server/vision/recognition/interpretation/placement_search.h"
#include "server/vision/recognition/interpretation/scene_expansion.h"
#include "server/vision/recognition/scene/remaining_evidence.h"
#include "server/vision/recognition/scene/scene_refine.h"
#include "server/vision/recognition/scene/standing_plane.h"
#include "server/vision/recognition/scene/support_surface.h"

namespace horopter {
namespace {

constexpr int kRounds = 4;  // expansion and refinement in turn while objects are added, at most
constexpr int kCornerViews = 3;         // with which corners in space are tried before the plane
constexpr double kSameLogFocal = 0.01;  // log of the ratio; larger changes call for another search
constexpr double kStillPx = 0.5;        // a search is not repeated when its cameras move less
constexpr double kFarPx = 1e9;          // a view came or went: everything moved

void Evaluate(const JointContext& context, SceneModel* scene) {
  VerifyScratch scratch;
  scene->description_gain = 0.0;
  for (PlacedObject& o : scene->objects) {
    EvaluatePlacement(context, scene->views, {}, &scratch, &o);
    scene->description_gain += std::max(0.0, o.description_gain);
  }
}

bool FocalLengthsMoved(const std::vector<std::optional<CalibratedCamera>>& before,
                       const std::vector<std::optional<CalibratedCamera>>& after) {
  for (std::size_t v = 0; v < before.size(); ++v) {
    if (!before[v] || !after[v]) continue;
    if (std::abs(std::log(after[v]->camera.focal_px / before[v]->camera.focal_px)) > kSameLogFocal)
      return true;
  }
  return false;
}

// How far (working pixels) the scene's objects are moved in the images by a refinement.
double LargestMove(const JointContext& context, const SceneModel& before, const SceneModel& after) {
  double largest = 0.0;
  for (std::size_t v = 0; v < before.views.size(); ++v) {
    if (before.views[v].has_value() != after.views[v].has_value()) return kFarPx;
    if (!before.views[v]) continue;
    for (std::size_t k = 0; k < before.objects.size(); ++k) {
      const CalibratedCamera &a = *before.views[v], &b = *after.views[v];
      largest =
          std::max(largest,
                   ProjectionDistance(*context.objects[before.objects[k].object],
                                      a.camera,
                                      a.camera_from_scene * before.objects[k].scene_from_object,
                                      b.camera,
                                      b.camera_from_scene * after.objects[k].scene_from_object,
                                      context.views[v].maps.working_from_image));
    }
  }
  return largest;
}

// What the last cameras say of a scene that grows no more.
void Complete(const JointContext& context,
              const std::vector<PlacedObject>& placements,
              SceneModel* scene) {
  BeginStep(context, "consolidation");
  // The last views may have been registered by fewer objects than there are now.
  DropContradictedViews(context, scene);
  // What lost its support in the refined cameras goes.
  std::vector<PlacedObject> placed = scene->objects;
  Consolidate(context, std::move(placed), scene);
  AddHiddenObjects(context, placements, scene);
}

// Where parts may stand and none was looked for yet.
std::vector<SearchSurface> OpenSurfaces(const JointContext& context,
                                        const SceneModel& scene,
                                        const std::vector<PlacedObject>& placements,
                                        const std::vector<SearchSurface>& searched,
                                        bool first) {
  const PlacementSearchOptions& options = context.options.search.placements;
  const PlacementAcceptance& acceptance = context.options.acceptance.placements;
  std::vector<SearchSurface> surfaces = SearchSurfaces(context,
                                                       scene,
                                                       placements,
                                                       options.doubtful_score,
                                                       acceptance.plane_tolerance_m,
                                                       options.max_surfaces);
  // A part may stand on one that is not found yet but as high as one that is.
  if (first) {
    for (SearchSurface& s : surfaces) s.discs.clear();
  }
  return NotCovered(surfaces, searched);
}

}  // namespace

SceneModel ExpandScene(const JointContext& context,
                       const HypothesisTable& hypotheses,
                       SceneModel scene,
                       bool thorough,
                       std::vector<PlacedObject>* verified) {
  PlacementRound search;
  search.thorough = thorough;
  std::vector<PlacedObject> placements;
  std::vector<bool> shortlist;
  std::vector<SearchSurface> searched;  // in cameras that are still good
  bool changed = true;
  for (int round = 0; changed && round < (thorough ? kRounds : 1); ++round) {
    if (round > 0 && IsStopRequested(context.give_up)) break;
    const std::size_t objects = scene.objects.size();
    const std::vector<std::optional<CalibratedCamera>> views = scene.views;
    if (thorough) BeginStep(context, "placements");
    if (const auto plane = PlaneFromMatches(context, scene.views))
      scene.plane = PlaneUnderObjects(context, scene.objects, *plane);
    std::vector<SearchSurface> surfaces;
    if (scene.plane) {
      surfaces = OpenSurfaces(context, scene, placements, searched, round == 0);
      // The first cameras know one part only: a first look finds parts that tell more of them.
      // Corners in space do so in a tenth of the time, where three views confirm them.
      search.first = round == 0;
      search.search_plane = round > 0 || scene.registered() < kCornerViews;
      if (round > 0) searched.insert(searched.end(), surfaces.begin(), surfaces.end());
    }
    // From the second round on parts are looked for among the edges that the first do not explain.
    std::optional<RemainingEvidence> rest;
    if (round > 0) {
      rest = WithoutExplained(context, scene, context.options.search.placements.sure_log_odds);
    }
    placements = CollectPlacements(context,
                                   rest ? rest->context : context,
                                   hypotheses,
                                   scene,
                                   surfaces,
                                   placements,
                                   search,
                                   &shortlist);
    if (verified != nullptr) *verified = placements;
    if (thorough) BeginStep(context, "consolidation");
    Consolidate(context, placements, &scene);
    if (scene.objects.empty()) break;
    if (thorough) BeginStep(context, "scene_refinement");
    const SceneModel before = scene;
    RefineScene(context, &scene);
    if (LargestMove(context, before, scene) > kStillPx) searched.clear();
    DropContradictedViews(context, &scene);
    if (RegisterMissingViews(context, hypotheses, &scene) > 0) {
      RefineScene(context, &scene);
      searched.clear();
    }
    Evaluate(context, &scene);
    // Twice at least: the first cameras know one part only.
    changed = round == 0 || scene.objects.size() > objects || FocalLengthsMoved(views, scene.views);
  }
  if (thorough) Complete(context, placements, &scene);
  return scene;
}

}  // namespace horopter
