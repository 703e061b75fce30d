#include "server/vision/recognition/aspects/ground_colour.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <cstddef>
#include <opencv2/imgproc.hpp>

#include "server/vision/recognition/aspects/edge_pixels.h"
#include "server/vision/recognition/aspects/quantile.h"

namespace horopter {
namespace {

constexpr std::size_t kLeastGroundPlaces = 200;  // that say what colour the ground has; chosen
constexpr double kChannelSmoothPx = 1.5;  // of the channels, px: noise of single pixels is coloured
constexpr float kColourlessLevels = 30.0f;  // added to the brightness: what is dark has no colour
constexpr float kLeastStep = 0.04f;         // of the colour coordinates, which reach 1; and ...
constexpr float kScatterStep = 4.0f;        // ... so many deviations of the ground's
constexpr float kMostScatter = 0.04f;       // deviation: beyond, the ground has several colours
constexpr float kFullStep = 0.30f;          // step that is as sharp as one from black to white
constexpr float kAsideOutlinePx = 4.0f;     // from an outline to what lies beside it

// (R - G) / s and ((R + G) / 2 - B) / s of the brightness s = R + G + B + kColourlessLevels: light
// and shade leave them as they are.
std::array<cv::Mat, 2> ColourCoordinates(const cv::Mat& bgr) {
  cv::Mat real;
  bgr.convertTo(real, CV_32F);
  cv::GaussianBlur(
      real, real, cv::Size(), kChannelSmoothPx, kChannelSmoothPx, cv::BORDER_REPLICATE);
  std::array<cv::Mat, 2> out{cv::Mat(bgr.size(), CV_32F), cv::Mat(bgr.size(), CV_32F)};
  for (int y = 0; y < bgr.rows; ++y) {
    const auto* in = real.ptr<cv::Vec3f>(y);
    float* red_green = out[0].ptr<float>(y);
    float* yellow_blue = out[1].ptr<float>(y);
    for (int x = 0; x < bgr.cols; ++x) {
      const float b = in[x][0], g = in[x][1], r = in[x][2];
      const float brightness = r + g + b + kColourlessLevels;
      red_green[x] = (r - g) / brightness;
      yellow_blue[x] = (0.5f * (r + g) - b) / brightness;
    }
  }
  return out;
}

struct Spread {
  float center = 0.0f, deviation = 0.0f;
};

// Robust: parts that lie on the ground are among the places.
Spread SpreadAt(const cv::Mat& map, const std::vector<Eigen::Vector2f>& places) {
  constexpr float kDeviation = 1.4826f;  // of a normal distribution, in its median deviations
  std::vector<float> values = ValuesAt(map, places);
  Spread out;
  out.center = Median(&values);
  for (float& v : values) v = std::abs(v - out.center);
  out.deviation = kDeviation * Median(&values);
  return out;
}

}  // namespace

GroundFigure FindColourFigure(const cv::Mat& bgr,
                              const std::vector<Eigen::Vector2f>& ground,
                              const AspectImageOptions& options) {
  GroundFigure out;
  if (bgr.empty() || ground.size() < kLeastGroundPlaces) return out;
  const std::array<cv::Mat, 2> colour = ColourCoordinates(bgr);
  const Spread first = SpreadAt(colour[0], ground), second = SpreadAt(colour[1], ground);
  if (std::max(first.deviation, second.deviation) > kMostScatter) return out;
  // Per cell how far its colour is from the ground's, in steps that count.
  const float step_first = std::max(kLeastStep, kScatterStep * first.deviation);
  const float step_second = std::max(kLeastStep, kScatterStep * second.deviation);
  const float full = kFullStep / kLeastStep;
  out.width = bgr.cols;
  out.height = bgr.rows;
  out.inside.resize(static_cast<std::size_t>(out.width) * out.height);
  cv::Mat away(bgr.size(), CV_8U);
  for (int y = 0; y < bgr.rows; ++y) {
    const float* a = colour[0].ptr<float>(y);
    const float* b = colour[1].ptr<float>(y);
    auto* to = away.ptr<std::uint8_t>(y);
    for (int x = 0; x < bgr.cols; ++x) {
      const float steps =
          std::hypot((a[x] - first.center) / step_first, (b[x] - second.center) / step_second);
      out.inside[static_cast<std::size_t>(y) * out.width + x] = steps > 1.0f;
      to[x] = static_cast<std::uint8_t>(std::min(255.0f, 255.0f * steps / full));
    }
  }
  cv::cvtColor(away, away, cv::COLOR_GRAY2BGR);
  out.outline = DetectEdgePoints(away, options);
  std::erase_if(out.outline, [&](const ImageEdgePoint& e) {
    return out.Inside(e.point + kAsideOutlinePx * e.normal) ==
           out.Inside(e.point - kAsideOutlinePx * e.normal);
  });
  return out;
}

}  // namespace horopter
