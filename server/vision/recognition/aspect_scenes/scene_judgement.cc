#include "server/vision/recognition/aspect_scenes/scene_judgement.h"

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <utility>

#include "server/base/parallel_for.h"
#include "server/vision/recognition/aspects/quantile.h"

namespace horopter {
namespace {

constexpr double kShownShare =
    0.35;  // of a part's box inside the image for a view to count; ADR 53
constexpr double kVisibleShare = 0.3;  // of its edges that others leave to see
constexpr double kHidingScore = 0.42;  // of objects that are believed to hide others
// Of a better part's surface, a part must not have more than this share as its own.
constexpr double kMaxShared = 0.25;
constexpr double kOneSurfaceShare = 0.02;  // of the smaller diameter: surfaces nearer are one
// Of a part that may be printed on; it is when print explains its edges up to this share.
constexpr double kPrintRecall = 0.6;
// Of print in cameras that are not adjusted yet, and the recall that is presumed there: a right
// pose of a box printed all over had .35 - .73, and .88 in the end. With 0.35 and kPresumedRecall
// views with wrong cameras stayed in the scene of another one.
constexpr double kGrowingPrint = 0.5;
constexpr double kGrowingRecall = 0.5;
constexpr int kPrintViews = 3;  // that tell print from what stands before or behind a part

using ViewSpan = std::span<const std::vector<ObjectLayer>* const>;

// Working pixels about the image of a part, for the layers that may overlap it.
struct Disc {
  Eigen::Vector2d center = Eigen::Vector2d::Zero();
  double radius = 0.0;

