#include "server/vision/recognition/aspects/jpeg_blocks.h"

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <cstdlib>
#include <opencv2/core.hpp>

namespace horopter {
namespace {

constexpr int kJpegBlock = 8;  // px a side
constexpr int kEvery = 3;      // rows, or columns, that are looked at; chosen, for time
constexpr int kEdgeStep = 16;  // grey levels; larger steps are edges
// Grey levels from which on there are blocks. Of 13 images (cad-dev, prague, tools, small-dev) at
// quality 60 it is 1.0 - 2.0, but for one of .5, at 90 .45 - .68, of PNGs 0 - .11.
constexpr double kBlocky = 0.8;
constexpr double kMostSteps = 4.0;  // times the blockiness: larger steps are no quantisation's
constexpr int kFlat = 2;            // grey levels beside what half the step allows

// The values of a line of pixels, `stride` bytes apart.
struct PixelLine {
  const std::uint8_t* first = nullptr;
  std::ptrdiff_t stride = 0;
  int at(int i) const { return first[i * stride]; }
};

// Sum and number of what a step across the grid is more than those beside it, minus that elsewhere.
struct Excess {
  double on = 0.0, off = 0.0;
  int n_on = 0, n_off = 0;

  void Add(const PixelLine& line, int n) {
    for (int i = 1; i + 2 < n; ++i) {
      const int step = std::abs(line.at(i + 1) - line.at(i));
      const int before = std::abs(line.at(i) - line.at(i - 1));
      const int after = std::abs(line.at(i + 2) - line.at(i + 1));
      if (std::max({step, before, after}) > kEdgeStep) continue;
      const double more = step - 0.5 * (before + after);
      const bool grid = i % kJpegBlock == kJpegBlock - 1;
      (grid ? on : off) += more;
      ++(grid ? n_on : n_off);
    }
  }
  double value() const { return n_on == 0 || n_off == 0 ? 0.0 : on / n_on - off / n_off; }
};

// Spreads the steps at the grid along a line.
void SpreadSteps(std::uint8_t* first, std::ptrdiff_t stride, int n, double most_step) {
  const auto at = [&](int i) -> std::uint8_t& { return first[i * stride]; };
  const auto add = [](int by, std::uint8_t* to) {
    *to = static_cast<std::uint8_t>(std::clamp(*to + by, 0, 255));
  };
  for (int i = kJpegBlock; i + 1 < n; i += kJpegBlock) {
    const int step = at(i) - at(i - 1);
    const int size = std::abs(step);
    if (size == 0 || size > most_step) continue;
    const int flat = size / 2 + kFlat;
    if (std::abs(at(i - 1) - at(i - 2)) > flat || std::abs(at(i + 1) - at(i)) > flat) continue;
    const int much = (3 * step) / 8, little = step / 8;
    add(little, &at(i - 2));
    add(much, &at(i - 1));
    add(-much, &at(i));
    add(-little, &at(i + 1));
  }
}

}  // namespace

double Blockiness(const cv::Mat& image) {
  if (image.empty() || image.depth() != CV_8U) return 0.0;
  const int channels = image.channels(), middle = channels == 3 ? 1 : 0;
  const std::ptrdiff_t row = static_cast<std::ptrdiff_t>(image.step[0]);
  Excess across, down;
  for (int y = 0; y < image.rows; y += kEvery)
    across.Add({image.ptr(y) + middle, channels}, image.cols);
  for (int x = 0; x < image.cols; x += kEvery)
    down.Add({image.ptr(0) + x * channels + middle, row}, image.rows);
  return std::max(across.value(), down.value());
}

Unblocked WithoutBlocks(const cv::Mat& image) {
  const double blockiness = Blockiness(image);
  if (blockiness < kBlocky) return {image, 0.0};
  cv::Mat out = image.clone();
  const int channels = out.channels();
  const std::ptrdiff_t row = static_cast<std::ptrdiff_t>(out.step[0]);
  const double most_step = kMostSteps * blockiness;
  for (int c = 0; c < channels; ++c) {
    for (int y = 0; y < out.rows; ++y) SpreadSteps(out.ptr(y) + c, channels, out.cols, most_step);
    for (int x = 0; x < out.cols; ++x)
      SpreadSteps(out.ptr(0) + x * channels + c, row, out.rows, most_step);
  }
  return {out, blockiness};
}

}  // namespace horopter
