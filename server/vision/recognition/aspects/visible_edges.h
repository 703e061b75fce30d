// The edges of a part as a camera sees them at one pose and scale: occluding contours, creases and
// rims, from a software rendering of its mesh to depth and faces. Choi & Christensen 2012; Petit,
// Marchand, Kanani 2013: edges from depth and normal buffers. Contour points lie where the mesh's
// contour edges cross the lines between pixel centres, so they are exact, not rounded to pixels.
#pragma once

#include <Eigen/Core>
#include <cstdint>
#include <vector>

#include "server/vision/geometry/pinhole_camera.h"
#include "server/vision/geometry/rigid3.h"
#include "server/vision/recognition/aspects/render_mesh.h"
#include "server/vision/recognition/aspects/rendered_view.h"
#include "server/vision/recognition/aspects/screen_edges.h"

namespace horopter {

// A point of a visible edge, about one per rendered pixel of edge length.
struct VisibleEdgePoint {
  Eigen::Vector3f point = Eigen::Vector3f::Zero();  // object frame, metres, on the near surface
  Eigen::Vector3f direction = Eigen::Vector3f::UnitX();  // unit, of the edge, object frame
  Eigen::Vector2f image = Eigen::Vector2f::Zero();  // pixels of the given camera, with its lens
  // Unit, of the edge in the image, along the chain. Of contours the near surface lies on the side
  // (-tangent.y, tangent.x) (image y down), the farther one or the background on the other.
  Eigen::Vector2f tangent = Eigen::Vector2f::UnitX();
  VisibleEdgeKind kind = VisibleEdgeKind::kSilhouette;
  float turn_rad = 0.0f;   // creases: by how much the normal turns across the edge
  std::int32_t chain = 0;  // points of one chain are consecutive and ordered along it
};

struct VisibleEdgeOptions {
  // Size of the object's diameter in the rendering. Raising it shows finer edges and costs its
  // square.
  double render_px = 180.0;
  // Rendered pixels per image pixel are at most this many: an edge finer than the image is none.
  double max_scale = 1.0;
  // A step in depth larger than this many pixel footprints, which neither side's tangent plane
  // explains, occludes.
  double occlusion_jump_px = 3.5;
  bool creases = true;
};

struct VisibleEdges {
  std::vector<VisibleEdgePoint> points;
  int chains = 0;
  RenderedView view;
};

// Edges at the border of the image are none, and points outside it are left out. Empty if nothing
// of the object is in front of the camera and inside the image. Deterministic.
VisibleEdges FindVisibleEdges(const RenderMesh& mesh,
                              const PinholeCamera& camera,
                              const Rigid3& camera_from_object,
                              const VisibleEdgeOptions& options = {});

// The rendering alone.
RenderedView RenderView(const RenderMesh& mesh,
                        const PinholeCamera& camera,
                        const Rigid3& camera_from_object,
                        const VisibleEdgeOptions& options = {});

}  // namespace horopter
