#include "server/vision/recognition/aspects/strewn_dots.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdint>

namespace horopter {
namespace {

constexpr int kSectors = 8;     // around a curve
constexpr int kRays = 3;        // of a sector: what stands between two dots is seen by one
constexpr float kOwnPx = 3.0f;  // from a curve on: its own edge is passed
constexpr float kFarthestPx = 60.0f;
// Of the middle clearance; of so many sectors. Holes of a plate on spots (parts-dev, scene 16,
// blurred) have three and more beyond 4 times, spots hardly any.
constexpr float kClear = 3.0f;
constexpr int kClearSectors = 2;

// Cells that hold an edge or one that was dropped, and those beside them.
std::vector<std::uint8_t> Occupied(const PointRaster& raster,
                                   const std::vector<Eigen::Vector2f>& texture) {
  std::vector<std::uint8_t> out(raster.at.size(), 0);
  const auto mark = [&](const Eigen::Vector2f& p) {
    const int cx = static_cast<int>(std::lround(p.x())), cy = static_cast<int>(std::lround(p.y()));
    for (int y = std::max(0, cy - 1); y <= std::min(raster.height - 1, cy + 1); ++y) {
      for (int x = std::max(0, cx - 1); x <= std::min(raster.width - 1, cx + 1); ++x)
        out[static_cast<std::size_t>(y) * raster.width + x] = 1;
    }
  };
  for (const Eigen::Vector2f& p : raster.points) mark(p);
  for (const Eigen::Vector2f& p : texture) mark(p);
  return out;
}

// px from the curve to the nearest edge in each sector; what lies outside the image is as near as
// can be.
std::array<float, kSectors> Clearances(const PointRaster& raster,
                                       const std::vector<std::uint8_t>& occupied,
                                       const std::vector<Eigen::Vector2f>& curve) {
  constexpr float kTurn = 6.2831853f / (kSectors * kRays);
  std::array<float, kSectors> out;
  out.fill(kFarthestPx);
  Eigen::Vector2f middle = Eigen::Vector2f::Zero();
  for (const Eigen::Vector2f& p : curve) middle += p / static_cast<float>(curve.size());
  for (int ray = 0; ray < kSectors * kRays; ++ray) {
    const float angle = kTurn * static_cast<float>(ray);
    const Eigen::Vector2f along(std::cos(angle), std::sin(angle));
    float from = 0.0f;
    for (const Eigen::Vector2f& p : curve) from = std::max(from, along.dot(p - middle));
    float& clearance = out[ray / kRays];
    for (float t = kOwnPx; t < clearance; t += 1.0f) {
      const Eigen::Vector2f at = middle + (from + t) * along;
      const int x = static_cast<int>(std::lround(at.x())),
                y = static_cast<int>(std::lround(at.y()));
      const bool outside = x < 0 || y < 0 || x >= raster.width || y >= raster.height;
      if (outside || occupied[static_cast<std::size_t>(y) * raster.width + x]) clearance = t;
    }
  }
  return out;
}

}  // namespace

std::vector<char> AmongOthers(const PointRaster& raster,
                              const std::vector<Eigen::Vector2f>& texture,
                              const std::vector<std::vector<Eigen::Vector2f>>& curves) {
  const std::vector<std::uint8_t> occupied = Occupied(raster, texture);
  std::vector<std::array<float, kSectors>> clearances;
  std::vector<float> all;
  for (const std::vector<Eigen::Vector2f>& curve : curves) {
    clearances.push_back(Clearances(raster, occupied, curve));
    all.insert(all.end(), clearances.back().begin(), clearances.back().end());
  }
  if (all.empty()) return {};
  std::nth_element(all.begin(), all.begin() + all.size() / 2, all.end());
  const float clear = kClear * all[all.size() / 2];
  std::vector<char> out;
  for (const auto& of_curve : clearances) {
    const auto sectors =
        std::count_if(of_curve.begin(), of_curve.end(), [&](float c) { return c > clear; });
    out.push_back(sectors < kClearSectors);
  }
  return out;
}

}  // namespace horopter
