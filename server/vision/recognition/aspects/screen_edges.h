// Edges in a rendering, before they are put into the image and the object's frame.
#pragma once

#include <cstdint>
#include <vector>

#include "server/vision/recognition/aspects/rendered_view.h"

namespace horopter {

// What makes an edge visible. Contours (silhouette and self-occlusion) show in any light; creases
// depend on it.
enum class VisibleEdgeKind : std::uint8_t { kSilhouette = 0, kOcclusion = 1, kCrease = 2 };

struct ScreenEdgePoint {
  float u = 0.0f;  // rendered pixels
  float v = 0.0f;
  float inverse_depth = 0.0f;  // of the near surface, 1 / m
  float turn_rad = 0.0f;       // creases: of the normal
  VisibleEdgeKind kind = VisibleEdgeKind::kSilhouette;
  bool exact = false;  // lies on an edge of the mesh; otherwise placed to a fraction of a pixel
};

// Chains one after the other.
struct ScreenEdges {
  std::vector<ScreenEdgePoint> points;
  std::vector<std::int32_t> ends;  // of each chain, one past its last point
};

// Where neighbouring pixels do not belong to one surface: bit d of a pixel is set if its neighbour
// in direction d is farther away or background. Directions: 0 = +x, 1 = +y, 2 = -x, 3 = -y.
struct DepthSteps {
  int width = 0;
  std::vector<std::uint8_t> farther;

  bool Between(int pixel, int right_or_below) const {
    return right_or_below == pixel + 1
               ? (farther[pixel] & 1) != 0 || (farther[right_or_below] & 4) != 0
               : (farther[pixel] & 2) != 0 || (farther[right_or_below] & 8) != 0;
  }
};

// A step larger than `jump_px` footprints of a pixel that neither tangent plane explains.
DepthSteps FindDepthSteps(const Rendering& rendering, const RenderMesh& mesh, double jump_px);

// Chains along those steps, the near surface on the side (-tangent.y, tangent.x), each point where
// an edge of the mesh that turns its surface away crosses the line between two pixels' centres. A
// chain stays on one surface: it ends where a nearer one hides it.
ScreenEdges OccludingContours(const Rendering& rendering,
                              const RenderMesh& mesh,
                              const DepthSteps& steps);

struct CreaseOptions {
  double turn_rad = 0.436;  // within four pixels; chains go on through 70 % of it
};

// Ridges of the turning of the normals, where it turns fastest.
ScreenEdges Creases(const Rendering& rendering,
                    const RenderMesh& mesh,
                    const DepthSteps& steps,
                    const CreaseOptions& options);

}  // namespace horopter
