#include "server/vision/recognition/interpretation/symmetric_views.h"

#include <algorithm>
#include <cstdlib>
#include <limits>
#include <optional>
#include <vector>

#include "server/base/parallel_for.h"
#include "server/vision/recognition/initialization/view_linking.h"
#include "server/vision/recognition/scene/scene_refine.h"
#include "server/vision/recognition/scene/surface_texture.h"

namespace horopter {
namespace {

constexpr std::size_t kMostSymmetries = 23;  // of a cube; more: a surface of revolution
constexpr int kFewestPatches = 4;            // by which a pose must look more alike than another
constexpr std::size_t kHypotheses = 4;       // of a view that are tried
constexpr int kFewestViews = 3;  // with so many aligned, views that fit none of them are left out

// Patches alike less patches unlike on the faces that two views see.
int Similarity(const JointContext& context,
               const SurfaceImages* images,
               const PlacedObject& placed,
               int a,
               const CalibratedCamera& view_a,
               int b,
               const CalibratedCamera& view_b) {
  SceneModel pair;
  pair.views.resize(context.views.size());
  pair.views[a] = view_a;
  pair.views[b] = view_b;
  pair.objects.push_back(placed);
  const int object = 0;
  const SurfaceTexture t = CompareSurfaces(context, images, pair, {&object, 1})[0];
  return t.alike - t.unlike;
}

// The camera as it is when the object seen is taken for its equivalent pose.
CalibratedCamera Turned(const CalibratedCamera& view,
                        const Rigid3& scene_from_object,
                        const Rigid3& symmetry) {
  return {view.camera,
          view.camera_from_scene * scene_from_object * symmetry * scene_from_object.Inverse()};
}

// The view turned so that its faces look like those of the nearest aligned view that decides.
std::optional<CalibratedCamera> AlignedTo(
    const JointContext& context,
    const SurfaceImages* images,
    const PlacedObject& placed,
    const std::vector<std::optional<CalibratedCamera>>& aligned,
    int v,
    const CalibratedCamera& view) {
  std::vector<CalibratedCamera> turned{view};
  for (const Rigid3& s : context.objects[placed.object]->model.symmetries)
    turned.push_back(Turned(view, placed.scene_from_object, s));
  std::vector<int> others;
  for (int w = 0; w < static_cast<int>(aligned.size()); ++w) {
    if (aligned[w]) others.push_back(w);
  }
  // Views that follow one another in a request mostly do so in space.
  std::stable_sort(others.begin(), others.end(), [&](int a, int b) {
    return std::abs(a - v) < std::abs(b - v);
  });
  for (const int w : others) {
    std::vector<int> similarity(turned.size(), 0);
    ParallelFor(static_cast<int>(turned.size()), context.options.threads, [&](int i) {
      if (IsStopRequested(context.stop)) return;
      similarity[i] = Similarity(context, images, placed, w, *aligned[w], v, turned[i]);
    });
    const auto best = std::max_element(similarity.begin(), similarity.end());
    const int most = *best;
    *best = std::numeric_limits<int>::min();
    const int next = *std::max_element(similarity.begin(), similarity.end());
    if (most >= std::max(next, 0) + kFewestPatches) return turned[best - similarity.begin()];
  }
  return std::nullopt;
}

// One of the view's own hypotheses of the object that fits the aligned views.
std::optional<CalibratedCamera> AnotherPose(
    const JointContext& context,
    const HypothesisTable& table,
    const SurfaceImages* images,
    const PlacedObject& placed,
    const std::vector<std::optional<CalibratedCamera>>& aligned,
    int v) {
  const auto& hypotheses = table[v][placed.object].best;
  for (std::size_t i = 0; i < std::min<std::size_t>(hypotheses.size(), kHypotheses); ++i) {
    const CalibratedCamera view{
        hypotheses[i].camera,
        hypotheses[i].camera_from_object * placed.scene_from_object.Inverse()};
    if (auto found = AlignedTo(context, images, placed, aligned, v, view)) return found;
  }
  return std::nullopt;
}

}  // namespace

void AlignSymmetricViews(const JointContext& context,
                         const HypothesisTable& hypotheses,
                         const SurfaceImages* images,
                         SceneModel* scene) {
  if (scene->objects.size() != 1 || scene->registered() < 2) return;
  const PlacedObject& placed = scene->objects[0];
  const auto& symmetries = context.objects[placed.object]->model.symmetries;
  if (symmetries.empty() || symmetries.size() > kMostSymmetries) return;
  std::vector<int> waiting;
  for (int v = 0; v < static_cast<int>(scene->views.size()); ++v) {
    if (!scene->views[v]) continue;
    if (LinkedByPlane(context, *scene, v)) return;
    waiting.push_back(v);
  }
  // Plain parts, most of all, are done here.
  const int object = 0;
  const SurfaceTexture now = CompareSurfaces(context, images, *scene, {&object, 1})[0];
  if (now.alike + now.unlike < kFewestPatches) return;
  const auto first = std::max_element(waiting.begin(), waiting.end(), [&](int a, int b) {
    return ViewScore(placed.support[a]) < ViewScore(placed.support[b]);
  });
  std::vector<std::optional<CalibratedCamera>> aligned(scene->views.size());
  aligned[*first] = scene->views[*first];
  waiting.erase(first);
  bool replaced = false;
  // What sees too little of the same faces waits until other views are there; then other poses of
  // the object in that view are tried.
  for (const bool others : {false, true}) {
    for (bool progress = true; progress;) {
      progress = false;
      for (std::size_t i = 0; i < waiting.size() && !IsStopRequested(context.stop);) {
        const int v = waiting[i];
        aligned[v] = others ? AnotherPose(context, hypotheses, images, placed, aligned, v)
                            : AlignedTo(context, images, placed, aligned, v, *scene->views[v]);
        if (!aligned[v]) {
          ++i;
          continue;
        }
        waiting.erase(waiting.begin() + static_cast<long>(i));
        progress = true;
        replaced = replaced || others;
      }
    }
  }
  const auto count = std::count_if(
      aligned.begin(), aligned.end(), [](const auto& view) { return view.has_value(); });
  if (IsStopRequested(context.stop) || count < 2) return;
  for (std::size_t v = 0; v < aligned.size(); ++v) {
    if (aligned[v] || count >= kFewestViews) scene->views[v] = aligned[v];
  }
  if (replaced) RefineScene(context, scene);
  if (replaced || (!waiting.empty() && count >= kFewestViews)) EvaluateTogether(context, scene);
}

}  // namespace horopter
