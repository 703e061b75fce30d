#include "server/service/rectify.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <opencv2/core.hpp>

#include "server/pipeline/exception_status.h"

namespace horopter {
namespace {

// Where an output pixel is taken from along one axis: four neighbours, the ends repeated, and their
// weights (Keys 1981, a = -0.5: exact for parabolas).
struct Taps {
  std::array<int, 4> at;
  std::array<double, 4> weight;
};

Taps TapsAt(double coordinate, int size) {
  // What is off the image, or no number, is as good as its nearest pixel.
  const double last = size - 1;
  const double x = coordinate > 0.0 ? std::min(coordinate, last) : 0.0;
  const double whole = std::floor(x), t = x - whole;
  Taps taps;
  for (int i = 0; i < 4; ++i) {
    taps.at[i] = std::clamp(static_cast<int>(whole) + i - 1, 0, size - 1);
  }
  taps.weight = {0.5 * t * (-1.0 + t * (2.0 - t)),
                 1.0 + 0.5 * t * t * (3.0 * t - 5.0),
                 0.5 * t * (1.0 + t * (4.0 - 3.0 * t)),
                 0.5 * t * t * (t - 1.0)};
  return taps;
}

void Sample(
    const cv::Mat& image, const Taps& column, const Taps& row, int channels, unsigned char* out) {
  for (int c = 0; c < channels; ++c) {
    double sum = 0.0;
    for (int j = 0; j < 4; ++j) {
      const unsigned char* line = image.ptr(row.at[j]);
      double along = 0.0;
      for (int i = 0; i < 4; ++i) along += column.weight[i] * line[column.at[i] * channels + c];
      sum += row.weight[j] * along;
    }
    out[c] = static_cast<unsigned char>(std::clamp(sum + 0.5, 0.0, 255.0));
  }
}

}  // namespace

absl::StatusOr<cv::Mat> Rectified(const cv::Mat& image, const LensModel& lens) {
  return CatchExceptions([&]() -> absl::StatusOr<cv::Mat> {
    cv::Mat out(image.size(), image.type());
    const int channels = image.channels();
    const double most = ReachOf(lens).ray;
    for (int v = 0; v < image.rows; ++v) {
      for (int u = 0; u < image.cols; ++u) {
        Eigen::Vector2d ray((u - lens.cx) / lens.fx, (v - lens.cy) / lens.fx);
        // Beyond it the lens would show what is within once more.
        if (const double r = ray.norm(); r > most) ray *= most / r;
        const Eigen::Vector2d from = DistortedPixel(lens, ray);
        Sample(image,
               TapsAt(from.x(), image.cols),
               TapsAt(from.y(), image.rows),
               channels,
               out.ptr(v) + u * channels);
      }
    }
    return out;
  });
}

}  // namespace horopter
