// What points of texture say of parts that are placed under the same cameras: the planes that they
// may lie on, and what is matched between images where a part's faces would be and lies behind
// them, so that it is seen through the part. Edges alone do not tell such a place, as the ground's
// own edges may lie on the part's.
#pragma once

#include <optional>
#include <span>
#include <vector>

#include "server/vision/geometry/supporting_plane.h"
#include "server/vision/recognition/aspect_scenes/aspect_adjustment.h"
#include "server/vision/recognition/aspect_search/aspect_score.h"
#include "server/vision/recognition/aspects/aspect_image.h"
#include "server/vision/reconstruction/reconstruction.h"

namespace horopter {

// Points that one image at least shows well inside the part's outline.
struct TextureOnPart {
  int on_faces = 0;  // where the other images show them too
  int behind = 0;    // which the other images show only farther away

  // Whether more than chance is seen through the part. Few wrong matches and gloss, which mirrors
  // what is elsewhere, are no contradiction.
  bool Contradicts() const;
};

// layers: of the part in each view, empty where it is not registered. points: their `pixels` alone
// are read, of the original images.
TextureOnPart CompareTexture(std::span<const AspectImage> images,
                             const std::vector<std::optional<AspectSceneView>>& views,
                             std::span<const ObjectLayer> layers,
                             std::span<const ReconstructedPoint> points);

// The plane of the points that lie on the reconstruction's (`on_plane`), and these, as the views
// show them. Nothing where fewer than 20 points are on it, or where it is above a camera.
struct TexturePlane {
  SupportingPlane plane;
  std::vector<Eigen::Vector3d> points;
};
std::optional<TexturePlane> FirstPlaneOfTexture(
    const std::vector<std::optional<AspectSceneView>>& views,
    std::span<const ReconstructedPoint> points);

// Whether the part reaches a tenth of its diameter below the plane though points on it surround the
// part: what lies on a table is not in it.
bool IsUnderTexture(const TexturePlane& texture,
                    const RenderMesh& mesh,
                    const Rigid3& scene_from_object);

// Planes that things may lie on, as these views show them: FirstPlaneOfTexture, then others of many
// points from which nothing would slide, as boards, boxes and shelves have them; none without the
// first.
std::vector<SupportingPlane> PlanesOfTexture(
    const std::vector<std::optional<AspectSceneView>>& views,
    std::span<const ReconstructedPoint> points);

}  // namespace horopter
