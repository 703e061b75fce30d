#include "server/vision/reconstruction/point_planes.h"

#include <gtest/gtest.h>

#include <random>

namespace horopter {
namespace {

constexpr double kTolerance = 0.01;

// Points on a floor, on a table 0.2 above a part of it, and scattered above.
std::vector<Eigen::Vector3d> Bench(unsigned seed, double noise) {
  std::mt19937 rng(seed);
  std::uniform_real_distribution<double> place(-0.5, 0.5);
  std::normal_distribution<double> off(0.0, noise);
  std::vector<Eigen::Vector3d> points;
  for (int k = 0; k < 200; ++k) points.emplace_back(place(rng), place(rng), off(rng));
  for (int k = 0; k < 60; ++k)
    points.emplace_back(0.4 * place(rng), 0.4 * place(rng), 0.2 + off(rng));
  for (int k = 0; k < 60; ++k)
    points.emplace_back(place(rng), place(rng), 0.3 + 0.4 * (place(rng) + 0.5));
  return points;
}

CalibratedView From(const Eigen::Vector3d& centre) {
  CalibratedView view;
  view.camera_from_scene.t = -centre;
  return view;
}

TEST(FindPointPlanes, FindsTheLargestFirst) {
  for (const double noise : {0.0, 0.002, 0.004}) {
    const std::vector<Eigen::Vector3d> points = Bench(5, noise);
    const auto planes = FindPointPlanes(points, kTolerance, PointPlaneOptions());
    ASSERT_GE(planes.size(), 2u) << "noise " << noise;
    EXPECT_GT(std::abs(planes[0].normal.z()), 0.999);
    EXPECT_NEAR(planes[0].offset, 0.0, 2.0 * noise + 1e-9);
    EXPECT_GT(std::abs(planes[1].normal.z()), 0.99);
    EXPECT_NEAR(std::abs(planes[1].offset), 0.2, 0.01);
    EXPECT_GE(planes[0].points.size(), planes[1].points.size());
  }
}

TEST(FindPointPlanes, WithoutAPlaneThereIsNone) {
  std::mt19937 rng(6);
  std::uniform_real_distribution<double> place(-0.5, 0.5);
  std::vector<Eigen::Vector3d> points;
  for (int k = 0; k < 100; ++k) points.emplace_back(place(rng), place(rng), place(rng));
  EXPECT_TRUE(FindPointPlanes(points, 0.001, PointPlaneOptions()).empty());
  EXPECT_TRUE(FindPointPlanes({}, 0.001, PointPlaneOptions()).empty());
  const std::vector<Eigen::Vector3d> one_place(100, Eigen::Vector3d(1, 2, 3));
  EXPECT_TRUE(FindPointPlanes(one_place, 0.001, PointPlaneOptions()).empty());
}

TEST(SupportingPlaneOf, IsTheOneThatThingsStandOn) {
  const std::vector<Eigen::Vector3d> points = Bench(7, 0.001);
  const std::vector<std::optional<CalibratedView>> above = {
      From({0, 0, 1}), std::nullopt, From({0.5, 0, 1.2})};
  auto planes = FindPointPlanes(points, kTolerance, PointPlaneOptions());
  const int support = SupportingPlaneOf(points, above, kTolerance, PointPlaneOptions(), &planes);
  ASSERT_EQ(support, 0);
  EXPECT_GT(planes[0].normal.z(), 0.999);
  // Cameras on both sides: it is no plane that things stand on.
  const std::vector<std::optional<CalibratedView>> around = {From({0, 0, 1}), From({0, 0, -1})};
  EXPECT_EQ(SupportingPlaneOf(points, around, kTolerance, PointPlaneOptions(), &planes), -1);
}

}  // namespace
}  // namespace horopter
