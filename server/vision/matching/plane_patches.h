// Patch correspondences of the supporting plane under a homography known roughly: a few keypoints
// fix it only where they are, the texture of the whole plane fixes it everywhere and tells a right
// one from a wrong one.
#pragma once

#include <opencv2/core/mat.hpp>

#include "server/vision/matching/matching_options.h"
#include "server/vision/matching/plane_homography.h"

namespace horopter {

// One image prepared for AlignPlane and for its keypoints: locally normalised grey values at full
// and half size.
struct PatchImage {
  struct Level {
    cv::Mat value;           // CV_32FC1 about 0, padded to the right and below
    cv::Mat inverse_spread;  // CV_32FC1, of the image's size: 1 / norm of the zero-mean window that
                             // begins at a pixel, 0 where it is blank
  };
  cv::Mat normalized_half;  // CV_8UC1, for detection
  cv::Mat normalized_quarter;
  Level levels[2];
};

// An odd last column or row is left out, so that u_half = (u - 0.5) / 2.
cv::Mat HalfSize(const cv::Mat& grey);

// image: CV_8UC1 or CV_8UC3.
PatchImage PreparePatches(const cv::Mat& image);

// Share of the patches with structure that look the same elsewhere within about 96 px of the image
// (correlation above 0.85 at a quarter of the size): near 1 on checkers, tiles and grids, where an
// alignment may be right but for a whole period and nothing would tell. 0 without structure.
double RepeatedShare(const PatchImage& image);

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
