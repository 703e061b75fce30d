#include "server/vision/station/base_filter.h"

#include <gtest/gtest.h>

#include <cmath>
#include <random>

namespace horopter {
namespace {

const StationOptions kOptions;

Rigid3 Truth() {
  return {RotationFromVector({2.0, -0.3, 0.4}), {0.4, -0.2, 0.9}};
}

CameraBase Seen(std::mt19937& rng, double sigma_rad, double sigma_m) {
  std::normal_distribution<double> normal;
  Vector6d d;
  for (int i = 0; i < 6; ++i) d(i) = (i < 3 ? sigma_rad : sigma_m) * normal(rng);
  UncertainPose pose{Perturbed(Truth(), d), Matrix6d::Zero()};
  pose.covariance.diagonal().head<3>().setConstant(sigma_rad * sigma_rad);
  pose.covariance.diagonal().tail<3>().setConstant(sigma_m * sigma_m);
  return BaseSeen(pose, kOptions);
}

double Off(const CameraBase& base) {
  return (base.base_from_camera.t - Truth().t).norm();
}

TEST(BaseFilter, ABetterReferenceCorrectsABase) {
  std::mt19937 rng(3);
  double before = 0.0, after = 0.0;
  for (int i = 0; i < 50; ++i) {
    CameraBase known = Seen(rng, 0.01, 0.01);
    before += Off(known);
    const CameraBase better = Seen(rng, 0.001, 0.0005);
    ASSERT_TRUE(TestBase(known, better, kOptions).agrees);
    known = UpdateBase(known, better, kOptions);
    after += Off(known);
    EXPECT_LT(known.position_sigma_m, 0.0006);
    EXPECT_LT(known.rotation_sigma_rad, 0.0012);
    EXPECT_EQ(known.requests, 2);
    EXPECT_LT((known.base_from_camera.R * known.base_from_camera.R.transpose() -
               Eigen::Matrix3d::Identity())
                  .norm(),
              1e-9);
  }
  EXPECT_LT(after, 0.2 * before);
}

TEST(BaseFilter, AWorseReferenceMovesItLittle) {
  std::mt19937 rng(4);
  const CameraBase known = Seen(rng, 0.0005, 0.0005);
  const CameraBase worse = Seen(rng, 0.02, 0.02);
  const CameraBase updated = UpdateBase(known, worse, kOptions);
  EXPECT_LT((updated.base_from_camera.t - known.base_from_camera.t).norm(),
            0.01 * (worse.base_from_camera.t - known.base_from_camera.t).norm());
}

// 300 requests of one base, each honest about its deviations: none is taken for a move, and the
// deviation that is stated is kept.
TEST(BaseFilter, HonestReferencesNeverMoveIt) {
  std::mt19937 rng(5);
  CameraBase known = Seen(rng, 0.003, 0.002);
  int beyond = 0;
  for (int i = 0; i < 300; ++i) {
    const CameraBase seen = Seen(rng, 0.003, 0.002);
    ASSERT_TRUE(TestBase(known, seen, kOptions).agrees) << i;
    known = UpdateBase(known, seen, kOptions);
    beyond += Off(known) > 3.0 * std::sqrt(3.0) * known.position_sigma_m;
  }
  EXPECT_LT(beyond, 10);
  EXPECT_LT(Off(known), 0.001);
}

TEST(BaseFilter, AMoveBeyondTheHistorysDeviationIsSeenAndASmallOneIsNot) {
  std::mt19937 rng(6);
  CameraBase known = Seen(rng, 0.001, 0.001);
  for (int i = 0; i < 20; ++i) known = UpdateBase(known, Seen(rng, 0.001, 0.001), kOptions);
  CameraBase moved = Seen(rng, 0.001, 0.001);
  moved.base_from_camera.t.x() += 0.02;
  const BaseTest test = TestBase(known, moved, kOptions);
  EXPECT_FALSE(test.agrees);
  EXPECT_NEAR(test.shift_m, 0.02, 0.005);
  EXPECT_GT(test.squared, test.limit);
  // Turned in place.
  moved = Seen(rng, 0.001, 0.001);
  moved.base_from_camera.R = RotationFromVector({0.0, 0.0, 0.05}) * moved.base_from_camera.R;
  EXPECT_FALSE(TestBase(known, moved, kOptions).agrees);
  // Less than anybody would act on, however sure both are.
  moved = known;
  moved.base_from_camera.t.x() += 0.5 * kLeastBaseShiftM;
  EXPECT_TRUE(TestBase(known, moved, kOptions).agrees);
}

TEST(BaseFilter, WhatPeopleSaidStays) {
  std::mt19937 rng(7);
  CameraBase given;
  given.base_from_camera = Truth();
  const CameraBase after = UpdateBase(given, Seen(rng, 1e-3, 1e-3), kOptions);
  EXPECT_TRUE(after.base_from_camera.t == given.base_from_camera.t);
  EXPECT_EQ(after.requests, 0);
  EXPECT_FALSE(after.learnt);
}

}  // namespace
}  // namespace horopter
