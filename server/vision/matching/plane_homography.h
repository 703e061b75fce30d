// The homography of the supporting plane between two views, from its (often almost invisible)
// texture.
#pragma once

#include <opencv2/core/mat.hpp>
#include <optional>
#include <vector>

#include "server/vision/features/keypoints.h"
#include "server/vision/matching/homography.h"
#include "server/vision/matching/keypoint_matching.h"
#include "server/vision/matching/matching.h"

namespace horopter {

// Grey image with its local mean subtracted and its local deviation divided out (Gaussian sigma 12
// and 20 px, deviation at least 1 grey level), slightly blurred; CV_8UC1 around 128. Makes texture
// of one or two grey levels visible.
cv::Mat NormalizeLocalContrast(const cv::Mat& grey);

// Points of an image given at `scale` of its size (locally normalised or raw, CV_8UC1), as pixels
// of the full size. Images without texture give empty sets.
KeypointSet DetectPlaneKeypoints(const cv::Mat& grey, double scale, const MatchingOptions& options);

// As DetectPlaneKeypoints, of the image warped to what a camera looking straight down would see.
// Oblique views of one plane that differ in azimuth look alike only there (affine simulation, Morel
// and Yu 2009, with the tilt that a supporting plane has). The image is taken to be upright and its
// optical axis elevation_rad above the plane; 10 degrees more or less do little harm.
KeypointSet DetectKeypointsFromAbove(const cv::Mat& grey,
                                     double scale,
                                     double elevation_rad,
                                     const MatchingOptions& options);

struct PlaneEstimate {
  Eigen::Matrix3d b_from_a = Eigen::Matrix3d::Identity();
  std::vector<PointPair> inliers;
  std::vector<Eigen::Matrix2d> information;  // of AlignPlane's: see PlaneHomography
};

// Robust homography of the dominant plane; nullopt when there are fewer than
// options.min_plane_inliers distinct inliers or the homography is implausible. Deterministic for a
// given options.seed.
std::optional<PlaneEstimate> EstimatePlane(const std::vector<PointPair>& matches,
                                           const MatchingOptions& options);

}  // namespace horopter
