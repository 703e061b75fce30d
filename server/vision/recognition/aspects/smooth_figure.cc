#include "server/vision/recognition/aspects/smooth_figure.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <cstddef>
#include <opencv2/imgproc.hpp>

#include "server/vision/recognition/aspects/edge_pixels.h"
#include "server/vision/recognition/aspects/quantile.h"

namespace horopter {
namespace {

// Of the image: places that make a ground of grains. Granite has .11 - .22 of it, glints on steel
// .0013.
constexpr double kLeastPlaces = 0.02;
constexpr double kNoisePx = 0.8;  // Gaussian against the noise of pixels
// Of the discs that close and open, px: the least between which the grains leave hardly a gap.
constexpr int kReachesPx[] = {4, 6, 9};
constexpr double kMostGaps = 0.01;     // of the image; chosen
constexpr float kDarkLevels = 20.0f;   // added to the brightness: noise is no grain of the dark
constexpr float kLeastGrain = 0.06f;   // log ratio: less is no texture
constexpr float kSmoothShare = 0.5f;   // of the ground's grain
constexpr double kLeastDiscs = 3.0;    // areas of a disc; smaller smooth places are gaps
constexpr double kMaskBorderPx = 1.5;  // Gaussian over the mask's border: half a grain
constexpr double kFigureLevel = 64.0;  // grey levels between its two sides

// Log ratio of bright to dark around each cell.
cv::Mat Grain(const cv::Mat& grey, int reach_px) {
  const int side = 2 * reach_px + 1;
  const cv::Mat disc = cv::getStructuringElement(cv::MORPH_ELLIPSE, {side, side});
  cv::Mat bright, dark;
  cv::morphologyEx(grey, bright, cv::MORPH_CLOSE, disc);
  cv::morphologyEx(bright, bright, cv::MORPH_OPEN, disc);
  cv::morphologyEx(grey, dark, cv::MORPH_OPEN, disc);
  cv::morphologyEx(dark, dark, cv::MORPH_CLOSE, disc);
  std::array<float, 256> logs;
  for (int i = 0; i < 256; ++i) logs[i] = std::log(static_cast<float>(i) + kDarkLevels);
  cv::Mat grain(grey.size(), CV_32F);
  for (int y = 0; y < grain.rows; ++y) {
    const auto* high = bright.ptr<std::uint8_t>(y);
    const auto* low = dark.ptr<std::uint8_t>(y);
    float* to = grain.ptr<float>(y);
    for (int x = 0; x < grain.cols; ++x) to[x] = logs[high[x]] - logs[low[x]];
  }
  return grain;
}

// Components of one value that are too small take the other. Returns their area, px.
int Flip(bool value, double least_area, cv::Mat* mask) {
  cv::Mat of_value, labels, stats, centers;
  cv::compare(*mask, cv::Scalar(value ? kFigureLevel : 0.0), of_value, cv::CMP_EQ);
  cv::connectedComponentsWithStats(of_value, labels, stats, centers, 4);
  int flipped = 0;
  for (int y = 0; y < mask->rows; ++y) {
    for (int x = 0; x < mask->cols; ++x) {
      const int label = labels.at<int>(y, x);
      if (label == 0 || stats.at<int>(label, cv::CC_STAT_AREA) >= least_area) continue;
      mask->at<std::uint8_t>(y, x) = static_cast<std::uint8_t>(value ? 0.0 : kFigureLevel);
      ++flipped;
    }
  }
  return flipped;
}

}  // namespace

GroundFigure FindSmoothFigure(const cv::Mat& bgr,
                              const std::vector<Eigen::Vector2f>& ground,
                              const AspectImageOptions& options) {
  GroundFigure out;
  if (bgr.empty() || static_cast<double>(ground.size()) < kLeastPlaces * bgr.total()) return out;
  cv::Mat grey, mask;
  cv::cvtColor(bgr, grey, cv::COLOR_BGR2GRAY);
  cv::GaussianBlur(grey, grey, {}, kNoisePx);
  for (const int reach_px : kReachesPx) {
    const cv::Mat grain = Grain(grey, reach_px);
    std::vector<float> of_ground = ValuesAt(grain, ground);
    const float usual = Median(&of_ground);
    if (usual < kLeastGrain) return out;
    cv::threshold(grain, mask, kSmoothShare * usual, kFigureLevel, cv::THRESH_BINARY_INV);
    mask.convertTo(mask, CV_8U);
    const double least_area = kLeastDiscs * CV_PI * reach_px * reach_px;
    const int gaps = Flip(true, least_area, &mask);
    Flip(false, least_area, &mask);
    if (gaps < kMostGaps * static_cast<double>(mask.total())) break;
  }
  out.width = mask.cols;
  out.height = mask.rows;
  out.inside.reserve(mask.total());
  for (int y = 0; y < mask.rows; ++y) {
    for (int x = 0; x < mask.cols; ++x) out.inside.push_back(mask.at<std::uint8_t>(y, x) != 0);
  }
  cv::cvtColor(mask, mask, cv::COLOR_GRAY2BGR);
  AspectImageOptions tracing = options;
  tracing.sigma_px = kMaskBorderPx;
  out.outline = DetectEdgePoints(mask, tracing);
  return out;
}

}  // namespace horopter
