// What the images say of objects that are placed in a scene: each by the edges its cameras should
// see, as far as no other object hides them, and the image's edges that no other object explains.
#pragma once

#include <array>
#include <optional>
#include <span>
#include <vector>

#include "server/vision/recognition/aspect_scenes/aspect_adjustment.h"
#include "server/vision/recognition/aspect_search/aspect_score.h"
#include "server/vision/recognition/aspect_search/pose_rendering.h"
#include "server/vision/recognition/aspects/aspect_image.h"
#include "server/vision/recognition/aspects/render_mesh.h"

namespace horopter {

// A diameter, of scores while a scene grows and of what hides others
inline constexpr double kQuickRenderPx = 110.0;

struct LinkedObject {
  int object = -1;  // index of the parts
  Rigid3 scene_from_object;
  std::vector<AspectScore> views;  // score 0 and visible_px 0 where not shown or not registered
  std::vector<bool> shown;
  double score = 0.0;            // mean of the shown views' scores
  double precision = 0.0;        // ... of their precisions
  double competing_score = 0.0;  // of the best competing placement of another part, and which
  int competing_object = -1;
  // Whether it lies on a plane beside or on others (scene_objects.h): its pose was not told to.
  bool lies = false;
  // Whether none of its resting faces is even level with such a plane; and whether one is, to the
  // same degree, at whatever height above the lowest: what it stands on is no part.
  bool leans = false;
  bool level = false;
  // Mean correlation of its surface's brightness between the views, less what better objects hide,
  // and of how many ordered pairs of views (surface_agreement.h); 0 of 0 where not asked for.
  double surface = 0.0;
  int surface_pairs = 0;
};

// Recall that a part whose edges are found well is given until three views tell what is print on
// it: enough to let one of 250 px of edges grow. 0.55 left those of less than 400 px out (two of
// 16 scenes of printed boxes, see "Printed boxes" in tests/bench/history/photographs.md).
inline constexpr double kPresumedRecall = 0.7;

struct SceneJudgementOptions {
  double render_px = 200.0;    // a diameter, of the scores
  AspectScoreOptions scoring;  // but for its render_px
  // A part whose edges are found so well, in three views or more, may be printed on where so little
  // of the images' edges within it are its own.
  double print_precision = kPrintPrecision;
  // ... or where print is this share of what is seen on its surface and not its own: what else
  // speaks against it lies beside it, before a ground that has edges, too.
  double print_share = 0.8;
  // Two views cannot tell print from what speaks against a part. While a scene grows, one whose
  // edges are found so well is given this recall; 0: it is not.
  double presumed_recall = 0.0;
  int threads = 1;
};

// Corners of a cube of the diameter's size about a part's centre: what turns and scale are seen by.
std::array<Eigen::Vector3d, 8> BoxCorners(const RenderMesh& mesh);

// The objects of a scene as its views show them, [object][view]; empty where not registered.
using SceneLayers = std::vector<std::vector<ObjectLayer>>;

// An object in all registered views; `others`: what hides it, [object][view], or empty. A view that
// shows little of the object does not count; an object that few views show scores nothing.
// `rendered`: its renderings of each view's working image on its way here, or empty.
LinkedObject JudgeInViews(std::span<const AspectImage> images,
                          const RenderMesh& mesh,
                          const std::vector<std::optional<AspectSceneView>>& views,
                          const AspectSceneObject& placed,
                          const SceneJudgementOptions& options = {},
                          std::span<const std::vector<ObjectLayer>* const> others = {},
                          std::span<PoseRendering> rendered = {});

// Layers of the objects whose scores (one each) reach kHidingScore.
SceneLayers MakeSceneLayers(std::span<const AspectImage> images,
                            std::span<const RenderMesh* const> meshes,
                            const AspectScene& scene,
                            std::span<const LinkedObject> judged,
                            const SceneJudgementOptions& options = {});

// Each object by itself first, then with what better ones hide and explain; in the scene's order.
// An object in the place of a better one scores 0.
std::vector<LinkedObject> JudgeScene(std::span<const AspectImage> images,
                                     std::span<const RenderMesh* const> meshes,
                                     const AspectScene& scene,
                                     const SceneJudgementOptions& options = {});

}  // namespace horopter
