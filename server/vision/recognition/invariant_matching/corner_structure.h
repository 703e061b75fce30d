// Corners in space as a structure that the metric route reads: cameras known up to a similarity.
#pragma once

#include <span>

#include "absl/status/statusor.h"
#include "server/vision/recognition/invariant_matching/scene_structure.h"
#include "server/vision/recognition/invariant_matching/space_corners.h"

namespace horopter {

struct CornerStructureOptions {
  // Deviation of a junction that is allowed for: its own, but not less than this. The cameras'
  // errors are in it, which nearby points share.
  double sigma_px = 1.0;
  double max_line_px = 2.5;  // of a segment's end from its edge; a view's segment may be another's
  // An edge joins two corners that end the same segments in two views, or whose edges point at each
  // other within this angle.
  double direction_rad = 0.06;
};

struct CornerStructure {
  SceneStructure structure;                                            // metric
  Eigen::Matrix4d structure_from_scene = Eigen::Matrix4d::Identity();  // a similarity
};

// corners: of FindSpaceCorners on the same views; views of the structure are theirs. The cameras
// are fixed: the covariance is block-diagonal. Errors: FAILED_PRECONDITION (fewer than five
// corners), INVALID_ARGUMENT (more than kMaxStructurePoints).
absl::StatusOr<CornerStructure> StructureOfCorners(std::span<const FeatureView> views,
                                                   std::span<const SpaceCorner> corners,
                                                   const CornerStructureOptions& options = {});

}  // namespace horopter
