#include "server/vision/recognition/aspects/strewn_dots.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <cstdint>

#include "tests/support/random.h"

namespace horopter {
namespace {

constexpr int kWidth = 640, kHeight = 480;
constexpr std::uint64_t kSeeds = 5;

std::vector<Eigen::Vector2f> Circle(const Eigen::Vector2f& middle, float radius) {
  std::vector<Eigen::Vector2f> out;
  const int n = static_cast<int>(6.3f * radius);
  for (int i = 0; i < n; ++i) {
    const float a = 6.2831853f * static_cast<float>(i) / static_cast<float>(n);
    out.push_back(middle + radius * Eigen::Vector2f(std::cos(a), std::sin(a)));
  }
  return out;
}

// Spots at random places but for a plate, and the plate's five holes and its outline.
struct Plate {
  std::vector<std::vector<Eigen::Vector2f>> spots, holes;
  std::vector<Eigen::Vector2f> edges;
};

Plate PlateOnSpots(std::uint64_t seed) {
  Plate out;
  Random random(seed);
  const Eigen::Vector2f middle(320, 240);
  const float half = 60;
  for (int trial = 0; trial < 4000; ++trial) {
    const Eigen::Vector2f at(static_cast<float>(random.Uniform(10, kWidth - 10)),
                             static_cast<float>(random.Uniform(10, kHeight - 10)));
    const float radius = static_cast<float>(random.Uniform(4, 7));
    const bool before = (at - middle).cwiseAbs().maxCoeff() < half + radius + 2;
    const bool taken = std::any_of(out.spots.begin(), out.spots.end(), [&](const auto& spot) {
      return std::any_of(spot.begin(), spot.end(), [&](const Eigen::Vector2f& p) {
        return (p - at).norm() < radius + 3;
      });
    });
    if (!before && !taken) out.spots.push_back(Circle(at, radius));
  }
  out.holes.push_back(Circle(middle, 12));
  for (const float x : {-40.0f, 40.0f}) {
    for (const float y : {-40.0f, 40.0f})
      out.holes.push_back(Circle(middle + Eigen::Vector2f(x, y), 5));
  }
  for (const auto* list : {&out.spots, &out.holes}) {
    for (const auto& curve : *list) out.edges.insert(out.edges.end(), curve.begin(), curve.end());
  }
  for (float t = -half; t <= half; t += 1.0f) {
    for (const float side : {-half, half}) {
      out.edges.push_back(middle + Eigen::Vector2f(t, side));
      out.edges.push_back(middle + Eigen::Vector2f(side, t));
    }
  }
  return out;
}

TEST(StrewnDots, SpotsStandAmongOthersAndHolesOfAPlateDoNot) {
  for (std::uint64_t seed = 1; seed <= kSeeds; ++seed) {
    SCOPED_TRACE(seed);
    const Plate plate = PlateOnSpots(seed);
    ASSERT_GT(plate.spots.size(), 200u);
    std::vector<std::vector<Eigen::Vector2f>> curves = plate.spots;
    curves.insert(curves.end(), plate.holes.begin(), plate.holes.end());
    const PointRaster raster = MakePointRaster(kWidth, kHeight, plate.edges);
    const std::vector<char> among = AmongOthers(raster, {}, curves);
    ASSERT_EQ(among.size(), curves.size());
    const auto spots = among.begin() + static_cast<std::ptrdiff_t>(plate.spots.size());
    EXPECT_GT(std::count(among.begin(), spots, 1), 0.95 * static_cast<double>(plate.spots.size()));
    EXPECT_EQ(std::count(spots, among.end(), 1), 0);
  }
}

TEST(StrewnDots, WhatWasDroppedAsTextureIsNear) {
  const std::uint64_t seed = 1;
  SCOPED_TRACE(seed);
  const Plate plate = PlateOnSpots(seed);
  std::vector<Eigen::Vector2f> only, rest;
  for (const auto& hole : plate.holes) only.insert(only.end(), hole.begin(), hole.end());
  for (const auto& spot : plate.spots) only.insert(only.end(), spot.begin(), spot.end());
  for (float y = 181; y < 300; y += 6) {
    for (float x = 261; x < 380; x += 6) rest.emplace_back(x, y);
  }
  std::vector<std::vector<Eigen::Vector2f>> curves = plate.spots;
  curves.insert(curves.end(), plate.holes.begin(), plate.holes.end());
  const std::vector<char> among = AmongOthers(MakePointRaster(kWidth, kHeight, only), rest, curves);
  EXPECT_EQ(std::count(among.end() - 5, among.end(), 1), 5);
}

TEST(StrewnDots, NoneOfNone) {
  EXPECT_TRUE(AmongOthers(MakePointRaster(kWidth, kHeight, {}), {}, {}).empty());
}

}  // namespace
}  // namespace horopter
