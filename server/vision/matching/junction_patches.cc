#include "server/vision/matching/junction_patches.h"

#include <Eigen/Dense>
#include <algorithm>
#include <cmath>
#include <cstdint>
#include <cstring>
#include <opencv2/imgproc.hpp>

namespace horopter {
namespace {

constexpr double kFineStepPx = 1.6;    // between samples: 16 px wide in all
constexpr double kCoarseStepPx = 3.2;  // twice the fine one
constexpr double kMinNorm =
    12.0;  // grey levels over the whole patch: below it there is nothing but noise

// The channels of a pixel in one register; the same arithmetic as one by one.
using Pixel = float __attribute__((vector_size(16)));
using Bytes = std::uint8_t __attribute__((vector_size(4)));

Pixel AsFloat(const cv::Vec4b& pixel) {
  Bytes bytes;
  std::memcpy(&bytes, pixel.val, sizeof(bytes));
  return __builtin_convertvector(bytes, Pixel);
}

// Samples one patch; false when more than half of it lies outside the image.
bool SamplePatch(const cv::Mat& smooth,
                 const Eigen::Vector2d& center,
                 const Eigen::Matrix2d& shape,
                 double step,
                 JunctionPatch::Vector* patch) {
  constexpr int kHalf = JunctionPatch::kSide / 2;  // samples on each side of the middle
  constexpr int kArea = JunctionPatch::kSide * JunctionPatch::kSide;  // samples of a channel
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
      const cv::Vec4b* row0 = smooth.ptr<cv::Vec4b>(y0) + x0;
      const cv::Vec4b* row1 = smooth.ptr<cv::Vec4b>(y0 + 1) + x0;
      const Pixel value = (1 - fy) * ((1 - fx) * AsFloat(row0[0]) + fx * AsFloat(row0[1])) +
                          fy * ((1 - fx) * AsFloat(row1[0]) + fx * AsFloat(row1[1]));
      for (int c = 0; c < 3; ++c) (*patch)(c * kArea + k) = value[c];
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

using Basis = Eigen::Matrix<float, JunctionPatch::kFrequencies, JunctionPatch::kSide>;

// The first vectors of the orthonormal cosine transform.
Basis CosineBasis() {
  Basis basis;
  constexpr int n = JunctionPatch::kSide;
  for (int k = 0; k < JunctionPatch::kFrequencies; ++k) {
    const double scale = std::sqrt((k == 0 ? 1.0 : 2.0) / n);
    for (int i = 0; i < n; ++i)
      basis(k, i) = static_cast<float>(scale * std::cos(M_PI * (i + 0.5) * k / n));
  }
  return basis;
}

void Encode(JunctionPatch* patch) {
  static const Basis kBasis = CosineBasis();
  // Samples along a side, and frequencies kept of them.
  constexpr int kSide = JunctionPatch::kSide, kLow = JunctionPatch::kFrequencies;
  using Square = Eigen::Matrix<float, kSide, kSide>;
  int at = 0;
  for (const JunctionPatch::Vector* scale : {&patch->fine, &patch->coarse}) {
    for (int c = 0; c < 3; ++c, at += kLow * kLow) {
      const Eigen::Map<const Square> channel(scale->data() + c * kSide * kSide);
      const Eigen::Matrix<float, kLow, kSide> half = kBasis * channel;
      Eigen::Map<Eigen::Matrix<float, kLow, kLow>>(patch->code.data() + at) =
          half * kBasis.transpose();
    }
  }
  patch->code *= static_cast<float>(M_SQRT1_2);
  patch->rest = std::sqrt(std::max(0.0f, 1.0f - patch->code.squaredNorm()));
}

}  // namespace

cv::Mat SmoothForPatches(const cv::Mat& image) {
  // A copied cv::Mat shares its pixels: the blur must write into one of its own.
  cv::Mat colour = image, smooth;
  if (image.channels() == 1) cv::cvtColor(image, colour, cv::COLOR_GRAY2BGR);
  cv::GaussianBlur(colour, smooth, cv::Size(), 1.2);
  cv::cvtColor(smooth, smooth, cv::COLOR_BGR2BGRA);
  return smooth;
}

std::vector<JunctionPatch> SampleJunctionPatches(const cv::Mat& smooth,
                                                 std::span<const Junction> junctions,
                                                 const PatchShape& shape) {
  std::vector<JunctionPatch> patches(junctions.size());
  if (smooth.rows < 2 || smooth.cols < 2) return patches;
  for (size_t i = 0; i < junctions.size(); ++i) {
    const Eigen::Vector2d& p = junctions[i].point;
    const Eigen::Matrix2d A = shape ? shape(p) : Eigen::Matrix2d::Identity().eval();
    if (!A.allFinite() || A.norm() > 20.0 || !p.allFinite()) continue;
    patches[i].empty = !SamplePatch(smooth, p, A, kFineStepPx, &patches[i].fine) ||
                       !SamplePatch(smooth, p, A, kCoarseStepPx, &patches[i].coarse);
    if (!patches[i].empty) Encode(&patches[i]);
  }
  return patches;
}

double PatchSimilarity(const JunctionPatch& a, const JunctionPatch& b) {
  if (a.empty || b.empty) return -1.0;
  return 0.5 *
         (static_cast<double>(a.fine.dot(b.fine)) + static_cast<double>(a.coarse.dot(b.coarse)));
}

float HighestSimilarity(const JunctionPatch& a, const JunctionPatch& b) {
  if (a.empty || b.empty) return -1.0f;
  return a.code.dot(b.code) + a.rest * b.rest;
}

}  // namespace horopter
