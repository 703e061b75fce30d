#include "server/vision/features/side_colours.h"

#include <algorithm>
#include <array>
#include <cmath>

namespace horopter {
namespace {

constexpr int kMaxColourSamples = 15;  // along the segment; for time
constexpr double kDistancePx = 3.0;    // from the segment: beyond its blur

Eigen::Vector3f MedianBeside(const cv::Mat& image, const Segment& segment, double side) {
  const Eigen::Vector2d direction = (segment.end - segment.start).normalized();
  const Eigen::Vector2d right(-direction.y(), direction.x());
  const int count = std::clamp(static_cast<int>(segment.Length() / 2.0), 3, kMaxColourSamples);
  std::array<std::array<uint8_t, kMaxColourSamples>, 3> values{};
  const int channels = image.channels();
  for (int i = 0; i < count; ++i) {
    const double s = (i + 0.5) / count;
    const Eigen::Vector2d p =
        segment.start + s * (segment.end - segment.start) + side * kDistancePx * right;
    const int x = std::clamp(static_cast<int>(std::lround(p.x())), 0, image.cols - 1);
    const int y = std::clamp(static_cast<int>(std::lround(p.y())), 0, image.rows - 1);
    const uint8_t* pixel = image.ptr<uint8_t>(y) + static_cast<ptrdiff_t>(x) * channels;
    for (int c = 0; c < 3; ++c) {
      values[c][i] = pixel[channels == 3 ? c : 0];
    }
  }
  Eigen::Vector3f median;
  for (int c = 0; c < 3; ++c) {
    std::nth_element(values[c].begin(), values[c].begin() + count / 2, values[c].begin() + count);
    median[c] = values[c][count / 2];
  }
  return median;
}

}  // namespace

void MeasureSideColours(const cv::Mat& image, std::vector<Segment>* segments) {
  for (Segment& segment : *segments) {
    segment.left_bgr = MedianBeside(image, segment, -1.0);
    segment.right_bgr = MedianBeside(image, segment, 1.0);
  }
}

}  // namespace horopter