  bool Meets(const ObjectLayer& layer) const {
    return layer.width > 0 && center.x() + radius > layer.x0 && center.y() + radius > layer.y0 &&
           center.x() - radius < layer.x0 + layer.width &&
           center.y() - radius < layer.y0 + layer.height;
  }
};

Disc DiscOf(const AspectImage& image,
            const RenderMesh& mesh,
            const PinholeCamera& camera,
            const Rigid3& pose) {
  constexpr double kWithMargin = 0.6;  // of the diameter, with a margin
  const PinholeCamera working = WorkingCamera(image, camera);
  const Eigen::Vector3d center = pose * mesh.center.cast<double>();
  return {Project(working, center), kWithMargin * working.focal_px * mesh.diameter_m / center.z()};
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

// Of the smaller image of two parts, the share where both have one surface; over all views.
double SharedSurface(std::span<const ObjectLayer> a,
                     std::span<const ObjectLayer> b,
                     double tolerance_m) {
  std::int64_t of_a = 0, of_b = 0, shared = 0;
  for (std::size_t v = 0; v < a.size(); ++v) {
    of_b += std::count_if(
        b[v].inverse_depth.begin(), b[v].inverse_depth.end(), [](float d) { return d > 0; });
    for (int y = a[v].y0; y < a[v].y0 + a[v].height; ++y) {
      for (int x = a[v].x0; x < a[v].x0 + a[v].width; ++x) {
        const float near = a[v].inverse_depth[a[v].Cell(x, y)];
        if (near <= 0) continue;
        ++of_a;
        if (!b[v].Has(x, y)) continue;
        const float other = b[v].inverse_depth[b[v].Cell(x, y)];
        shared += other > 0 && std::abs(1.0 / near - 1.0 / other) < tolerance_m;
      }
    }
  }
  const std::int64_t smaller = std::min(of_a, of_b);
  return smaller > 0 ? static_cast<double>(shared) / static_cast<double>(smaller) : 0.0;
}

AspectScore Mean(const LinkedObject& o, int shown) {
  AspectScore mean;
  for (const AspectScore& score : o.views) {
    mean.precision += score.precision / shown;
    mean.recall += score.recall / shown;
  }
  return mean;
}

// Of the views that show it: one with a poor camera does not decide.
double Middle(const LinkedObject& o, double AspectScore::*value) {
  std::vector<double> values;
  for (std::size_t v = 0; v < o.views.size(); ++v) {
    if (o.shown[v]) values.push_back(o.views[v].*value);
  }
  return Median(&values);
}

// Edges of the model are found, but the images have many more within it.
bool MayBePrinted(const LinkedObject& o, int shown, const SceneJudgementOptions& options) {
  if (shown == 0) return false;
  const AspectScore mean = Mean(o, shown);
  return mean.precision >= options.print_precision && mean.recall < kPrintRecall;
}

void PresumeRecall(double recall, AspectScore* score) {
  if (score->recall >= recall || !(score->precision > 0)) return;
  score->recall = recall;
  score->score = ScoreOf(score->precision, recall, score->support_px);
}

// The edges that the views of a scene show of an object, rendered once at each size asked for.
class ObjectEdges {
 public:
  ObjectEdges(std::span<const AspectImage> images,
              const RenderMesh& mesh,
              const std::vector<std::optional<AspectSceneView>>& views,
              const AspectSceneObject& placed,
              const SceneJudgementOptions& options,
              std::span<PoseRendering> rendered = {})
      : images_(images),
        mesh_(mesh),
        views_(views),
        placed_(placed),
        options_(options),
        rendered_(rendered),
        scored_(views.size()) {}

  const VisibleEdges& Scored(std::size_t v) {
    if (!rendered_.empty()) return rendered_[v].At(WorkingCamera(v), Pose(v));
    if (!scored_[v]) scored_[v] = Rendered(v, options_.render_px);
    return *scored_[v];
  }

  ObjectLayer Layer(std::size_t v) {
    const PinholeCamera& camera = views_[v]->camera;
    if (kQuickRenderPx == options_.render_px) return MakeObjectLayer(images_[v], Scored(v), camera);
    return MakeObjectLayer(images_[v], Rendered(v, kQuickRenderPx), camera);
  }

 private:
  PinholeCamera WorkingCamera(std::size_t v) const {
    return horopter::WorkingCamera(images_[v], views_[v]->camera);
  }
  Rigid3 Pose(std::size_t v) const {
    return views_[v]->camera_from_scene * placed_.scene_from_object;
  }
  VisibleEdges Rendered(std::size_t v, double render_px) const {
    return WorkingEdges(images_[v], mesh_, views_[v]->camera, Pose(v), render_px);
  }

  std::span<const AspectImage> images_;
  const RenderMesh& mesh_;
  const std::vector<std::optional<AspectSceneView>>& views_;
  const AspectSceneObject& placed_;
  const SceneJudgementOptions& options_;
  std::span<PoseRendering> rendered_;
  std::vector<std::optional<VisibleEdges>> scored_;
};

// Scores once more, without the edges that stay in their places on the surface from view to view.
void ForgivePrint(std::span<const AspectImage> images,
                  const RenderMesh& mesh,
                  const std::vector<std::optional<AspectSceneView>>& views,
                  const AspectSceneObject& placed,
                  const std::vector<std::vector<const ObjectLayer*>>& near,
                  const AspectScoreOptions& scoring,
                  ObjectEdges* edges,
                  LinkedObject* out) {
  std::vector<ObjectLayer> layers(views.size());
  for (std::size_t v = 0; v < views.size(); ++v) {
    if (out->shown[v]) layers[v] = edges->Layer(v);
  }
  for (std::size_t v = 0; v < views.size(); ++v) {
    if (!out->shown[v]) continue;
    std::vector<SiblingView> siblings;
    for (std::size_t w = 0; w < views.size(); ++w) {
      if (w == v || !out->shown[w]) continue;
      const Rigid3 pose = views[w]->camera_from_scene * placed.scene_from_object;
      siblings.push_back({&images[w], views[w]->camera, pose, &layers[w]});
    }
    const Rigid3 pose = views[v]->camera_from_scene * placed.scene_from_object;
    out->views[v] = ScoreEdges(
        images[v], mesh, edges->Scored(v), views[v]->camera, pose, scoring, near[v], siblings);
  }
}

// Whether an object scored by ForgivePrint is printed on.
bool PrintExplains(const SceneJudgementOptions& options, LinkedObject* printed) {
  const double recall = Middle(*printed, &AspectScore::recall);
  const double print = Middle(*printed, &AspectScore::print);
  // While the cameras are rough only some of the print stays in its places.
  const bool growing = options.presumed_recall > 0 && print >= kGrowingPrint;
  for (AspectScore& score : printed->views) {
    if (growing && score.precision >= options.print_precision && score.print >= kGrowingPrint)
      PresumeRecall(kGrowingRecall, &score);
  }
  return growing || recall >= kPrintRecall || print >= options.print_share;
}

LinkedObject Judged(std::span<const AspectImage> images,
                    const RenderMesh& mesh,
                    const std::vector<std::optional<AspectSceneView>>& views,
                    const AspectSceneObject& placed,
                    const SceneJudgementOptions& options,
                    ViewSpan others,
                    ObjectEdges* edges) {
  LinkedObject out;
  out.object = placed.object;
  out.scene_from_object = placed.scene_from_object;
  out.views.resize(views.size());
  out.shown.assign(views.size(), false);
  AspectScoreOptions scoring = options.scoring;
  scoring.render_px = options.render_px;
  std::vector<std::vector<const ObjectLayer*>> near(views.size());
  int registered = 0, shown = 0;
  for (std::size_t v = 0; v < views.size(); ++v) {
    if (!views[v]) continue;
    ++registered;
    const Rigid3 pose = views[v]->camera_from_scene * placed.scene_from_object;
    if (!IsInside(mesh, views[v]->camera, pose, kShownShare)) continue;
    if (!others.empty()) {
      const Disc disc = DiscOf(images[v], mesh, views[v]->camera, pose);
      for (const std::vector<ObjectLayer>* layers : others) {
        if (disc.Meets((*layers)[v])) near[v].push_back(&(*layers)[v]);
      }
    }
    const AspectScore score =
        ScoreEdges(images[v], mesh, edges->Scored(v), views[v]->camera, pose, scoring, near[v]);
    const double in_sight = score.visible_px + score.claimed_px;
    if (in_sight < kVisibleShare * (in_sight + score.hidden_px)) continue;
    out.views[v] = score;
    out.shown[v] = true;
    ++shown;
  }
  if (MayBePrinted(out, shown, options)) {
    if (shown < kPrintViews) {
      for (AspectScore& score : out.views) PresumeRecall(options.presumed_recall, &score);
    } else {
      LinkedObject printed = out;
      ForgivePrint(images, mesh, views, placed, near, scoring, edges, &printed);
      if (PrintExplains(options, &printed)) out = std::move(printed);
    }
  }
  // Wrong cameras push objects out of the images that contradict them, and one image says nothing
  // of two cameras.
  if (shown < std::min(2, registered) || 2 * shown < registered || shown == 0) return out;
  for (const AspectScore& score : out.views) {
    out.score += score.score;
    out.precision += score.precision;
  }
  out.score /= shown;
  out.precision /= shown;
  return out;
}

SceneLayers LayersOf(const AspectScene& scene,
                     std::span<const LinkedObject> judged,
                     const SceneJudgementOptions& options,
                     std::span<ObjectEdges> edges) {
  SceneLayers out(scene.objects.size());
  ParallelFor(static_cast<int>(out.size()), options.threads, [&](int o) {
    out[o].resize(scene.views.size());
    if (judged[o].score < kHidingScore) return;
    for (std::size_t v = 0; v < scene.views.size(); ++v) {
      if (scene.views[v]) out[o][v] = edges[o].Layer(v);
    }
  });
  return out;
}

std::vector<ObjectEdges> EdgesOf(std::span<const AspectImage> images,
                                 std::span<const RenderMesh* const> meshes,
                                 const AspectScene& scene,
                                 const SceneJudgementOptions& options) {
  std::vector<ObjectEdges> out;
  out.reserve(scene.objects.size());
  for (const AspectSceneObject& o : scene.objects)
    out.emplace_back(images, *meshes[o.object], scene.views, o, options);
  return out;
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
                          ViewSpan others,
                          std::span<PoseRendering> rendered) {
  ObjectEdges edges(images, mesh, views, placed, options, rendered);
  return Judged(images, mesh, views, placed, options, others, &edges);
}

SceneLayers MakeSceneLayers(std::span<const AspectImage> images,
                            std::span<const RenderMesh* const> meshes,
                            const AspectScene& scene,
                            std::span<const LinkedObject> judged,
                            const SceneJudgementOptions& options) {
  std::vector<ObjectEdges> edges = EdgesOf(images, meshes, scene, options);
  return LayersOf(scene, judged, options, edges);
}

std::vector<LinkedObject> JudgeScene(std::span<const AspectImage> images,
                                     std::span<const RenderMesh* const> meshes,
                                     const AspectScene& scene,
                                     const SceneJudgementOptions& options) {
  const int count = static_cast<int>(scene.objects.size());
  std::vector<ObjectEdges> edges = EdgesOf(images, meshes, scene, options);
  const auto judge = [&](int i, ViewSpan others) {
    const AspectSceneObject& o = scene.objects[i];
    return Judged(images, *meshes[o.object], scene.views, o, options, others, &edges[i]);
  };
  std::vector<LinkedObject> alone(count);
  ParallelFor(count, options.threads, [&](int i) { alone[i] = judge(i, {}); });
  if (count < 2) return alone;
  const SceneLayers layers = LayersOf(scene, alone, options, edges);
  std::vector<LinkedObject> out(count);
  ParallelFor(count, options.threads, [&](int i) {
    const AspectSceneObject& object = scene.objects[i];
    const double diameter = meshes[object.object]->diameter_m;
    std::vector<const std::vector<ObjectLayer>*> better;
    bool taken = false;
    for (int o = 0; o < count; ++o) {
      if (alone[o].score <= alone[i].score || alone[o].score < kHidingScore) continue;
      bool meets = false;
      for (std::size_t v = 0; v < scene.views.size() && !meets; ++v) {
        if (!scene.views[v]) continue;
        const Rigid3 pose = scene.views[v]->camera_from_scene * object.scene_from_object;
        meets = DiscOf(images[v], *meshes[object.object], scene.views[v]->camera, pose)
                    .Meets(layers[o][v]);
      }
      if (!meets) continue;
      better.push_back(&layers[o]);
      const double smaller = std::min(diameter, meshes[scene.objects[o].object]->diameter_m);
      taken |= SharedSurface(layers[i], layers[o], kOneSurfaceShare * smaller) > kMaxShared;
    }
    out[i] = better.empty() ? alone[i] : judge(i, better);
    // Its edges are those of the other part that stands there.
    if (taken) out[i].score = 0.0;
  });
  return out;
}

}  // namespace horopter
