// Colour patches about junctions and their likeness between two views.
#pragma once

#include <Eigen/Core>
#include <functional>
#include <opencv2/core/mat.hpp>
#include <span>
#include <vector>

#include "server/vision/features/features.h"

namespace horopter {

// Two concentric patches (radius about 8 and 16 px), three channels each, zero mean and unit norm:
// the likeness is a correlation. A patch that leaves the image by more than half is empty and
// matches nothing.
struct JunctionPatch {
  static constexpr int kSide = 11;
  static constexpr int kLength = 3 * kSide * kSide;
  using Vector = Eigen::Matrix<float, kLength, 1>;
  Vector fine = Vector::Zero();
  Vector coarse = Vector::Zero();
  bool empty = true;
};

// How the patch grid is laid into an image at a given junction: grid offset (px) -> image offset
// (px).
using PatchShape = std::function<Eigen::Matrix2d(const Eigen::Vector2d&)>;

// image: CV_8UC1 or CV_8UC3. shape empty: upright patches.
std::vector<JunctionPatch> SampleJunctionPatches(const cv::Mat& image,
                                                 std::span<const Junction> junctions,
                                                 const PatchShape& shape = {});

// Correlation in [-1, 1], mean of both scales; -1 when either patch is empty.
double PatchLikeness(const JunctionPatch& a, const JunctionPatch& b);

}  // namespace horopter
