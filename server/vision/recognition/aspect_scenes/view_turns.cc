#include "server/vision/recognition/aspect_scenes/view_turns.h"

#include <algorithm>
#include <cmath>

#include "server/base/parallel_for.h"
#include "server/vision/recognition/aspect_scenes/place_contest.h"
#include "server/vision/recognition/aspect_scenes/settled_scenes.h"

namespace horopter {
namespace {

constexpr std::size_t kAllowed = 12;  // poses of a view; chosen, for time
// What a view may lose in score by a turn. A box on stripes: 0.45 for the right turn's 0.59 in one
// of five views, at most 0.02 the other way in the others. Commit 7ff717a, as all here.
constexpr double kNearlyOwnScore = 0.06;
// ... and what a hypothesis' score may be below that before it is adjusted to the view's camera.
constexpr double kHopelessScore = 0.2;
// Surface and ground together (at most 2) of views that are not turned. Wrong turns had 0.3 - 1.1,
// right ones in their place 1.8 - 1.9, and 0.9 of a part among others that were not known yet.
constexpr double kAgreed = 1.5;
// Least that turned views have, and gain; the first of the ground alone where it alone tells. Wrong
// turns of a knob on fine stripes gained 0.1 there.
constexpr double kConvincing = 0.8, kConvincingGround = 0.5;
constexpr double kGained = 0.2;

// The scene with one registered view.
std::vector<std::optional<AspectSceneView>> Alone(const LinkedScene& scene, int view) {
  std::vector<std::optional<AspectSceneView>> out(scene.views.size());
  out[view] = scene.views[view];
  return out;
}

}  // namespace

ViewTurns::ViewTurns(const AspectLinkInput& input,
                     const AspectLinkOptions& options,
                     const ViewLinks& links,
                     const SceneObjects& objects)
    : in_(input), options_(options), links_(links), objects_(objects) {}

std::vector<AllowedPose> ViewTurns::OthersIn(const LinkedScene& scene, int view, double own) const {
  const LinkedObject& o = scene.objects.front();
  const AspectSceneView& seen = *scene.views[view];
  const Rigid3 scene_from_camera = seen.camera_from_scene.Inverse();
  std::vector<Rigid3> placed, turns;
  links_.turns().AppendSpread(in_.models[o.object].near_turns, &turns);
  for (const Rigid3& turn : turns) placed.push_back(o.scene_from_object * turn);
  for (const AspectHypothesis& h : links_.Hypotheses(view)) {
    if (h.object == o.object && h.score >= own - kHopelessScore)
      placed.push_back(scene_from_camera *
                       WithFocal(h.camera_from_object, h.camera.focal_px, seen.camera.focal_px));
  }
  const auto alone = Alone(scene, view);
  std::vector<AllowedPose> out(placed.size());
  ParallelFor(static_cast<int>(placed.size()), options_.threads, [&](int i) {
    auto settled = objects_.Settled(alone, {o.object, placed[i]});
    if (!settled) return;
    out[i] = {seen.camera_from_scene * settled->placed.scene_from_object,
              objects_.JudgeOne(alone, settled->placed, {}, settled->rendered).score};
  });
  std::stable_sort(
      out.begin(), out.end(), [](const auto& a, const auto& b) { return a.score > b.score; });
  return out;
}

std::vector<AllowedPose> ViewTurns::AllowedIn(const LinkedScene& scene, int view) const {
  const LinkedObject& o = scene.objects.front();
  const AspectModel& model = in_.models[o.object];
  const AspectSceneView& seen = *scene.views[view];
  const Rigid3 stated = seen.camera_from_scene * o.scene_from_object;
  const double apart_px = kOtherPoseShare * SizePx(model, seen.camera, stated);
  // What looks the same in one view is another camera beside the others.
  std::vector<Rigid3> symmetries = {Rigid3{}};
  links_.turns().AppendSpread(model.symmetries, &symmetries);
  AspectModel told_apart;
  told_apart.object = model.object;
  const double own = objects_.JudgeOne(Alone(scene, view), {o.object, o.scene_from_object}).score;
  std::vector<AllowedPose> out;
  const auto add = [&](const AllowedPose& pose) {
    for (const Rigid3& symmetry : symmetries) {
      const Rigid3 same = pose.camera_from_object * symmetry;
      const bool listed = std::any_of(out.begin(), out.end(), [&](const AllowedPose& other) {
        return PoseDistancePx(
                   told_apart, seen.camera, other.camera_from_object, seen.camera, same) < apart_px;
      });
      if (!listed && out.size() < kAllowed) out.push_back({same, pose.score});
    }
  };
  add({stated, own});
  for (const AllowedPose& pose : OthersIn(scene, view, own)) {
    if (out.size() >= kAllowed || pose.score < own - kNearlyOwnScore) break;
    add(pose);
  }
  return out;
}

std::optional<AspectScene> ViewTurns::Turned(const LinkedScene& scene) const {
  if (scene.objects.size() != 1 || scene.registered() < 2) return std::nullopt;
  const LinkedObject& o = scene.objects.front();
  const AspectModel& model = in_.models[o.object];
  if (model.symmetries.empty() && model.near_turns.empty()) return std::nullopt;
  const ViewAgreement stated = objects_.WithGround(scene);
  if (stated.surface.mean + stated.ground >= kAgreed || GroundSettles(scene, stated))
    return std::nullopt;
  AgreeingPosesOptions agreeing = options_.agreeing;
  agreeing.surface_tells = model.round.empty();
  agreeing.threads = options_.threads;
  std::vector<PinholeCamera> cameras(scene.views.size());
  std::vector<std::vector<AllowedPose>> allowed(scene.views.size());
  for (std::size_t v = 0; v < scene.views.size(); ++v) {
    if (!scene.views[v] || !o.shown[v]) continue;
    cameras[v] = scene.views[v]->camera;
    allowed[v] = AllowedIn(scene, static_cast<int>(v));
  }
  const AgreeingPoses found =
      FindAgreeingPoses(in_.images, cameras, model.object->mesh, model.resting, allowed, agreeing);
  const double agreed = found.best.Agreement();
  if (agreed < (agreeing.surface_tells ? kConvincing : kConvincingGround) ||
      agreed < found.first.Agreement() + kGained)
    return std::nullopt;
  AspectScene out;
  out.views = scene.views;
  out.objects = {{o.object, o.scene_from_object}};
  for (std::size_t v = 0; v < out.views.size(); ++v) {
    if (found.best.poses[v] < 0) continue;
    out.views[v]->camera_from_scene =
        allowed[v][found.best.poses[v]].camera_from_object * o.scene_from_object.Inverse();
  }
  return out;
}

}  // namespace horopter
