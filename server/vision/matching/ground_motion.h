// How a textured ground moves from view to view.
#pragma once

#include <Eigen/Core>
#include <optional>
#include <span>
#include <vector>

#include "server/base/stop_token.h"
#include "server/vision/matching/matching.h"

namespace horopter {

// Homographies (pixels) from one frame of a plane into each view; nullopt: not linked.
using PlaneInViews = std::vector<std::optional<Eigen::Matrix3d>>;

// The views of the largest plane component that joins three views and more: two agree on much that
// is not there.
PlaneInViews LargestPlane(const MatchingResult& matching);

// The same from the images alone, without features, and of repeated textures, too: right but for
// whole periods, so that they say where the ground's edges go and nothing of the cameras. Once
// `stop` asks, what was found so far. images: as of MatchViews.
PlaneInViews FindGround(std::span<const cv::Mat> images,
                        const MatchingOptions& options,
                        const StopRequested& stop = {});

}  // namespace horopter
