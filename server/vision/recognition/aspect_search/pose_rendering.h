// The visible edges of a part along a pose on its way: rendered again only when the pose has left
// the one they were rendered at.
#pragma once

#include "server/vision/geometry/pinhole_camera.h"
#include "server/vision/geometry/rigid3.h"
#include "server/vision/recognition/aspects/render_mesh.h"
#include "server/vision/recognition/aspects/visible_edges.h"

namespace horopter {

// Largest distance (pixels of the cameras) between the images of the corners of a cube about the
// part's centre under two poses; infinite when one is behind a camera.
double PoseShiftPx(const RenderMesh& mesh,
                   const PinholeCamera& camera_a,
                   const Rigid3& a,
                   const PinholeCamera& camera_b,
                   const Rigid3& b);

class PoseRendering {
 public:
  // `stale_px`: edges are rendered again when the pose has shifted by more (PoseShiftPx). While a
  // part of 200 px turns so far that its corners move by 3 px, a contour's point leaves the surface
  // by less than 0.05 px. `mesh` outlives the object.
  PoseRendering(const RenderMesh& mesh, const VisibleEdgeOptions& options, double stale_px);

  // The edges at this pose. Points of an older rendering are projected by the new pose, and its
  // window goes with the part; depths in it stay as they were rendered.
  const VisibleEdges& At(const PinholeCamera& camera, const Rigid3& camera_from_object);

 private:
  void Move(const PinholeCamera& camera, const Rigid3& camera_from_object);

  const RenderMesh& mesh_;
  VisibleEdgeOptions options_;
  double stale_px_;
  bool has_ = false;
  PinholeCamera rendered_camera_, camera_;  // rendered at, and of `edges_`
  Rigid3 rendered_pose_, pose_;
  VisibleEdges edges_;
};

}  // namespace horopter
