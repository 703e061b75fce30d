// Poses of parts from single corners and circles in space: any attitude, cameras known and metric.
#pragma once

#include <span>
#include <vector>

#include "server/vision/recognition/candidates/space_circles.h"
#include "server/vision/recognition/candidates/space_corners.h"
#include "server/vision/recognition/candidates/standing_poses.h"
#include "server/vision/recognition/object/prepared_object.h"
#include "server/vision/recognition/scoring/pose_refine.h"

namespace horopter {

struct CornerSearchOptions {
  double angle_rad = 0.10;        // between the angles of two edges, seen and of the model
  double length_share = 0.06;     // an edge may look so much longer than it is, and
  double length_slack_m = 0.002;  // ... so much
  double min_length_share = 0.2;  // of the model edge that is seen at least
  bool one_complete = false;      // one of a corner's two edges is seen in its whole length
  double radius_log = 0.06;       // difference of a circle's radius from the model's
  int turns = 24;                 // about a circle's axis that are tried
  float quick_reach_px = 7.0f;    // working pixels
  float min_quick = 0.42f;        // mean over the views
  float near_best = 1.0f;         // poses that score so much less than the best are not kept
  SettleOptions settle{.settled = 12, .kept = 4};
};

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
