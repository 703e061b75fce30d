// Oriented distance maps of one image's edges: what a projected model edge is held against.
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
// recognition are in working pixels. Map cells are working pixels; a cell holds the distance
// (working pixels * kDistanceScale, saturated) and the index of the nearest edge point whose
// direction is within about 33 degrees of the bin.
struct EdgeMaps {
  static constexpr int kWorkingWidth = 640;
  static constexpr float kDistanceScale = 8.0f;
  static constexpr float kMaxDistance = 255.0f / 8.0f;

  int width = 0;  // cells
  int height = 0;
  double working_from_image = 1.0;     // scale, both about pixel centres
  std::vector<EdgePoint> points;       // in image pixels
  std::vector<std::uint8_t> distance;  // [cell][bin]
  std::vector<std::int32_t> nearest;   // [bin][cell], -1: none within kMaxDistance

  std::size_t Cell(int x, int y) const { return static_cast<std::size_t>(y) * width + x; }
  // Distance in working pixels for a projected point (image pixels) with an image direction;
  // kMaxDistance outside.
  float DistanceAt(float x, float y, int bin) const {
    const int cx = static_cast<int>(x * scale_f + 0.5f);
    const int cy = static_cast<int>(y * scale_f + 0.5f);
    if (!(x >= 0 && y >= 0) || cx >= width || cy >= height) return kMaxDistance;
    return distance[Cell(cx, cy) * kOrientationBins + bin] * (1.0f / kDistanceScale);
  }
  float scale_f = 1.0f;
};

// Bin of a direction vector (sign does not matter, need not be of unit length). Comparisons with
// the tangents of the bin borders: called for every projected sample, atan2 would dominate.
inline int OrientationBin(float dx, float dy) {
  const float ax = std::abs(dx), ay = std::abs(dy);
  const int q = (ay > 0.19891237f * ax) + (ay > 0.66817864f * ax) + (ay > 1.49660576f * ax) +
                (ay > 5.02733949f * ax);
  return (dx < 0) == (dy < 0) ? q : (kOrientationBins - q) % kOrientationBins;
}

// Builds the maps from the chains and segments of an image. Linear in cells + points.
EdgeMaps BuildEdgeMaps(const ImageFeatures& features);

}  // namespace horopter
