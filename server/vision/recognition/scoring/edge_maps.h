// Oriented distance maps of one image's edges: what a projected model edge is compared with.
#pragma once

#include <Eigen/Core>
#include <cmath>
#include <cstdint>
#include <vector>

#include "server/vision/features/features.h"

namespace horopter {

// Unoriented direction bins of 22.5 degrees; bin b is centred on b * pi / 8.
inline constexpr int kOrientationBins = 8;

// An edge point with the direction of its edge (radians, modulo pi), pixels of the original image.
struct EdgePoint {
  Eigen::Vector2f point = Eigen::Vector2f::Zero();
  float direction = 0.0f;
};

// Working pixels: the image scaled so that its width is at most kWorkingWidth; thresholds of
// recognition are in working pixels. Per bin, the nearest map has one cell per working pixel, the
// index of the nearest edge point whose direction is within about 33 degrees of the bin; the
// distance map has one cell per 2 x 2 working pixels, the mean of their distances (working pixels *
// kDistanceScale, saturated). The latter is asked at random millions of times: small enough for a
// core's own cache.
struct EdgeMaps {
  static constexpr int kWorkingWidth = 640;             // px
  static constexpr float kDistanceScale = 8.0f;         // steps of 1/8 px in a byte
  static constexpr float kMaxDistance = 255.0f / 8.0f;  // working px that a byte holds

  int width = 0;  // cells
  int height = 0;
  double working_from_image = 1.0;  // scale, both about pixel centres
  std::vector<EdgePoint> points;    // in image pixels
  int half_width = 0;               // cells of the distance map
  int half_height = 0;
  std::vector<std::uint8_t> distance;  // [bin][half cell]
  std::vector<std::int32_t> nearest;   // [bin][cell], -1: none within kMaxDistance

  std::size_t Cell(int x, int y) const { return static_cast<std::size_t>(y) * width + x; }
  // Distance in working pixels for a projected point (image pixels) with an image direction;
  // kMaxDistance outside.
  float DistanceAt(float x, float y, int bin) const {
    // (u + 0.5) / 2 with u the working pixel, whose centre is a whole number.
    const float hx = x * half_scale_f + 0.25f, hy = y * half_scale_f + 0.25f;
    // In floats: points near the camera plane project beyond what an int holds.
    if (!(x >= 0 && y >= 0 && hx < static_cast<float>(half_width) &&
          hy < static_cast<float>(half_height))) {
      return kMaxDistance;
    }
    const int cx = static_cast<int>(hx), cy = static_cast<int>(hy);
    return distance[(static_cast<std::size_t>(bin) * half_height + cy) * half_width + cx] *
           (1.0f / kDistanceScale);
  }
  float scale_f = 1.0f;
  float half_scale_f = 0.5f;
};

// Bin of a direction vector (sign does not matter, need not be of unit length). Comparisons with
// the tangents of the bin borders: called for every projected sample, atan2 would dominate.
inline int OrientationBin(float dx, float dy) {
  const float ax = std::abs(dx), ay = std::abs(dy);
  const int q = (ay > 0.19891237f * ax) + (ay > 0.66817864f * ax) + (ay > 1.49660576f * ax) +
                (ay > 5.02733949f * ax);
  return (dx < 0) == (dy < 0) ? q : (kOrientationBins - q) % kOrientationBins;
}

// The edge points of an image's segments and chains, about one per pixel of length.
std::vector<EdgePoint> CollectEdgePoints(const ImageFeatures& features);

// Builds the maps from the chains and segments of an image. Linear in cells + points; the bins are
// shared out over `threads`.
EdgeMaps BuildEdgeMaps(const ImageFeatures& features, int threads = 1);

// The same from chosen edge points of an image of this size (pixels).
EdgeMaps BuildEdgeMaps(std::vector<EdgePoint> points, int width, int height, int threads = 1);

}  // namespace horopter
