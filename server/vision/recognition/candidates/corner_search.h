// Poses of parts from single corners and circles in space: any attitude, cameras known and metric.
#pragma once

#include <span>
#include <vector>

#include "server/vision/recognition/candidates/space_circles.h"
#include "server/vision/recognition/candidates/space_corners.h"
#include "server/vision/recognition/candidates/standing_poses.h"
#include "server/vision/recognition/object/prepared_object.h"
#include "server/vision/recognition/scoring/pose_refine.h"
#include "server/vision/recognition/search_options.h"

namespace horopter {

// Rigid motion that takes a model corner to a corner in space: `vertex` to `point`, the bisector of
// the unit directions (u, v) to that of (p, q).
Rigid3 PoseFromCorner(const Eigen::Vector3d& vertex,
                      const Eigen::Vector3d& u,
                      const Eigen::Vector3d& v,
                      const Eigen::Vector3d& point,
                      const Eigen::Vector3d& p,
                      const Eigen::Vector3d& q);

// Poses of the object in the views' scene frame that bring a pair of its edges to a pair of a
// corner's and find edges in all views; best quick score first, not distinct.
std::vector<PooledPose> PosesFromCorners(const PreparedObject& object,
                                         std::span<const KnownView> views,
                                         std::span<const SpaceCorner> corners,
                                         const CornerSearchOptions& options);

// The same from circles: each of the model's circles of like radius is brought to it with its axis
// either way up, in `turns` turns about it.
std::vector<PooledPose> PosesFromCircles(const PreparedObject& object,
                                         std::span<const KnownView> views,
                                         std::span<const SpaceCircle> circles,
                                         const CornerSearchOptions& options);

}  // namespace horopter
