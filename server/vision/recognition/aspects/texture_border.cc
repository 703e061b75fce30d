#include "server/vision/recognition/aspects/texture_border.h"

#include <algorithm>
#include <cmath>
#include <opencv2/imgproc.hpp>

#include "server/vision/recognition/aspects/edge_pixels.h"
#include "server/vision/recognition/aspects/quantile.h"

namespace horopter {
namespace {

constexpr double kGrainGapShare = 0.98;  // of the places between grains that no disc is to enter
constexpr double kMinRadiusPx = 4.0, kMaxRadiusPx = 9.0;  // of the discs
constexpr double kSmoothPx = 2.0;                         // Gaussian over the border: half a grain
constexpr double kMaskLevel = 64.0;                       // grey levels between the two sides
constexpr float kAsidePx = 9.0f;         // from the border to the middle of what lies beside it
constexpr int kHalfPx = 6;               // of the box there
constexpr double kMinAreaDiscs = 3.0;    // of a smooth place, in areas of a disc
constexpr double kTexturedBeside = 0.5;  // share of the ground's density there that makes it ground

// Per cell the distance (px) to the nearest edge.
cv::Mat FreeDistance(const AspectImage& image) {
  cv::Mat zero_at_edges(image.height, image.width, CV_8U, cv::Scalar(1));
  for (const ImageEdgePoint& e : image.edges) {
    zero_at_edges.at<std::uint8_t>(static_cast<int>(std::lround(e.point.y())),
                                   static_cast<int>(std::lround(e.point.x()))) = 0;
  }
  cv::Mat distance;
  cv::distanceTransform(zero_at_edges, distance, cv::DIST_L2, cv::DIST_MASK_5, CV_32F);
  return distance;
}

// Share of texture pixels in boxes about each cell.
cv::Mat TextureDensity(const AspectImage& image, const std::vector<std::uint8_t>& textured) {
  cv::Mat at(image.height, image.width, CV_32F, cv::Scalar(0));
  for (std::size_t i = 0; i < image.edges.size(); ++i) {
    if (!textured[i]) continue;
    const Eigen::Vector2f& p = image.edges[i].point;
    at.at<float>(static_cast<int>(std::lround(p.y())), static_cast<int>(std::lround(p.x()))) = 1;
  }
  cv::Mat density;
  cv::blur(at, density, cv::Size(2 * kHalfPx + 1, 2 * kHalfPx + 1));
  return density;
}

float At(const cv::Mat& map, const Eigen::Vector2f& p) {
  const int x = std::clamp(static_cast<int>(std::lround(p.x())), 0, map.cols - 1);
  const int y = std::clamp(static_cast<int>(std::lround(p.y())), 0, map.rows - 1);
  return map.at<float>(y, x);
}

bool IsInside(const AspectImage& image, const Eigen::Vector2f& p) {
  return p.x() >= 0 && p.y() >= 0 && p.x() < image.width && p.y() < image.height;
}

// Components of fewer pixels leave the mask.
void DropSmall(double min_area, cv::Mat* mask) {
  cv::Mat labels, stats, centers;
  cv::connectedComponentsWithStats(*mask, labels, stats, centers, 4);
  for (int y = 0; y < mask->rows; ++y) {
    for (int x = 0; x < mask->cols; ++x) {
      const int label = labels.at<int>(y, x);
      if (label > 0 && stats.at<int>(label, cv::CC_STAT_AREA) < min_area)
        mask->at<std::uint8_t>(y, x) = 0;
    }
  }
}

}  // namespace

std::vector<ImageEdgePoint> TextureBorder(const AspectImage& image,
                                          const std::vector<std::uint8_t>& textured,
                                          const AspectImageOptions& options) {
  const cv::Mat distance = FreeDistance(image);
  const cv::Mat density = TextureDensity(image, textured);
  std::vector<float> dense;
  for (std::size_t i = 0; i < image.edges.size(); ++i) {
    if (textured[i]) dense.push_back(At(density, image.edges[i].point));
  }
  if (dense.empty()) return {};
  const float ground = Quantile(0.5, &dense);
  std::vector<float> gaps;
  for (int y = 0; y < image.height; y += 2) {
    for (int x = 0; x < image.width; x += 2) {
      if (density.at<float>(y, x) > ground) gaps.push_back(distance.at<float>(y, x));
    }
  }
  if (gaps.empty()) return {};
  const double radius =
      std::clamp(Quantile(kGrainGapShare, &gaps) + 1.0, kMinRadiusPx, kMaxRadiusPx);
  cv::Mat outside_core, reach, mask;
  cv::threshold(distance, outside_core, radius, 1.0, cv::THRESH_BINARY_INV);
  outside_core.convertTo(outside_core, CV_8U);
  cv::distanceTransform(outside_core, reach, cv::DIST_L2, cv::DIST_MASK_5, CV_32F);
  cv::threshold(reach, mask, radius, kMaskLevel, cv::THRESH_BINARY_INV);
  mask.convertTo(mask, CV_8U);
  DropSmall(kMinAreaDiscs * CV_PI * radius * radius, &mask);
  cv::cvtColor(mask, mask, cv::COLOR_GRAY2BGR);
  AspectImageOptions tracing = options;
  tracing.sigma_px = kSmoothPx;
  std::vector<ImageEdgePoint> border = DetectEdgePoints(mask, tracing);
  std::erase_if(border, [&](const ImageEdgePoint& e) {
    return !IsInside(image, e.point - kAsidePx * e.normal) ||
           !IsInside(image, e.point + kAsidePx * e.normal) ||
           At(density, e.point - kAsidePx * e.normal) < kTexturedBeside * ground;
  });
  return border;
}

}  // namespace horopter
