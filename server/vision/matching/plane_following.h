// A plane followed from view to view: homographies that are known roughly, as cameras and what
// stands on the plane give them, confirmed and refined by its patches.
#pragma once

#include <opencv2/core/mat.hpp>
#include <span>
#include <vector>

#include "server/base/stop_token.h"
#include "server/vision/matching/ground_motion.h"
#include "server/vision/matching/matching.h"
#include "server/vision/matching/plane_patches.h"

namespace horopter {

// Whether enough patches agree on the homography, and on a plausible one.
bool IsConfirmed(const PlaneAlignment& alignment);

// The homography of views a and b.
PlaneHomography AsPlane(int view_a, int view_b, const PlaneEstimate& estimate);

// The homographies of each view and its next two (of those that have one in `plane`, pixels) that
// the patches of both confirm; `plane` may be off by about 12 px. images: CV_8UC1 or CV_8UC3. Once
// `stop` asks, what was found so far.
std::vector<PlaneHomography> FollowPlane(std::span<const cv::Mat> images,
                                         const PlaneInViews& plane,
                                         const AlignOptions& options,
                                         int threads,
                                         const StopRequested& stop = {});

}  // namespace horopter
