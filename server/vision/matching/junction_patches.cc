#include "server/vision/matching/junction_patches.h"

#include <Eigen/Dense>
#include <algorithm>
#include <cmath>
#include <opencv2/imgproc.hpp>

namespace horopter {
namespace {

constexpr double kFineStepPx = 1.6;
constexpr double kCoarseStepPx = 3.2;
constexpr double kMinNorm =
    12.0;  // grey levels over the whole patch: below it there is nothing but noise

// Samples one patch; false when more than half of it lies outside the image.
bool SamplePatch(const cv::Mat& smooth,
                 const Eigen::Vector2d& center,
                 const Eigen::Matrix2d& shape,
                 double step,
                 JunctionPatch::Vector* patch) {
  constexpr int kHalf = JunctionPatch::kSide / 2;
  constexpr int kArea = JunctionPatch::kSide * JunctionPatch::kSide;
  int outside = 0, k = 0;
  for (int gy = -kHalf; gy <= kHalf; ++gy) {
    for (int gx = -kHalf; gx <= kHalf; ++gx, ++k) {
      const Eigen::Vector2d p = center + shape * Eigen::Vector2d(gx * step, gy * step);
      if (!(p.x() >= 0 && p.y() >= 0 && p.x() <= smooth.cols - 1 && p.y() <= smooth.rows - 1))
        ++outside;
      const double x = std::clamp(p.x(), 0.0, smooth.cols - 1.001);
      const double y = std::clamp(p.y(), 0.0, smooth.rows - 1.001);
      const int x0 = static_cast<int>(x), y0 = static_cast<int>(y);
      const float fx = static_cast<float>(x - x0), fy = static_cast<float>(y - y0);
      const cv::Vec3b* row0 = smooth.ptr<cv::Vec3b>(y0) + x0;
      const cv::Vec3b* row1 = smooth.ptr<cv::Vec3b>(y0 + 1) + x0;
      for (int c = 0; c < 3; ++c) {
        (*patch)(c * kArea + k) = (1 - fy) * ((1 - fx) * row0[0][c] + fx * row0[1][c]) +
                                  fy * ((1 - fx) * row1[0][c] + fx * row1[1][c]);
      }
    }
  }
  if (2 * outside > kArea) return false;
  for (int c = 0; c < 3; ++c) {
    auto channel = patch->segment<kArea>(c * kArea);
    channel.array() -= channel.mean();
  }
  const float norm = patch->norm();
  if (norm < kMinNorm) return false;
  *patch /= norm;
  return true;
}

}  // namespace

std::vector<JunctionPatch> SampleJunctionPatches(const cv::Mat& image,
                                                 std::span<const Junction> junctions,
                                                 const PatchShape& shape) {
  std::vector<JunctionPatch> patches(junctions.size());
  if (image.rows < 2 || image.cols < 2) return patches;
  // A copied cv::Mat shares its pixels: the blur must write into one of its own.
  cv::Mat colour = image, smooth;
  if (image.channels() == 1) cv::cvtColor(image, colour, cv::COLOR_GRAY2BGR);
  cv::GaussianBlur(colour, smooth, cv::Size(), 1.2);
  for (size_t i = 0; i < junctions.size(); ++i) {
    const Eigen::Vector2d& p = junctions[i].point;
    const Eigen::Matrix2d A = shape ? shape(p) : Eigen::Matrix2d::Identity().eval();
    if (!A.allFinite() || A.norm() > 20.0 || !p.allFinite()) continue;
    patches[i].empty = !SamplePatch(smooth, p, A, kFineStepPx, &patches[i].fine) ||
                       !SamplePatch(smooth, p, A, kCoarseStepPx, &patches[i].coarse);
  }
  return patches;
}

double PatchLikeness(const JunctionPatch& a, const JunctionPatch& b) {
  if (a.empty || b.empty) return -1.0;
  return 0.5 *
         (static_cast<double>(a.fine.dot(b.fine)) + static_cast<double>(a.coarse.dot(b.coarse)));
}

}  // namespace horopter
