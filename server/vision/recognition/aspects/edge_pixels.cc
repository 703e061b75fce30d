#include "server/vision/recognition/aspects/edge_pixels.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <opencv2/imgproc.hpp>
#include <utility>

#include "server/base/parallel_for.h"
#include "server/base/stop_scope.h"
#include "server/vision/recognition/aspects/quantile.h"

namespace horopter {
namespace {

constexpr int kMinComponentPx = 5;  // shorter edges are dropped
constexpr int kRowsPerLook = 256;   // at whether the caller still wants the edges
// Of images in noise: sigma_px, so many times as wide, where gradients fall by so much then. At 1.8
// times the sigma those of white noise fell by 1.7 - 2.0, of granite by .8 - .95. ADR 59.
constexpr double kNoisySigma = 1.4, kWhiteFalls = 1.25;
constexpr int kChannels = 5;  // B, G, R, R - G, (R + G) / 2 - B

// Gradient of the channel that changes most, per cell.
struct GradientField {
  int width = 0, height = 0;
  std::vector<float> gx, gy, squared;
  std::vector<std::uint8_t> brightness;  // mean of B, G, R, smoothed
  double noise = 0.0;                    // NoiseLevel
};

// B, G, R, R - G, (R + G) / 2 - B, smoothed. The differences are taken of smoothed channels, which
// is the same as smoothing them.
std::array<cv::Mat, kChannels> SmoothedChannels(const cv::Mat& bgr, double sigma) {
  cv::Mat real;
  bgr.convertTo(real, CV_32F);
  cv::GaussianBlur(real, real, cv::Size(), sigma, sigma, cv::BORDER_REPLICATE);
  std::array<cv::Mat, 3> plain;
  cv::split(real, plain.data());
  const cv::Mat red_green = plain[2] - plain[1];
  cv::Mat yellow_blue;
  cv::addWeighted(plain[2], 0.5, plain[1], 0.5, 0.0, yellow_blue);
  yellow_blue -= plain[0];
  return {plain[0], plain[1], plain[2], red_green, yellow_blue};
}

GradientField LargestGradient(const cv::Mat& bgr, const AspectImageOptions& options) {
  GradientField field;
  field.width = bgr.cols;
  field.height = bgr.rows;
  const std::size_t cells = static_cast<std::size_t>(bgr.cols) * bgr.rows;
  field.gx.assign(cells, 0.0f);
  field.gy.assign(cells, 0.0f);
  field.squared.assign(cells, 0.0f);
  field.brightness.assign(cells, 0);
  const auto channels = SmoothedChannels(bgr, options.sigma_px);
  ParallelFor(bgr.rows - 2, options.threads, [&](int row) {
    const int y = row + 1;
    const std::size_t base = static_cast<std::size_t>(y) * bgr.cols;
    const float* plain[] = {
        channels[0].ptr<float>(y), channels[1].ptr<float>(y), channels[2].ptr<float>(y)};
    for (int x = 0; x < bgr.cols; ++x)
      field.brightness[base + x] =
          static_cast<std::uint8_t>((plain[0][x] + plain[1][x] + plain[2][x]) / 3.0f);
    for (const cv::Mat& channel : channels) {
      const float* above = channel.ptr<float>(y - 1);
      const float* here = channel.ptr<float>(y);
      const float* below = channel.ptr<float>(y + 1);
      for (int x = 1; x + 1 < bgr.cols; ++x) {
        const float gx = 0.5f * (here[x + 1] - here[x - 1]);
        const float gy = 0.5f * (below[x] - above[x]);
        const float squared = gx * gx + gy * gy;
        const bool more = squared > field.squared[base + x];
        field.gx[base + x] = more ? gx : field.gx[base + x];
        field.gy[base + x] = more ? gy : field.gy[base + x];
        field.squared[base + x] = more ? squared : field.squared[base + x];
      }
    }
  });
  return field;
}

// Noise of the largest gradient: its lower quartile, which edges hardly touch; where that is far
// above what the smoothest places have, it is a texture's, and theirs counts: a table of granite is
// no noise. A flat image without noise gives 0.
double NoiseLevel(const GradientField& field) {
  constexpr int kBlock = 16;             // px a side
  constexpr double kSmoothBlocks = 0.1;  // share of the image that parts show without texture
  constexpr double kScatter = 1.3;       // of a block's quartile, among blocks of one noise
  constexpr double kTextured = 2.0;      // times the smoothest; chosen, commit f40c0a3
  std::vector<float> all, blocks, block;
  const int height = static_cast<int>(field.squared.size()) / field.width;
  for (std::size_t i = 0; i < field.squared.size(); i += 7) all.push_back(field.squared[i]);
  for (int y0 = 0; y0 + kBlock <= height; y0 += kBlock) {
    for (int x0 = 0; x0 + kBlock <= field.width; x0 += kBlock) {
      block.clear();
      for (int y = y0; y < y0 + kBlock; y += 2) {
        for (int x = x0; x < x0 + kBlock; x += 2)
          block.push_back(field.squared[static_cast<std::size_t>(y) * field.width + x]);
      }
      blocks.push_back(Quantile(0.25, &block));
    }
  }
  const double everywhere = std::sqrt(Quantile(0.25, &all));
  if (blocks.empty()) return everywhere;
  const double smooth = std::sqrt(Quantile(kSmoothBlocks, &blocks));
  return everywhere > kTextured * smooth ? kScatter * smooth : everywhere;
}

// NoiseLevel, less where what is as bright has less of it: light comes in grains, and dark surfaces
// have smaller ones. [brightness].
std::array<float, 256> NoiseOfBrightness(const GradientField& field) {
  constexpr int kBin = 16;               // grey levels
  constexpr double kLeastShare = 0.004;  // of the image: what is as bright tells its noise
  const float most = static_cast<float>(field.noise);
  std::array<std::vector<float>, 256 / kBin> squared;
  std::size_t all = 0;
  for (std::size_t i = 0; i < field.squared.size(); i += 7, ++all)
    squared[field.brightness[i] / kBin].push_back(field.squared[i]);
  std::array<float, 256 / kBin> of_bin;
  for (std::size_t b = 0; b < squared.size(); ++b) {
    const bool told =
        static_cast<double>(squared[b].size()) >= kLeastShare * static_cast<double>(all);
    of_bin[b] =
        told ? std::min(most, static_cast<float>(std::sqrt(Quantile(0.25, &squared[b])))) : most;
  }
  std::array<float, 256> out;
  for (int level = 0; level < 256; ++level) {
    const float at =
        std::clamp((static_cast<float>(level) + 0.5f) / kBin - 0.5f, 0.0f, 256.0f / kBin - 1.0f);
    const int below = static_cast<int>(at);
    const int above = std::min(below + 1, 256 / kBin - 1);
    const float share = at - static_cast<float>(below);
    out[level] = (1.0f - share) * of_bin[below] + share * of_bin[above];
  }
  return out;
}

// Smoothed more where noise drowns weak edges: white noise then has much less gradient, which
// texture and edges have not.
GradientField GradientInNoise(const cv::Mat& bgr, const AspectImageOptions& options) {
  GradientField field = LargestGradient(bgr, options);
  field.noise = NoiseLevel(field);
  if (options.noise_factor * field.noise <= options.noisy * options.low_threshold) return field;
  AspectImageOptions smoother = options;
  smoother.sigma_px = kNoisySigma * options.sigma_px;
  GradientField smooth = LargestGradient(bgr, smoother);
  smooth.noise = NoiseLevel(smooth);
  return field.noise > kWhiteFalls * smooth.noise ? smooth : field;
}

// The edge point of a cell if its gradient is the largest along its direction.
bool ThinnedPoint(const GradientField& field, int x, int y, ImageEdgePoint* out) {
  const std::size_t at = static_cast<std::size_t>(y) * field.width + x;
  const float magnitude = std::sqrt(field.squared[at]);
  const float nx = field.gx[at] / magnitude, ny = field.gy[at] / magnitude;
  // Magnitude one step along the dominant axis, interpolated between two cells.
  const bool steep = std::abs(ny) > std::abs(nx);
  const float slope = steep ? nx / ny : ny / nx;
  const int side = slope > 0 ? 1 : -1;
  const float w = std::abs(slope);
  const auto value = [&](int dx, int dy) {
    return std::sqrt(field.squared[at + static_cast<std::ptrdiff_t>(dy) * field.width + dx]);
  };
  const float after = steep ? (1 - w) * value(0, 1) + w * value(side, 1)
                            : (1 - w) * value(1, 0) + w * value(1, side);
  const float before = steep ? (1 - w) * value(0, -1) + w * value(-side, -1)
                             : (1 - w) * value(-1, 0) + w * value(-1, -side);
  if (!(magnitude > before && magnitude >= after)) return false;
  const float curvature = before + after - 2 * magnitude;
  const float offset =
      curvature < -1e-6f ? std::clamp(0.5f * (before - after) / curvature, -0.49f, 0.49f) : 0.0f;
  // `offset` counts steps along the dominant axis; below half a cell, so rounding gives the cell.
  out->point = {x + offset * (steep ? slope : 1.0f), y + offset * (steep ? 1.0f : slope)};
  out->normal = {nx, ny};
  out->strength = magnitude;
  return true;
}

}  // namespace

std::vector<ImageEdgePoint> DetectEdgePoints(const cv::Mat& bgr,
                                             const AspectImageOptions& options) {
  if (bgr.cols < 8 || bgr.rows < 8) return {};
  const GradientField field = GradientInNoise(bgr, options);
  LeaveIfStopped();
  // Least strength of an edge, and of one point of its component, there.
  const float high_per_low = static_cast<float>(options.high_threshold / options.low_threshold);
  std::array<float, 256> low = NoiseOfBrightness(field);
  for (float& of_level : low)
    of_level = std::max(static_cast<float>(options.low_threshold),
                        static_cast<float>(options.noise_factor) * of_level);
  std::vector<ImageEdgePoint> points;
  std::vector<std::int32_t> at(field.squared.size(), -1);
  for (int y = 2; y + 2 < bgr.rows; ++y) {
    if (y % kRowsPerLook == 0) LeaveIfStopped();
    for (int x = 2; x + 2 < bgr.cols; ++x) {
      const std::size_t cell = static_cast<std::size_t>(y) * bgr.cols + x;
      const float least = low[field.brightness[cell]];
      if (field.squared[cell] < least * least) continue;
      ImageEdgePoint point;
      if (!ThinnedPoint(field, x, y, &point)) continue;
      at[cell] = static_cast<std::int32_t>(points.size());
      points.push_back(point);
    }
  }
  LeaveIfStopped();
  // Components of 8-connected cells that are long and somewhere strong.
  std::vector<std::uint8_t> keep(points.size(), 0), seen(points.size(), 0);
  std::vector<std::int32_t> component;
  std::vector<std::int32_t> cell_of(points.size());
  for (std::size_t cell = 0; cell < at.size(); ++cell) {
    if (at[cell] >= 0) cell_of[at[cell]] = static_cast<std::int32_t>(cell);
  }
  for (std::size_t first = 0; first < points.size(); ++first) {
    if (seen[first]) continue;
    component.assign(1, static_cast<std::int32_t>(first));
    seen[first] = 1;
    bool strong = false;
    for (std::size_t i = 0; i < component.size(); ++i) {
      strong = strong || points[component[i]].strength >=
                             high_per_low * low[field.brightness[cell_of[component[i]]]];
      for (int dy = -1; dy <= 1; ++dy) {
        for (int dx = -1; dx <= 1; ++dx) {
          const std::int32_t next = at[cell_of[component[i]] + dy * bgr.cols + dx];
          if (next < 0 || seen[next]) continue;
          seen[next] = 1;
          component.push_back(next);
        }
      }
    }
    if (!strong || static_cast<int>(component.size()) < kMinComponentPx) continue;
    for (std::int32_t p : component) keep[p] = 1;
  }
  std::size_t kept = 0;
  for (std::size_t i = 0; i < points.size(); ++i) {
    if (keep[i]) points[kept++] = points[i];
  }
  points.resize(kept);
  return points;
}

}  // namespace horopter
