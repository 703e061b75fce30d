// How well a pose of an object is supported by one image.
#pragma once

#include <Eigen/Core>
#include <cstdint>
#include <span>
#include <vector>

#include "server/vision/geometry/depth_buffer.h"
#include "server/vision/geometry/pinhole_camera.h"
#include "server/vision/geometry/rigid3.h"
#include "server/vision/recognition/object/prepared_object.h"
#include "server/vision/recognition/scoring/view_evidence.h"

namespace horopter {

// Mean support (0..1) of the samples visible in the nearest aspect: 1 on an edge of like
// orientation, falling linearly to 0 at `reach_px` working pixels. Gives up and returns the partial
// mean when the first sixteenth or quarter of the samples scores too far below `give_up`. Poses of
// which less than 60 % lies inside the image, or behind the camera, score 0.
float QuickScore(const PreparedObject& object,
                 const EdgeMaps& maps,
                 const PinholeCamera& camera,
                 const Rigid3& camera_from_object,
                 float reach_px,
                 float give_up);

// A pose in one of several views.
struct QuickView {
  const EdgeMaps* maps = nullptr;
  const PinholeCamera* camera = nullptr;
  Rigid3 camera_from_object;
};
// Mean of the views' quick scores; all views are asked a sixteenth of their samples first, then a
// quarter, then all, and the pose is given up (partial mean returned) as soon as the mean falls too
// far below `give_up`. 0 when a view has the pose behind the camera.
float QuickScoreOverViews(const PreparedObject& object,
                          std::span<const QuickView> views,
                          float reach_px,
                          float give_up);

// Edge support counted with hidden lines removed. Lengths in working pixels.
struct EdgeSupport {
  double visible = 0.0;    // length of the model edges visible in the image
  double supported = 0.0;  // ... that lie on an image edge of like direction
  double sharp = 0.0;      // ... so near that the pose must be right, not only similar
  double inside = 0.0;     // length of image segments inside the silhouette
  double explained = 0.0;  // ... that lie on a visible model edge
  double segments = 0.0;   // length of all image segments
  double all_explained = 0.0;
  double hidden_by_others = 0.0;  // length hidden by `occluders`

  EdgeSupport& operator+=(const EdgeSupport& o);
  double Sharpness() const { return supported > 0 ? sharp / supported : 0.0; }
  double Precision() const { return visible > 0 ? supported / visible : 0.0; }
  double RecallInside() const { return inside > 0 ? explained / inside : 0.0; }
  double RecallAll() const { return segments > 0 ? all_explained / segments : 0.0; }
};

// 2PR/(P+R) with R inside the silhouette, times n/(n+20) for n supported
// 4 px samples.
double SilhouetteF1(const EdgeSupport& support);
// The larger of SilhouetteF1 and what P alone is worth, 0.85 P^2: print on a part leaves edges
// inside its silhouette that the model does not have. True poses of printed boxes have P of 0.85
// and more in real photographs (R 0.3 - 0.6); edges shifted by 25 - 40 px find 0.05 - 0.25.
double ViewScore(const EdgeSupport& support);

// Reusable buffers of VerifyPose, one per thread. They cover the cells around the object only, from
// (x0, y0).
struct VerifyScratch {
  int x0 = 0;
  int y0 = 0;
  DepthBuffer depth;
  std::vector<std::uint8_t>
      model_mask;  // per cell: bit b = a visible model edge of orientation bin b is near
};

// Counts the support of a pose. `occluders`: depth of other accepted objects in this view at
// working resolution, or null. Marks in `explained_segments` (one byte per segment sample; may be
// null) what the pose explains.
EdgeSupport VerifyPose(const PreparedObject& object,
                       const ViewEvidence& view,
                       const PinholeCamera& camera,
                       const Rigid3& camera_from_object,
                       const DepthBuffer* occluders,
                       VerifyScratch* scratch,
                       std::vector<std::uint8_t>* explained_segments = nullptr);

// The camera of the working-resolution image.
PinholeCamera WorkingCamera(const PinholeCamera& camera, const EdgeMaps& maps);

// Largest displacement (working pixels) between the projections of two poses, over the bounding
// box's corners; a large number when a corner lies behind the camera.
double ProjectionDistance(const PreparedObject& object,
                          const PinholeCamera& camera_a,
                          const Rigid3& a,
                          const PinholeCamera& camera_b,
                          const Rigid3& b,
                          double working_from_image);

}  // namespace horopter
