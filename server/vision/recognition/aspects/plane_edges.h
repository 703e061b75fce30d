// Edges of a textured ground told by how they move: from view to view they go where the supporting
// plane's homographies take them, and what stands on it does not.
#pragma once

#include <Eigen/Core>
#include <cstdint>
#include <span>
#include <vector>

#include "server/vision/recognition/aspects/aspect_image.h"

namespace horopter {

struct PlaneEdgeOptions {
  double tolerance_px = 1.4;  // working px: a homography and an edge are so exact
  // Of the views that a homography takes an edge into, in so many it must be met; of three and more
  // one may hide it.
  int min_views = 2;
  int may_miss = 1;
  // A ground that covers this share of the image (in blocks) with edges, and has no more room
  // between them: the radius of discs that touch an edge, px, in the middle of all.
  double min_coverage = 0.3;
  double max_room_px = 12.0;
  // An edge beside which there is so many times the usual room is the outline of what lies flat on
  // the ground.
  double outline_room = 3.0;
  double least_room_px = 5.0;
};

// A view whose ground is linked to that of the view asked for.
struct GroundView {
  const AspectImage* image = nullptr;                             // with its edges and maps
  Eigen::Matrix3d there_from_here = Eigen::Matrix3d::Identity();  // working px of both
};

// For each edge of `here` whether it is of the ground's texture; empty where the ground has none
// that is dense.
std::vector<std::uint8_t> FindPlaneEdges(const AspectImage& here,
                                         std::span<const GroundView> others,
                                         const PlaneEdgeOptions& options = {});

}  // namespace horopter
