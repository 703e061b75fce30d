// The decomposition's last step: cameras and transforms together on the images.
#pragma once

#include <optional>
#include <span>
#include <vector>

#include "server/vision/recognition/initialization/decomposition.h"

namespace horopter {

// A straight edge of an object seen in an image: a piece of it, both ends on it.
struct ObjectEdgeObservation {
  int view = -1;
  int object = -1;
  Eigen::Vector3d start_in_object = Eigen::Vector3d::Zero();  // of the whole edge
  Eigen::Vector3d end_in_object = Eigen::Vector3d::Zero();
  Eigen::Vector2d start = Eigen::Vector2d::Zero();  // of the piece, pixels
  Eigen::Vector2d end = Eigen::Vector2d::Zero();
};

// Joint adjustment of cameras (focal length, principal point with prior) and transforms on the
// images: the refinement of RefineMetricScene, on points and edges that are matched already.
// sigma_px: of a point per coordinate, of an edge's ends across it.
struct JointAdjustment {
  std::vector<std::optional<MetricCamera>> cameras;
  std::vector<Rigid3> metric_from_object;
};
absl::StatusOr<JointAdjustment> AdjustJointly(std::span<const std::optional<CameraMatrix>> cameras,
                                              std::span<const Eigen::Vector2i> sizes,
                                              std::span<const ObjectPointObservation> points,
                                              std::span<const ObjectEdgeObservation> edges,
                                              const Decomposition& start,
                                              double sigma_px);

}  // namespace horopter
