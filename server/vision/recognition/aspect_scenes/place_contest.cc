#include "server/vision/recognition/aspect_scenes/place_contest.h"

#include <algorithm>
#include <cmath>
#include <numeric>
#include <optional>
#include <utility>

#include "server/base/parallel_for.h"

namespace horopter {
namespace {

constexpr double kBetterTurnScore = 0.01;  // by which another turn must be better
constexpr double kReplacingScore = 0.02;   // by which another pose or part must be better; chosen
constexpr double kNearlyScore = 0.03;      // of a view by which it may be worse there; chosen
constexpr std::size_t kSettled = 6;        // other poses and parts of a place; chosen, for time

}  // namespace

PlaceContest::PlaceContest(const AspectLinkInput& input,
                           const AspectLinkOptions& options,
                           const ViewLinks& links,
                           const SceneObjects& objects)
    : in_(input), options_(options), links_(links), objects_(objects) {}

PlaceContest::Hiding PlaceContest::HidingOf(const LinkedScene& scene,
                                            const SceneLayers& layers,
                                            std::size_t object) {
  Hiding out;
  for (std::size_t other = 0; other < layers.size(); ++other) {
    if (scene.objects[other].score > scene.objects[object].score) out.push_back(&layers[other]);
  }
  return out;
}

bool PlaceContest::ChooseTurns(LinkedScene* scene) const {
  bool turned = false;
  std::optional<SceneLayers> layers;  // rendered for the first that may turn
  for (std::size_t i = 0; i < scene->objects.size(); ++i) {
    LinkedObject& o = scene->objects[i];
    std::vector<Rigid3> turns;
    links_.turns().AppendSpread(in_.models[o.object].near_turns, &turns);
    if (turns.empty()) continue;
    turns.insert(turns.begin(), Rigid3{});
    if (!layers) layers = objects_.HidingLayers(*scene);
    const Hiding hiding = HidingOf(*scene, *layers, i);
    std::vector<double> scores(turns.size());
    ParallelFor(static_cast<int>(turns.size()), options_.threads, [&](int t) {
      scores[t] =
          objects_.JudgeOne(scene->views, {o.object, o.scene_from_object * turns[t]}, hiding).score;
    });
    const auto best = std::max_element(scores.begin(), scores.end());
    if (*best < scores.front() + kBetterTurnScore) continue;
    o.scene_from_object = o.scene_from_object * turns[best - scores.begin()];
    turned = true;
  }
  return turned;
}

bool PlaceContest::IsAccepted(const LinkedScene& scene,
                              int object,
                              const Eigen::Vector3d& center) const {
  return std::any_of(scene.objects.begin(), scene.objects.end(), [&](const LinkedObject& o) {
    const RenderMesh& mesh = MeshOf(o.object);
    return o.object == object &&
           (o.scene_from_object * mesh.center.cast<double>() - center).norm() <
               options_.apart_share * mesh.diameter_m;
  });
}

std::vector<PlaceContest::Rated> PlaceContest::Settled(
    const LinkedScene& scene,
    const std::vector<AspectSceneObject>& candidates,
    const Hiding& hiding) const {
  std::vector<Rated> out(candidates.size());
  ParallelFor(static_cast<int>(candidates.size()), options_.threads, [&](int i) {
    auto settled = objects_.Settled(scene.views, candidates[i], hiding);
    if (!settled) return;
    out[i] = {settled->placed,
              objects_.JudgeOne(scene.views, settled->placed, hiding, settled->rendered).score};
  });
  return out;
}

double PlaceContest::BonusOf(const LinkedScene& scene,
                             std::size_t object,
                             const AspectSceneObject& placed) const {
  std::vector<LinkedObject> judged = scene.objects;
  judged[object].object = placed.object;
  judged[object].scene_from_object = placed.scene_from_object;
  objects_.FindLying(scene.views, kPlaneScore, &judged);
  return judged[object].lies ? options_.lying_bonus : 0.0;
}

std::vector<AspectSceneObject> PlaceContest::OtherPoses(
    const LinkedScene& scene,
    const LinkedObject& o,
    std::span<const AspectSceneObject> candidates) const {
  std::vector<AspectSceneObject> out;
  const RenderMesh& mesh = MeshOf(o.object);
  const Eigen::Vector3d here = o.scene_from_object * mesh.center.cast<double>();
  const auto view = std::find_if(
      scene.views.begin(), scene.views.end(), [](const auto& v) { return v.has_value(); });
  if (view == scene.views.end()) return out;
  const Rigid3 own = (*view)->camera_from_scene * o.scene_from_object;
  const double size = SizePx(in_.models[o.object], (*view)->camera, own);
  for (const AspectSceneObject& c : candidates) {
    if (out.size() >= kSettled) break;
    if (c.object != o.object) continue;
    const Eigen::Vector3d there = c.scene_from_object * mesh.center.cast<double>();
    if ((there - here).norm() > kSamePlaceShare * mesh.diameter_m) continue;
    const Rigid3 pose = (*view)->camera_from_scene * c.scene_from_object;
    if (PoseDistancePx(in_.models[o.object], (*view)->camera, own, (*view)->camera, pose) <
        kOtherPoseShare * size)
      continue;
    out.push_back(c);
  }
  return out;
}

bool PlaceContest::Contest(LinkedScene* scene, std::span<const AspectSceneObject> standing) const {
  bool replaced = false;
  std::optional<SceneLayers> layers;  // rendered for the first that has a rival
  for (std::size_t i = 0; i < scene->objects.size(); ++i) {
    LinkedObject& o = scene->objects[i];
    std::vector<AspectSceneObject> rivals = BetterInOneView(*scene, o);
    const std::vector<AspectSceneObject> turned = OtherPoses(*scene, o, standing);
    rivals.insert(rivals.end(), turned.begin(), turned.end());
    if (rivals.empty()) continue;
    if (!layers) layers = objects_.HidingLayers(*scene);
    const Hiding hiding = HidingOf(*scene, *layers, i);
    std::vector<Rated> others = Settled(*scene, rivals, hiding);
    for (Rated& other : others) {
      if (other.score > 0.0) other.score += BonusOf(*scene, i, other.placed);
    }
    const AspectSceneObject there{o.object, o.scene_from_object};
    const double own =
        objects_.JudgeOne(scene->views, there, hiding).score + BonusOf(*scene, i, there);
    const auto best = std::max_element(others.begin(), others.end(), IsWorse);
    if (best->score < own + kReplacingScore) continue;
    o.object = best->placed.object;
    o.scene_from_object = best->placed.scene_from_object;
    replaced = true;
  }
  return replaced;
}

std::vector<AspectSceneObject> PlaceContest::BetterInOneView(const LinkedScene& scene,
                                                             const LinkedObject& o) const {
  std::vector<std::pair<double, AspectSceneObject>> found;
  const Eigen::Vector3d here = o.scene_from_object * MeshOf(o.object).center.cast<double>();
  for (std::size_t v = 0; v < scene.views.size(); ++v) {
    if (!scene.views[v] || !o.shown[v]) continue;
    const AspectSceneView& view = *scene.views[v];
    for (const AspectHypothesis& h : links_.Hypotheses(static_cast<int>(v))) {
      const double lead = h.score - o.views[v].score;
      if (lead < -kNearlyScore) continue;
      const Rigid3 pose = WithFocal(h.camera_from_object, h.camera.focal_px, view.camera.focal_px);
      const AspectSceneObject placed{h.object, view.camera_from_scene.Inverse() * pose};
      const Eigen::Vector3d there =
          placed.scene_from_object * MeshOf(h.object).center.cast<double>();
      const double smaller = std::min(MeshOf(h.object).diameter_m, MeshOf(o.object).diameter_m);
      if ((there - here).norm() > kSamePlaceShare * smaller) continue;
      if (h.object == o.object) {
        const double size = SizePx(in_.models[o.object], view.camera, pose);
        const double off = PoseDistancePx(in_.models[h.object],
                                          view.camera,
                                          view.camera_from_scene * o.scene_from_object,
                                          view.camera,
                                          pose);
        if (off < kOtherPoseShare * size) continue;
      } else if (IsAccepted(scene, h.object, there)) {
        continue;
      }
      found.emplace_back(lead, placed);
    }
  }
  std::stable_sort(
      found.begin(), found.end(), [](const auto& a, const auto& b) { return a.first > b.first; });
  std::vector<AspectSceneObject> out;
  for (std::size_t i = 0; i < found.size() && i < kSettled; ++i) out.push_back(found[i].second);
  return out;
}

void PlaceContest::FindBestCompeting(LinkedScene* scene) const {
  for (LinkedObject& o : scene->objects) {
    const Eigen::Vector3d center = o.scene_from_object * MeshOf(o.object).center.cast<double>();
    std::vector<double> best(in_.models.size(), 0.0);
    std::vector<AspectSceneObject> candidates(in_.models.size());
    for (std::size_t v = 0; v < scene->views.size(); ++v) {
      if (!scene->views[v]) continue;
      const Rigid3 scene_from_camera = scene->views[v]->camera_from_scene.Inverse();
      for (const AspectHypothesis& h : links_.Hypotheses(v)) {
        if (h.object == o.object || h.score <= best[h.object]) continue;
        const Rigid3 placed =
            scene_from_camera *
            WithFocal(h.camera_from_object, h.camera.focal_px, scene->views[v]->camera.focal_px);
        const Eigen::Vector3d there = placed * MeshOf(h.object).center.cast<double>();
        const double size = std::min(MeshOf(h.object).diameter_m, MeshOf(o.object).diameter_m);
        if ((there - center).norm() > size || IsAccepted(*scene, h.object, there)) continue;
        best[h.object] = h.score;
        candidates[h.object] = {h.object, placed};
      }
    }
    std::vector<int> order(best.size());
    std::iota(order.begin(), order.end(), 0);
    std::stable_sort(order.begin(), order.end(), [&](int a, int b) { return best[a] > best[b]; });
    constexpr std::size_t kJudged = 4;  // best ones that are judged in full; chosen, for time
    std::vector<AspectSceneObject> judged;
    for (const int k : order) {
      if (judged.size() >= kJudged || best[k] <= 0.0) break;
      judged.push_back(candidates[k]);
    }
    const std::vector<Rated> others = Settled(*scene, judged);
    const auto most = std::max_element(others.begin(), others.end(), IsWorse);
    if (most == others.end() || most->score <= 0.0) continue;
    o.competing_score = most->score;
    o.competing_object = most->placed.object;
  }
}

}  // namespace horopter
