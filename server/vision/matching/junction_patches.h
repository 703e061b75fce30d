// Colour patches about junctions and their similarity between two views.
#pragma once

#include <Eigen/Core>
#include <functional>
#include <opencv2/core/mat.hpp>
#include <span>
#include <vector>

#include "server/vision/features/features.h"

namespace horopter {

// Two concentric patches (radius about 8 and 16 px), three channels each, zero mean and unit norm:
// the similarity is a correlation. A patch that leaves the image by more than half is empty and
// matches nothing.
struct JunctionPatch {
  static constexpr int kSide = 11;                   // samples along a side
  static constexpr int kLength = 3 * kSide * kSide;  // of three colours
  using Vector = Eigen::Matrix<float, kLength, 1>;
  Vector fine = Vector::Zero();
  Vector coarse = Vector::Zero();
  // Both patches as one unit vector: its low frequencies (orthonormal cosine transform of each
  // channel) and the norm of all others.
  static constexpr int kFrequencies = 4;  // along either axis
  using Code = Eigen::Matrix<float, 2 * 3 * kFrequencies * kFrequencies, 1>;
  Code code = Code::Zero();
  float rest = 0.0f;
  bool empty = true;
};

// How the patch grid is laid into an image at a given junction: grid offset (px) -> image offset
// (px).
using PatchShape = std::function<Eigen::Matrix2d(const Eigen::Vector2d&)>;

// The image as patches are sampled from it: colour, slightly blurred; CV_8UC4, the fourth
// channel meaningless. image: CV_8UC1 or
// CV_8UC3, which stays as it is.
cv::Mat SmoothForPatches(const cv::Mat& image);

// smooth: from SmoothForPatches. shape empty: upright patches.
std::vector<JunctionPatch> SampleJunctionPatches(const cv::Mat& smooth,
                                                 std::span<const Junction> junctions,
                                                 const PatchShape& shape = {});

// Correlation in [-1, 1], mean of both scales; -1 when either patch is empty.
double PatchSimilarity(const JunctionPatch& a, const JunctionPatch& b);

// At least PatchSimilarity, but for rounding, at an eighth of its cost: the low frequencies, and
// what the others add if they agree entirely.
float HighestSimilarity(const JunctionPatch& a, const JunctionPatch& b);

}  // namespace horopter
