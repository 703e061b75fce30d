// Gauss-Newton on the distances between projected model edges and image edges.
#pragma once

#include <Eigen/Core>
#include <optional>
#include <span>
#include <vector>

#include "server/vision/geometry/calibrated_camera.h"
#include "server/vision/recognition/object/prepared_object.h"
#include "server/vision/recognition/scoring/view_evidence.h"
#include "server/vision/recognition/search_options.h"

namespace horopter {

// One associated sample: residual = normal . (projection - edge point) in working pixels, g = d
// residual / d point in the camera frame, weight from Tukey's function.
struct EdgeResidual {
  Eigen::Vector3d point_in_camera;
  Eigen::Vector3d g;
  double residual = 0.0;
  double d_log_focal = 0.0;
  double weight = 0.0;
};

// Associates the visible samples (nearest aspect) of a pose with the nearest like-oriented image
// edge points within `reach_px` working pixels.
std::vector<EdgeResidual> AssociateEdges(const PreparedObject& object,
                                         const EdgeMaps& maps,
                                         const PinholeCamera& camera,
                                         const Rigid3& camera_from_object,
                                         double reach_px);

struct RefinedPose {
  PinholeCamera camera;
  Rigid3 camera_from_object;
  double rms_px = 0.0;  // of the associated samples, working pixels
  int associated = 0;
};

// Refines one object's pose (and the focal length) in one view. Empty when fewer than 8 samples
// find an edge or the pose leaves the image.
std::optional<RefinedPose> RefineInView(const PreparedObject& object,
                                        const EdgeMaps& maps,
                                        const PinholeCamera& camera,
                                        const Rigid3& camera_from_object,
                                        const RefineOptions& options);

// The views an object is refined in together, cameras fixed.
struct KnownView : CalibratedCamera {
  const EdgeMaps* maps = nullptr;
};

// Refines one object's pose against all views with known cameras.
std::optional<Rigid3> RefineInScene(const PreparedObject& object,
                                    std::span<const KnownView> views,
                                    const Rigid3& scene_from_object,
                                    const RefineOptions& options);

}  // namespace horopter
