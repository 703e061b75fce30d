#include "server/vision/recognition/aspects/scene_judgement.h"

#include <algorithm>

#include "server/base/parallel_for.h"

namespace horopter {
namespace {

using ViewSpan = std::span<const std::vector<PartLayer>* const>;

// Working pixels about the image of a part, for the layers that may overlap it.
struct Disc {
  Eigen::Vector2d center = Eigen::Vector2d::Zero();
  double radius = 0.0;

  bool Meets(const PartLayer& layer) const {
    return layer.width > 0 && center.x() + radius > layer.x0 && center.y() + radius > layer.y0 &&
           center.x() - radius < layer.x0 + layer.width &&
           center.y() - radius < layer.y0 + layer.height;
  }
};

Disc DiscOf(const AspectImage& image,
            const RenderMesh& mesh,
            const PinholeCamera& camera,
            const Rigid3& pose) {
  constexpr double kAround = 0.6;  // of the diameter, with a margin
  const PinholeCamera working = WorkingCamera(image, camera);
  const Eigen::Vector3d center = pose * mesh.center.cast<double>();
  return {Project(working, center), kAround * working.focal_px * mesh.diameter_m / center.z()};
}

bool IsInside(const RenderMesh& mesh,
              const PinholeCamera& camera,
              const Rigid3& pose,
              double shown_share) {
  int inside = 0;
  for (const Eigen::Vector3d& corner : BoxCorners(mesh)) {
    const Eigen::Vector3d x = pose * corner;
    if (x.z() <= 0) continue;
    const Eigen::Vector2d u = Project(camera, x);
    inside += u.x() >= 0 && u.y() >= 0 && u.x() < camera.width && u.y() < camera.height;
  }
  return inside >= 8 * shown_share;
}

}  // namespace

std::array<Eigen::Vector3d, 8> BoxCorners(const RenderMesh& mesh) {
  const double h = 0.29 * mesh.diameter_m;
  std::array<Eigen::Vector3d, 8> out;
  for (int i = 0; i < 8; ++i) {
    out[i] = mesh.center.cast<double>() +
             h * Eigen::Vector3d(i & 1 ? 1 : -1, i & 2 ? 1 : -1, i & 4 ? 1 : -1);
  }
  return out;
}

LinkedObject JudgeInViews(std::span<const AspectImage> images,
                          const RenderMesh& mesh,
                          const std::vector<std::optional<AspectSceneView>>& views,
                          const AspectSceneObject& placed,
                          const SceneJudgementOptions& options,
                          ViewSpan others) {
  LinkedObject out;
  out.object = placed.object;
  out.scene_from_object = placed.scene_from_object;
  out.views.resize(views.size());
  out.shown.assign(views.size(), false);
  AspectScoreOptions scoring;
  scoring.render_px = options.render_px;
  int registered = 0, shown = 0;
  for (std::size_t v = 0; v < views.size(); ++v) {
    if (!views[v]) continue;
    ++registered;
    const Rigid3 pose = views[v]->camera_from_scene * placed.scene_from_object;
    if (!IsInside(mesh, views[v]->camera, pose, options.shown_share)) continue;
    std::vector<const PartLayer*> near;
    if (!others.empty()) {
      const Disc disc = DiscOf(images[v], mesh, views[v]->camera, pose);
      for (const std::vector<PartLayer>* layers : others) {
        if (disc.Meets((*layers)[v])) near.push_back(&(*layers)[v]);
      }
    }
    const AspectScore score = ScorePose(images[v], mesh, views[v]->camera, pose, scoring, near);
    if (score.visible_px < options.visible_share * (score.visible_px + score.hidden_px)) continue;
    out.views[v] = score;
    out.shown[v] = true;
    ++shown;
    out.score += score.score;
    out.precision += score.precision;
  }
  // Wrong cameras push objects out of the images that contradict them.
  if (shown == 0 || 2 * shown < registered) {
    out.score = out.precision = 0.0;
    return out;
  }
  out.score /= shown;
  out.precision /= shown;
  return out;
}

SceneLayers MakeSceneLayers(std::span<const AspectImage> images,
                            std::span<const RenderMesh* const> meshes,
                            const AspectScene& scene,
                            std::span<const LinkedObject> judged,
                            const SceneJudgementOptions& options) {
  SceneLayers out(scene.objects.size());
  AspectScoreOptions scoring;
  scoring.render_px = options.layer_px;
  ParallelFor(static_cast<int>(out.size()), options.threads, [&](int o) {
    out[o].resize(scene.views.size());
    if (judged[o].score < options.hiding_score) return;
    const AspectSceneObject& object = scene.objects[o];
    for (std::size_t v = 0; v < scene.views.size(); ++v) {
      if (!scene.views[v]) continue;
      out[o][v] = MakePartLayer(images[v],
                                *meshes[object.object],
                                scene.views[v]->camera,
                                scene.views[v]->camera_from_scene * object.scene_from_object,
                                scoring);
    }
  });
  return out;
}

std::vector<LinkedObject> JudgeScene(std::span<const AspectImage> images,
                                     std::span<const RenderMesh* const> meshes,
                                     const AspectScene& scene,
                                     const SceneJudgementOptions& options) {
  const int count = static_cast<int>(scene.objects.size());
  const auto judge = [&](int i, ViewSpan others) {
    const AspectSceneObject& o = scene.objects[i];
    return JudgeInViews(images, *meshes[o.object], scene.views, o, options, others);
  };
  std::vector<LinkedObject> alone(count);
  ParallelFor(count, options.threads, [&](int i) { alone[i] = judge(i, {}); });
  if (count < 2) return alone;
  const SceneLayers layers = MakeSceneLayers(images, meshes, scene, alone, options);
  std::vector<LinkedObject> out(count);
  ParallelFor(count, options.threads, [&](int i) {
    const AspectSceneObject& object = scene.objects[i];
    std::vector<const std::vector<PartLayer>*> better;
    for (int o = 0; o < count; ++o) {
      if (alone[o].score <= alone[i].score || alone[o].score < options.hiding_score) continue;
      bool meets = false;
      for (std::size_t v = 0; v < scene.views.size() && !meets; ++v) {
        if (!scene.views[v]) continue;
        const Rigid3 pose = scene.views[v]->camera_from_scene * object.scene_from_object;
        meets = DiscOf(images[v], *meshes[object.object], scene.views[v]->camera, pose)
                    .Meets(layers[o][v]);
      }
      if (meets) better.push_back(&layers[o]);
    }
    out[i] = better.empty() ? alone[i] : judge(i, better);
  });
  return out;
}

}  // namespace horopter
