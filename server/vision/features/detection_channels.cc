#include "server/vision/features/detection_channels.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <opencv2/core.hpp>
#include <opencv2/imgproc.hpp>

namespace horopter {
namespace {

constexpr double kOpponentGain = 1.5;  // of opponent colours against grey

cv::Mat Opponent(const cv::Mat& bgr, double weight_b, double weight_g, double weight_r) {
  cv::Mat out;
  const cv::Matx14f mix(static_cast<float>(kOpponentGain * weight_b),
                        static_cast<float>(kOpponentGain * weight_g),
                        static_cast<float>(kOpponentGain * weight_r),
                        128.0f);
  cv::transform(bgr, out, mix);
  return out;
}

}  // namespace

std::vector<DetectionChannel> MakeDetectionChannels(const cv::Mat& image,
                                                    double smoothing_sigma_px) {
  std::vector<DetectionChannel> channels;
  if (image.channels() == 1) {
    channels.push_back({image, {}, 0.0});
  } else {
    cv::Mat planes[3];
    cv::split(image, planes);
    for (const cv::Mat& plane : planes) {
      channels.push_back({plane, {}, 0.0});
    }
    channels.push_back({Opponent(image, 0.0, -1.0, 1.0), {}, 0.0});
    channels.push_back({Opponent(image, -1.0, 0.5, 0.5), {}, 0.0});
  }
  for (DetectionChannel& channel : channels) {
    cv::Mat as_float;
    channel.grey.convertTo(as_float, CV_32F);
    cv::GaussianBlur(as_float, channel.smooth, cv::Size(), smoothing_sigma_px);
    channel.median_gradient = MedianGradient(channel.smooth);
  }
  return channels;
}

double MedianGradient(const cv::Mat& smooth) {
  constexpr int kBins = 1024;           // of the histogram, up to 128
  constexpr float kBinsPerUnit = 8.0f;  // of |dx| + |dy|
  std::array<int, kBins> histogram{};
  int total = 0;
  for (int y = 1; y + 1 < smooth.rows; y += 2) {
    const float* a = smooth.ptr<float>(y - 1);
    const float* b = smooth.ptr<float>(y);
    const float* c = smooth.ptr<float>(y + 1);
    for (int x = 1; x + 1 < smooth.cols; x += 2) {
      const float dx = a[x + 1] + b[x + 1] + c[x + 1] - a[x - 1] - b[x - 1] - c[x - 1];
      const float dy = c[x - 1] + c[x] + c[x + 1] - a[x - 1] - a[x] - a[x + 1];
      const float size = kBinsPerUnit * (std::abs(dx) + std::abs(dy));
      ++histogram[std::min(static_cast<int>(size), kBins - 1)];
      ++total;
    }
  }
  int below = 0;
  for (int bin = 0; bin < kBins; ++bin) {
    below += histogram[bin];
    if (2 * below >= total) {
      return (bin + 0.5) / kBinsPerUnit;
    }
  }
  return 0.0;
}

float SampleBilinear(const cv::Mat& image, float x, float y) {
  x = std::clamp(x, 0.0f, static_cast<float>(image.cols - 1));
  y = std::clamp(y, 0.0f, static_cast<float>(image.rows - 1));
  const int x0 = std::min(static_cast<int>(x), image.cols - 2);
  const int y0 = std::min(static_cast<int>(y), image.rows - 2);
  const float fx = x - static_cast<float>(x0);
  const float fy = y - static_cast<float>(y0);
  const float* top = image.ptr<float>(y0) + x0;
  const float* bottom = image.ptr<float>(y0 + 1) + x0;
  const float upper = top[0] + fx * (top[1] - top[0]);
  const float lower = bottom[0] + fx * (bottom[1] - bottom[0]);
  return upper + fy * (lower - upper);
}

}  // namespace horopter
