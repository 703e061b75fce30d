// Patch correspondences of the supporting plane under a homography known roughly: a few keypoints
// fix it only where they are, the texture of the whole plane fixes it everywhere and tells a right
// one from a wrong one.
#pragma once

#include <opencv2/core/mat.hpp>

#include "server/vision/matching/plane_homography.h"

namespace horopter {

// One image prepared for AlignPlane: locally normalised grey values at full and half size with
// their integrals.
struct PatchImage {
  struct Level {
    cv::Mat value;    // CV_32FC1
    cv::Mat sum;      // CV_64FC1, one row and column more
    cv::Mat squares;  // CV_64FC1
  };
  Level levels[2];
};

// image: CV_8UC1 or CV_8UC3.
PatchImage PreparePatches(const cv::Mat& image);

struct AlignOptions {
  double min_correlation = 0.7;  // NCC of 16x16 patches; locally normalised noise reaches 0.5
};

struct PlaneAlignment {
  PlaneEstimate estimate;  // inliers: patch centres in a and where they are found in b, < 1 px
  int matched = 0;         // patches with a distinct match at the last, finest search
};

// Refines b_from_a, right to about 12 px somewhere, by searching the patches of image a in image b
// from coarse to fine. Patches off the plane find no match under the homography or fall out as
// outliers.
PlaneAlignment AlignPlane(const PatchImage& a,
                          const PatchImage& b,
                          const Eigen::Matrix3d& b_from_a,
                          const AlignOptions& options);

}  // namespace horopter
