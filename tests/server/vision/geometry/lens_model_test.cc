#include "server/vision/geometry/lens_model.h"

#include <gtest/gtest.h>

#include <Eigen/Geometry>
#include <cmath>
#include <random>

namespace horopter {
namespace {

TEST(LensModel, WithoutCoefficientsItIsAPinholeWithItsTwoFocalLengths) {
  const LensModel lens{LensModel::Kind::kPlumbBob, 600.0, 620.0, 320.0, 240.0, {}};
  const Eigen::Vector2d pixel = DistortedPixel(lens, {0.1, -0.2});
  EXPECT_NEAR(pixel.x(), 380.0, 1e-12);
  EXPECT_NEAR(pixel.y(), 116.0, 1e-12);
}

// A fisheye without coefficients: the distance from the centre is the angle times the focal length.
TEST(LensModel, AnEquidistantLensMapsAnglesToDistances) {
  const LensModel lens{LensModel::Kind::kEquidistant, 300.0, 300.0, 0.0, 0.0, {}};
  for (const double angle : {0.0, 0.1, 0.7, 1.4}) {
    const Eigen::Vector2d ray = std::tan(angle) * Eigen::Vector2d(0.6, 0.8);
    EXPECT_NEAR(DistortedPixel(lens, ray).norm(), 300.0 * angle, 1e-9);
  }
}

// The formulas of OpenCV's and ROS's documentation, term by term.
TEST(LensModel, TermsOfThePlumbBobAreInTheOrderOfRos) {
  const double x = 0.3, y = -0.2, r2 = x * x + y * y;
  const auto moved = [&](int coefficient) {
    LensModel lens;
    lens.coefficients[coefficient] = 1.0;
    return Eigen::Vector2d(DistortedPixel(lens, {x, y}) - Eigen::Vector2d(x, y));
  };
  const Eigen::Vector2d n(x, y);
  EXPECT_LT((moved(0) - r2 * n).norm(), 1e-12);
  EXPECT_LT((moved(1) - r2 * r2 * n).norm(), 1e-12);
  EXPECT_LT((moved(2) - Eigen::Vector2d(2 * x * y, r2 + 2 * y * y)).norm(), 1e-12);
  EXPECT_LT((moved(3) - Eigen::Vector2d(r2 + 2 * x * x, 2 * x * y)).norm(), 1e-12);
  EXPECT_LT((moved(4) - r2 * r2 * r2 * n).norm(), 1e-12);
}

// Radial distortion knows no direction.
TEST(LensModel, ARadialLensCommutesWithTurnsAboutItsAxis) {
  constexpr unsigned kSeed = 4;
  std::mt19937 rng(kSeed);
  std::uniform_real_distribution<double> uniform(-0.5, 0.5);
  for (const auto kind : {LensModel::Kind::kPlumbBob, LensModel::Kind::kEquidistant}) {
    LensModel lens;
    lens.kind = kind;
    lens.coefficients = {-0.2, 0.05, 0.0, 0.0, 0.01};
    for (int i = 0; i < 100; ++i) {
      const Eigen::Rotation2Dd turn(6.0 * uniform(rng));
      const Eigen::Vector2d n(uniform(rng), uniform(rng));
      EXPECT_LT((DistortedPixel(lens, turn * n) - turn * DistortedPixel(lens, n)).norm(), 1e-12)
          << "seed " << kSeed;
    }
  }
}

}  // namespace
}  // namespace horopter
