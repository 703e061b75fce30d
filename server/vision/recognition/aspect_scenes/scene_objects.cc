#include "server/vision/recognition/aspect_scenes/scene_objects.h"

#include <algorithm>
#include <numeric>

#include "server/base/parallel_for.h"
#include "server/base/rounded.h"
#include "server/vision/recognition/aspect_search/near_plane.h"
#include "server/vision/recognition/aspect_search/object_layers.h"
#include "server/vision/recognition/aspect_search/pose_rendering.h"

namespace horopter {
namespace {

constexpr double kChanceScore = 0.4;  // what a wrong pose reaches in one image
constexpr double kShownScore = 0.35;  // of the best object in a view whose camera is right
constexpr double kSettleSearchPx[] = {8.0, 5.0, 3.0};  // working pixels, rounds of a settlement
constexpr int kSettleSteps = 3;                        // of each round
constexpr int kSettlePoints = 120;                     // of a view
// Working pixels; poses that shifted by less keep their rendering. At 3 px right turns settled less
// well than wrong ones (part 13 in scene 21 of cad-dev). Commit b2b2e44.
constexpr double kStalePx = 1.0;
// An edge point that has met the image: within so many px. Of 13,491 candidates in scenes of three
// data sets those that scored min_quick in the end had met 0.34 and more after the first round,
// but for 1 in 100; half of the others and more had not. Commit 43cac74.
constexpr double kMetPx = 3.0;
constexpr double kLeastMet = 0.34;
constexpr double kFairPlaneScore = 0.38;  // as kPlaneScore, in the end, where none reaches that
// Of the best object of a scene: correlation of its brightness between the views, right ones have
// 0.37 and more. Commit 38de6ec, the scenes of ADR 41.
constexpr double kAgreeingSurface = 0.4;
// Of the first round's search: a candidate that was as near to one that was refused settles as that
// did; chosen.
constexpr double kSameQuestionPx = 3.0;
constexpr double kReachShare = 0.2;  // ... in space: centres of different parts are farther apart
constexpr double kOverlapShare = 0.35;  // of the smaller size: centres nearer in all views overlap

}  // namespace

SceneObjects::SceneObjects(const AspectLinkInput& input,
                           const AspectLinkOptions& options,
                           const StopRequested& stop)
    : in_(input), options_(options), stop_(stop) {
  for (const AspectModel& model : in_.models) meshes_.push_back(&model.object->mesh);
}

double SceneObjects::Sift(AspectScene* scene) const {
  std::vector<LinkedObject> judged = Judge(*scene, kQuickRenderPx);
  bool dropped = false;
  for (std::size_t v = 0; v < scene->views.size(); ++v) {
    if (!scene->views[v]) continue;
    double best = 0.0;
    for (const LinkedObject& o : judged) {
      if (o.shown[v]) best = std::max(best, o.views[v].score);
    }
    if (best >= kShownScore) continue;
    scene->views[v].reset();
    dropped = true;
  }
  if (dropped) judged = Judge(*scene, kQuickRenderPx);
  return Keep(judged, scene);
}

Explained SceneObjects::ExplainedBy(const LinkedObject& o) const {
  Explained out;
  for (std::size_t v = 0; v < o.views.size(); ++v) {
    if (!o.shown[v]) continue;
    out.above_chance +=
        std::max(0.0, o.views[v].score + (o.lies ? kLyingBonus : 0.0) - kChanceScore);
    ++out.views;
  }
  return out;
}

double SceneObjects::Value(const LinkedObject& o) const {
  return o.score + (o.lies ? kLyingBonus : 0.0);
}

std::vector<SupportingPlane> SceneObjects::PlanesOf(
    const std::vector<std::optional<AspectSceneView>>& views,
    const std::vector<LinkedObject>& judged,
    double least,
    int but) const {
  std::vector<AspectSceneObject> givers;
  int left_out = -1;
  for (int i = 0; i < static_cast<int>(judged.size()); ++i) {
    if (judged[i].score < least) continue;
    if (i == but) left_out = static_cast<int>(givers.size());
    givers.push_back({judged[i].object, judged[i].scene_from_object});
  }
  return PlanesToLieOn(givers, in_.models, views, left_out);
}

void SceneObjects::FindLying(const std::vector<std::optional<AspectSceneView>>& views,
                             double least,
                             std::vector<LinkedObject>* judged,
                             double slack) const {
  const std::vector<SupportingPlane> planes = PlanesOf(views, *judged, least);
  for (int i = 0; i < static_cast<int>(judged->size()); ++i) {
    LinkedObject& o = (*judged)[i];
    const AspectModel& model = in_.models[o.object];
    const std::vector<SupportingPlane> beside =
        o.score >= least ? PlanesOf(views, *judged, least, i) : planes;
    o.lies = LiesOn(beside, o.scene_from_object, model, slack);
    o.leans = Leans(beside, o.scene_from_object, model);
    o.level = IsLevel(beside, o.scene_from_object, model);
  }
}

void SceneObjects::FindLying(const std::vector<std::optional<AspectSceneView>>& views,
                             std::vector<LinkedObject>* judged,
                             double slack) const {
  const bool any_gives_planes = std::any_of(
      judged->begin(), judged->end(), [](const LinkedObject& o) { return o.score >= kPlaneScore; });
  FindLying(views, any_gives_planes ? kPlaneScore : kFairPlaneScore, judged, slack);
}

SceneJudgementOptions SceneObjects::Judging(double render_px) const {
  SceneJudgementOptions out;
  out.render_px = render_px;
  if (render_px < kFineRenderPx) out.presumed_recall = kPresumedRecall;
  return out;
}

std::vector<LinkedObject> SceneObjects::Judge(const AspectScene& scene, double render_px) const {
  SceneJudgementOptions judging = Judging(render_px);
  judging.threads = options_.threads;
  return JudgeScene(in_.images, meshes_, scene, judging);
}

LinkedObject SceneObjects::JudgeOne(const std::vector<std::optional<AspectSceneView>>& views,
                                    const AspectSceneObject& placed,
                                    std::span<const std::vector<ObjectLayer>* const> others,
                                    std::span<PoseRendering> rendered) const {
  return JudgeInViews(in_.images,
                      *meshes_[placed.object],
                      views,
                      placed,
                      Judging(kQuickRenderPx),
                      others,
                      rendered);
}

double SceneObjects::Keep(std::vector<LinkedObject> judged, AspectScene* scene) const {
  FindLying(scene->views, kPlaneScore, &judged);
  std::vector<int> order(judged.size());
  std::iota(order.begin(), order.end(), 0);
  std::stable_sort(order.begin(), order.end(), [&](int a, int b) {
    return Value(judged[a]) > Value(judged[b]);
  });
  std::vector<AspectSceneObject> kept;
  std::vector<Explained> explained;
  for (const int i : order) {
    if (Value(judged[i]) < options_.min_joint) break;
    if (!IsFree(scene->views, kept, scene->objects[i])) continue;
    kept.push_back(scene->objects[i]);
    explained.push_back(ExplainedBy(judged[i]));
  }
  scene->objects = std::move(kept);
  return ExplainedTogether(explained);
}

Eigen::Vector3d SceneObjects::CenterOf(const AspectSceneObject& o) const {
  return o.scene_from_object * meshes_[o.object]->center.cast<double>();
}

SceneLayers SceneObjects::HidingLayers(const LinkedScene& scene) const {
  SceneJudgementOptions judging = Judging(kQuickRenderPx);
  judging.threads = options_.threads;
  return MakeSceneLayers(in_.images, meshes_, SceneOf(scene), scene.objects, judging);
}

bool SceneObjects::IsFree(const std::vector<std::optional<AspectSceneView>>& views,
                          const std::vector<AspectSceneObject>& taken,
                          const AspectSceneObject& o) const {
  const double diameter = meshes_[o.object]->diameter_m;
  return std::none_of(taken.begin(), taken.end(), [&](const AspectSceneObject& other) {
    const double smaller = std::min(diameter, meshes_[other.object]->diameter_m);
    const Eigen::Vector3d here = CenterOf(o), there = CenterOf(other);
    // Another part may stand before or behind it, or reach into it.
    const bool other_part = other.object != o.object;
    if ((here - there).norm() < (other_part ? kReachShare : kOnePlaceShare) * smaller) return true;
    if (other_part) return false;
    int seen = 0;
    for (const auto& view : views) {
      if (!view) continue;
      const Eigen::Vector3d a = view->camera_from_scene * here, b = view->camera_from_scene * there;
      if (a.z() < kNearM || b.z() < kNearM) return false;
      const double size = view->camera.focal_px * smaller / std::max(a.z(), b.z());
      if ((Project(view->camera, a) - Project(view->camera, b)).norm() > kOverlapShare * size) {
        return false;
      }
      ++seen;
    }
    return seen > 1;
  });
}

SceneObjects::Refused SceneObjects::InViews(
    const std::vector<std::optional<AspectSceneView>>& views,
    const AspectSceneObject& placed) const {
  Refused out{placed.object, std::vector<std::optional<Rigid3>>(views.size())};
  for (std::size_t v = 0; v < views.size(); ++v) {
    if (views[v])
      out.camera_from_object[v] = views[v]->camera_from_scene * placed.scene_from_object;
  }
  return out;
}

bool SceneObjects::WasRefused(const std::vector<std::optional<AspectSceneView>>& views,
                              const Refused& asked) const {
  AspectModel told_apart;
  told_apart.object = in_.models[asked.object].object;
  return std::any_of(refused_.begin(), refused_.end(), [&](const Refused& other) {
    if (other.object != asked.object) return false;
    for (std::size_t v = 0; v < views.size(); ++v) {
      const auto& a = asked.camera_from_object[v];
      const auto& b = other.camera_from_object[v];
      if (a.has_value() != b.has_value()) return false;
      if (a &&
          PoseDistancePx(told_apart, views[v]->camera, *a, views[v]->camera, *b) > kSameQuestionPx)
        return false;
    }
    return true;
  });
}

void SceneObjects::Place(std::vector<AspectSceneObject> candidates,
                         double least,
                         AspectScene* scene) const {
  std::erase_if(candidates, [&](const AspectSceneObject& c) {
    return WasRefused(scene->views, InViews(scene->views, c));
  });
  if (candidates.empty()) return;
  const std::vector<AspectSceneObject> asked = candidates;
  std::vector<LinkedObject> there(scene->objects.size());
  ParallelFor(static_cast<int>(there.size()), options_.threads, [&](int i) {
    there[i] = JudgeOne(scene->views, scene->objects[i]);
  });
  SceneJudgementOptions judging = Judging(kQuickRenderPx);
  judging.threads = options_.threads;
  const SceneLayers layers = MakeSceneLayers(in_.images, meshes_, *scene, there, judging);
  std::vector<const std::vector<ObjectLayer>*> others;
  for (const std::vector<ObjectLayer>& object : layers) others.push_back(&object);
  const std::vector<SupportingPlane> planes = PlanesOf(scene->views, there, kPlaneScore);
  std::vector<LinkedObject> judged(candidates.size());
  ParallelFor(static_cast<int>(candidates.size()), options_.threads, [&](int i) {
    if (IsStopRequested(stop_)) return;
    // Its depth is the least certain: the other views set it.
    std::optional<SettledObject> settled = Settled(scene->views, candidates[i], others);
    if (!settled) return;
    candidates[i] = settled->placed;
    judged[i] = JudgeOne(scene->views, candidates[i], others, settled->rendered);
    judged[i].lies =
        LiesOn(planes, candidates[i].scene_from_object, in_.models[candidates[i].object]);
  });
  for (std::size_t i = 0; i < judged.size() && !IsStopRequested(stop_); ++i) {
    if (Value(judged[i]) < options_.min_quick - kClearly)
      refused_.push_back(InViews(scene->views, asked[i]));
  }
  std::vector<int> order(judged.size());
  std::iota(order.begin(), order.end(), 0);
  std::stable_sort(order.begin(), order.end(), [&](int a, int b) {
    return Value(judged[a]) > Value(judged[b]);
  });
  for (const int i : order) {
    if (Value(judged[i]) < least) break;
    if (IsFree(scene->views, scene->objects, candidates[i]))
      scene->objects.push_back(candidates[i]);
  }
}

std::optional<SettledObject> SceneObjects::Settled(
    const std::vector<std::optional<AspectSceneView>>& views,
    const AspectSceneObject& placed,
    std::span<const std::vector<ObjectLayer>* const> others) const {
  return SettleInViews(
      in_.images, *meshes_[placed.object], views, placed, kQuickRenderPx, kLeastMet, others);
}

LinkedScene SceneObjects::Result(const AspectScene& scene) const {
  LinkedScene out;
  out.views = scene.views;
  if (scene.objects.empty()) {
    out.views.assign(scene.views.size(), std::nullopt);
    return out;
  }
  std::vector<LinkedObject> judged = Judge(scene, kFineRenderPx);
  FindLying(scene.views, &judged);
  std::vector<Explained> explained;
  for (LinkedObject& o : judged) {
    if (Value(o) < options_.min_joint) continue;
    explained.push_back(ExplainedBy(o));
    out.objects.push_back(std::move(o));
  }
  out.score = ExplainedTogether(explained);
  std::stable_sort(out.objects.begin(), out.objects.end(), [](const auto& a, const auto& b) {
    return a.score > b.score;
  });
  if (!out.objects.empty() && out.registered() > 1) AgreeOnSurface(&out);
  return out;
}

std::vector<ObjectLayer> SceneObjects::LayersOf(const LinkedScene& scene,
                                                const LinkedObject& o) const {
  return LayersInViews(
      in_.images, scene.views, *meshes_[o.object], o.scene_from_object, kQuickRenderPx);
}

std::vector<ObjectLayer> SceneObjects::ShownOfFirst(const LinkedScene& scene,
                                                    bool without_hidden) const {
  const LinkedObject& first = scene.objects.front();
  std::vector<ObjectLayer> out = LayersOf(scene, first);
  for (std::size_t v = 0; v < out.size(); ++v) {
    if (!first.shown[v]) out[v] = {};
  }
  for (std::size_t i = 1; without_hidden && i < scene.objects.size(); ++i) {
    const std::vector<ObjectLayer> other = LayersOf(scene, scene.objects[i]);
    for (std::size_t v = 0; v < out.size(); ++v) HideBehind(other[v], &out[v]);
  }
  return out;
}

void SceneObjects::AgreeOnSurface(LinkedScene* scene) const {
  ViewAgreement& agreement = scene->agreement;
  const auto agree = [&](bool without_hidden) {
    agreement.surface =
        SurfaceCorrelations(in_.images, scene->views, ShownOfFirst(*scene, without_hidden));
  };
  agree(false);
  bool doubtful = agreement.Contradicts(kAgreeingSurface);
  for (int v = 0; v < static_cast<int>(scene->views.size()); ++v)
    doubtful = doubtful || agreement.IsOdd(v);
  // What other parts hide takes time and is rarely asked for.
  if (doubtful && scene->objects.size() > 1) agree(true);
}

ViewAgreement SceneObjects::WithGround(const LinkedScene& scene) const {
  const LinkedObject& first = scene.objects.front();
  const AspectModel& model = in_.models[first.object];
  const std::vector<ObjectLayer> layers = LayersOf(scene, first);
  ViewAgreement out = scene.agreement;
  // Views turn about a round part's axis as they like: the ground denies their turns, not the part.
  out.texture = model.round.empty() ? TextureAround(in_.images, scene.views, layers) : 0.0;
  out.ground =
      GroundAgreement(in_.images, scene.views, layers, model.resting, first.scene_from_object);
  return out;
}

void SceneObjects::MeasureSurfaces(LinkedScene* scene) const {
  std::vector<std::vector<ObjectLayer>> layers(scene->objects.size());
  ParallelFor(static_cast<int>(layers.size()), options_.threads, [&](int i) {
    layers[i] = LayersOf(*scene, scene->objects[i]);
  });
  ParallelFor(static_cast<int>(layers.size()), options_.threads, [&](int i) {
    LinkedObject& o = scene->objects[i];
    std::vector<ObjectLayer> own = layers[i];
    for (std::size_t v = 0; v < own.size(); ++v) {
      if (!o.shown[v]) own[v] = {};
      for (int better = 0; better < i; ++better) HideBehind(layers[better][v], &own[v]);
    }
    const Correlations surface = SurfaceCorrelations(in_.images, scene->views, own);
    o.surface = surface.mean;
    o.surface_pairs = surface.pairs;
  });
}

double ExplainedTogether(std::span<const Explained> objects) {
  double borne_out = 0.0, most_chosen = 0.0;
  for (const Explained& o : objects) {
    if (o.views <= 0) continue;
    const double chosen = o.above_chance / o.views;
    borne_out += o.above_chance - chosen;
    most_chosen = std::max(most_chosen, chosen);
  }
  return borne_out + most_chosen;
}

namespace {

// Edge points that others hide are not looked for: what is found there is of the others.
void DropHidden(const AspectImage& image,
                const RenderMesh& mesh,
                const AspectSceneView& view,
                const AspectSceneObject& placed,
                std::span<const std::vector<ObjectLayer>* const> others,
                std::size_t v,
                std::vector<ModelEdgePoint>* points) {
  if (others.empty()) return;
  std::vector<const ObjectLayer*> layers;
  for (const std::vector<ObjectLayer>* of_views : others) layers.push_back(&(*of_views)[v]);
  const PinholeCamera working = WorkingCamera(image, view.camera);
  const Rigid3 pose = view.camera_from_scene * placed.scene_from_object;
  const double slack_m = kHiddenShare * mesh.diameter_m;
  std::erase_if(*points, [&](const ModelEdgePoint& p) {
    const Eigen::Vector3d there = pose * p.point.cast<double>();
    if (there.z() < kNearM) return false;
    const Eigen::Vector2d u = Project(working, there);
    const int x = Rounded(u.x()), y = Rounded(u.y());
    const float near = static_cast<float>(1.0 / std::max(kNearM, there.z() - slack_m));
    return IsCovered(layers, x, y, near);
  });
}

}  // namespace

std::optional<SettledObject> SettleInViews(
    std::span<const AspectImage> images,
    const RenderMesh& mesh,
    const std::vector<std::optional<AspectSceneView>>& views,
    AspectSceneObject out,
    double render_px,
    double least_met,
    std::span<const std::vector<ObjectLayer>* const> others) {
  VisibleEdgeOptions visible;
  visible.render_px = render_px;
  std::vector<PoseRendering> renderings(views.size(), PoseRendering(mesh, visible, kStalePx));
  std::vector<std::vector<ModelEdgePoint>> points(views.size());
  double met = 0.0;
  for (const double search : kSettleSearchPx) {
    PoseEdgeOptions edges;
    edges.search_px = search;
    for (std::size_t v = 0; v < views.size(); ++v) {
      if (!views[v]) continue;
      points[v] =
          ThinnedEdgePoints(renderings[v].At(WorkingCamera(images[v], views[v]->camera),
                                             views[v]->camera_from_scene * out.scene_from_object),
                            kSettlePoints);
      DropHidden(images[v], mesh, *views[v], out, others, v, &points[v]);
    }
    for (int step = 0; step < kSettleSteps; ++step) {
      std::vector<SceneRow> rows;
      std::size_t all = 0, near = 0;
      for (std::size_t v = 0; v < views.size(); ++v) {
        if (points[v].empty()) continue;
        all += points[v].size();
        for (const PoseEdgeMatch& m :
             MatchPoseEdges(images[v],
                            points[v],
                            views[v]->camera,
                            views[v]->camera_from_scene * out.scene_from_object,
                            edges)) {
          rows.push_back({static_cast<int>(v), 0, m.point, m.matched, m.normal, m.weight});
          near += std::abs(m.residual_px) < kMetPx;
        }
      }
      met = static_cast<double>(near) / static_cast<double>(std::max<std::size_t>(all, 1));
      out.scene_from_object = AdjustObjectToRows(rows, views, out.scene_from_object);
    }
    if (search == kSettleSearchPx[0] && met < least_met) return std::nullopt;
  }
  return SettledObject{out, std::move(renderings)};
}

}  // namespace horopter
