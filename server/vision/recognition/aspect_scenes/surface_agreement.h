// Whether the views agree on how bright the surface of a placed part is, and on the texture of the
// plane it lies on: the same place of a still scene is as bright in every view, but for exposure
// and gloss. Edges say where a part's outline is; this says which of its faces is seen, and whether
// the cameras that it gave hold for what is around it.
#pragma once

#include <optional>
#include <span>
#include <vector>

#include "server/vision/geometry/supporting_plane.h"
#include "server/vision/recognition/aspect_scenes/aspect_adjustment.h"
#include "server/vision/recognition/aspect_search/aspect_score.h"
#include "server/vision/recognition/aspects/aspect_image.h"
#include "server/vision/recognition/aspects/fragment_index.h"

namespace horopter {

// Correlations of brightness, -1 .. 1, between pairs of views.
struct Correlations {
  std::vector<std::optional<double>> views;  // mean with the others; nothing: they say nothing
  double mean = 0.0;                         // of all pairs
  int pairs = 0;                             // ordered; that show enough of a surface with contrast
};

// A part in an image; what is pointed to outlives it.
struct SeenObject {
  const AspectImage* image = nullptr;
  PinholeCamera camera;
  Rigid3 camera_from_scene;
  const ObjectLayer* layer = nullptr;  // the part, from there
};

// Of two views, mean of both ways: over the part's surface, and over the texture of a plane around
// it (scene frame). Nothing where they say nothing. Looks at some 2000 places of each view.
std::optional<double> SurfaceCorrelation(const SeenObject& a, const SeenObject& b);
std::optional<double> PlaneCorrelation(const SeenObject& a,
                                       const SeenObject& b,
                                       const SupportingPlane& plane);

// Over the part's surface. `layers`: the part in each view, empty where not registered.
Correlations SurfaceCorrelations(std::span<const AspectImage> images,
                                 const std::vector<std::optional<AspectSceneView>>& views,
                                 std::span<const ObjectLayer> layers);

// Of the texture, AspectImage::detail, of a plane around the part.
Correlations PlaneCorrelations(std::span<const AspectImage> images,
                               const std::vector<std::optional<AspectSceneView>>& views,
                               std::span<const ObjectLayer> layers,
                               const SupportingPlane& plane);

// Of the best part of a scene.
struct ViewAgreement {
  Correlations surface;  // of the part
  // Least over the views of the correlation over the plane under the resting face that has the
  // highest; 0 where not every registered view has one.
  double ground = 0.0;
  // How textured the image is around the part: deviation of AspectImage::detail, grey levels, least
  // of the registered views. 0 for a surface of revolution, whose turns no edge tells.
  double texture = 0.0;

  bool Contradicts(double least) const { return surface.pairs > 0 && surface.mean < least; }
  // Whether a view shows another surface than most do: its camera is wrong.
  bool IsOdd(int view) const;
};

// The part in each registered view. render_px: see PoseEdgeOptions.
std::vector<ObjectLayer> LayersInViews(std::span<const AspectImage> images,
                                       const std::vector<std::optional<AspectSceneView>>& views,
                                       const RenderMesh& mesh,
                                       const Rigid3& scene_from_object,
                                       double render_px);

// Takes from a part's layer what a nearer part of the same view hides.
void HideBehind(const ObjectLayer& nearer, ObjectLayer* layer);

// ViewAgreement::texture.
double TextureAround(std::span<const AspectImage> images,
                     const std::vector<std::optional<AspectSceneView>>& views,
                     std::span<const ObjectLayer> layers);

// ViewAgreement::ground; planes above a camera are none.
double GroundAgreement(std::span<const AspectImage> images,
                       const std::vector<std::optional<AspectSceneView>>& views,
                       std::span<const ObjectLayer> layers,
                       std::span<const RestingFace> resting,
                       const Rigid3& scene_from_object);

}  // namespace horopter
