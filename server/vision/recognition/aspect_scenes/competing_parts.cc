#include "server/vision/recognition/aspect_scenes/competing_parts.h"

#include <algorithm>
#include <numeric>
#include <vector>

#include "server/base/parallel_for.h"

namespace horopter {
namespace {

constexpr std::size_t kJudged = 4;  // of a place, best ones that are judged in full; for time

// The best hypothesis of each other part near an object, best first.
std::vector<AspectSceneObject> Competing(const AspectLinkInput& input,
                                         const AspectLinkOptions& options,
                                         const ViewLinks& links,
                                         const LinkedScene& scene,
                                         const LinkedObject& o) {
  const auto mesh_of = [&](int object) -> const RenderMesh& {
    return input.models[object].object->mesh;
  };
  const auto is_accepted = [&](int object, const Eigen::Vector3d& center) {
    return std::any_of(scene.objects.begin(), scene.objects.end(), [&](const LinkedObject& other) {
      const RenderMesh& mesh = mesh_of(other.object);
      return other.object == object &&
             (other.scene_from_object * mesh.center.cast<double>() - center).norm() <
                 options.apart_share * mesh.diameter_m;
    });
  };
  const Eigen::Vector3d center = o.scene_from_object * mesh_of(o.object).center.cast<double>();
  std::vector<double> best(input.models.size(), 0.0);
  std::vector<AspectSceneObject> candidates(input.models.size());
  for (std::size_t v = 0; v < scene.views.size(); ++v) {
    if (!scene.views[v]) continue;
    const Rigid3 scene_from_camera = scene.views[v]->camera_from_scene.Inverse();
    for (const AspectHypothesis& h : links.Hypotheses(static_cast<int>(v))) {
      if (h.object == o.object || h.score <= best[h.object]) continue;
      const Rigid3 placed =
          scene_from_camera *
          WithFocal(h.camera_from_object, h.camera.focal_px, scene.views[v]->camera.focal_px);
      const Eigen::Vector3d there = placed * mesh_of(h.object).center.cast<double>();
      const double size = std::min(mesh_of(h.object).diameter_m, mesh_of(o.object).diameter_m);
      if ((there - center).norm() > size || is_accepted(h.object, there)) continue;
      best[h.object] = h.score;
      candidates[h.object] = {h.object, placed};
    }
  }
  std::vector<int> order(best.size());
  std::iota(order.begin(), order.end(), 0);
  std::stable_sort(order.begin(), order.end(), [&](int a, int b) { return best[a] > best[b]; });
  std::vector<AspectSceneObject> out;
  for (const int k : order) {
    if (out.size() >= kJudged || best[k] <= 0.0) break;
    out.push_back(candidates[k]);
  }
  return out;
}

}  // namespace

void FindBestCompeting(const AspectLinkInput& input,
                       const AspectLinkOptions& options,
                       const ViewLinks& links,
                       const SceneObjects& objects,
                       LinkedScene* scene) {
  if (!options.competing_parts) return;
  for (LinkedObject& o : scene->objects) {
    const std::vector<AspectSceneObject> candidates = Competing(input, options, links, *scene, o);
    std::vector<double> scores(candidates.size(), 0.0);
    ParallelFor(static_cast<int>(candidates.size()), options.threads, [&](int i) {
      auto settled = objects.Settled(scene->views, candidates[i]);
      if (settled)
        scores[i] = objects.JudgeOne(scene->views, settled->placed, {}, settled->rendered).score;
    });
    const auto most = std::max_element(scores.begin(), scores.end());
    if (most == scores.end() || *most <= 0.0) continue;
    o.competing_score = *most;
    o.competing_object = candidates[most - scores.begin()].object;
  }
}

}  // namespace horopter
