#include "server/vision/features/ellipse_fit.h"

#include <gtest/gtest.h>

#include <cmath>
#include <random>

namespace horopter {
namespace {

std::vector<Eigen::Vector2f> Sample(const EllipseArc& e,
                                    int count,
                                    double noise,
                                    std::mt19937* rng) {
  std::normal_distribution<double> normal(0.0, noise > 0.0 ? noise : 1.0);
  std::vector<Eigen::Vector2f> points;
  for (int k = 0; k < count; ++k) {
    const double t = e.start_rad + e.sweep_rad * k / (count - 1);
    const double x = e.semi_major_px * std::cos(t), y = e.semi_minor_px * std::sin(t);
    Eigen::Vector2d p(e.center.x() + std::cos(e.angle_rad) * x - std::sin(e.angle_rad) * y,
                      e.center.y() + std::sin(e.angle_rad) * x + std::cos(e.angle_rad) * y);
    if (noise > 0.0) {
      p += Eigen::Vector2d(normal(*rng), normal(*rng));
    }
    points.push_back(p.cast<float>());
  }
  return points;
}

EllipseArc RandomArc(std::mt19937* rng, double sweep) {
  std::uniform_real_distribution<double> u(0.0, 1.0);
  EllipseArc e;
  e.center = {600 * u(*rng), 400 * u(*rng)};
  e.semi_major_px = 15 + 80 * u(*rng);
  e.semi_minor_px = e.semi_major_px * (0.25 + 0.7 * u(*rng));
  e.angle_rad = M_PI * (u(*rng) - 0.5);
  e.start_rad = 6.0 * u(*rng);
  e.sweep_rad = sweep;
  return e;
}

TEST(FitEllipse, ExactPointsGiveTheEllipseBackInAnyOrientationAndDirection) {
  std::mt19937 rng(1);
  for (int trial = 0; trial < 200; ++trial) {
    SCOPED_TRACE(trial);
    const EllipseArc truth = RandomArc(&rng, 2.5);
    std::vector<Eigen::Vector2f> points = Sample(truth, 60, 0.0, &rng);
    if (trial % 2 == 1) {
      std::reverse(points.begin(), points.end());
    }
    const auto fit = FitEllipse(points);
    ASSERT_TRUE(fit.has_value());
    EXPECT_LT((fit->center - truth.center).norm(), 0.05);
    EXPECT_NEAR(fit->semi_major_px, truth.semi_major_px, 0.05);
    EXPECT_NEAR(fit->semi_minor_px, truth.semi_minor_px, 0.05);
    EXPECT_LT(std::abs(std::remainder(fit->angle_rad - truth.angle_rad, M_PI)), 0.02);
    EXPECT_NEAR(fit->sweep_rad, truth.sweep_rad, 0.01);
    EXPECT_LT(std::abs(std::remainder(
                  fit->start_rad +
                      (std::remainder(fit->angle_rad - truth.angle_rad, 2 * M_PI) > 1.5 ||
                               std::remainder(fit->angle_rad - truth.angle_rad, 2 * M_PI) < -1.5
                           ? M_PI
                           : 0.0) -
                      truth.start_rad,
                  2.0 * M_PI)),
              0.02);
    EXPECT_LT(fit->rms_px, 0.01);
  }
}

TEST(FitEllipse, RmsIsTheNoise) {
  std::mt19937 rng(2);
  for (int trial = 0; trial < 30; ++trial) {
    const auto fit = FitEllipse(Sample(RandomArc(&rng, 6.0), 300, 0.3, &rng));
    ASSERT_TRUE(fit.has_value());
    EXPECT_NEAR(fit->rms_px, 0.3, 0.06);
  }
}

TEST(FitEllipse, DegeneratePointsGiveNothingOrSomethingFinite) {
  std::vector<Eigen::Vector2f> points;
  EXPECT_FALSE(FitEllipse(points).has_value());
  points.assign(20, Eigen::Vector2f(5, 5));
  EXPECT_FALSE(FitEllipse(points).has_value());
  points.clear();
  for (int k = 0; k < 20; ++k) {
    points.emplace_back(k, 2 * k);
  }
  EXPECT_FALSE(FitEllipse(points).has_value());
  points = {{0, 0}, {1, 0}, {2, 0}, {3, 0}, {4, 0}};
  EXPECT_FALSE(FitEllipse(points).has_value());
  std::mt19937 rng(4);
  std::uniform_real_distribution<float> u(0.0f, 100.0f);
  for (int trial = 0; trial < 200; ++trial) {
    points.clear();
    for (int k = 0; k < 6 + trial % 10; ++k) {
      points.emplace_back(u(rng), u(rng));
    }
    if (const auto fit = FitEllipse(points)) {
      EXPECT_TRUE(fit->center.allFinite() && std::isfinite(fit->semi_major_px) &&
                  std::isfinite(fit->rms_px));
      EXPECT_GE(fit->semi_major_px, fit->semi_minor_px);
    }
  }
}

TEST(SpanOf, IsTheComplementOfTheLargestGap) {
  std::mt19937 rng(6);
  for (int trial = 0; trial < 50; ++trial) {
    EllipseArc truth = RandomArc(&rng, 4.0);
    std::vector<Eigen::Vector2f> points = Sample(truth, 200, 0.0, &rng);
    std::shuffle(points.begin(), points.end(), rng);
    EllipseArc arc = truth;
    EXPECT_EQ(SpanOf(points, &arc), 1.0);
    EXPECT_NEAR(arc.sweep_rad, 4.0, 0.18);  // bins of 5 degrees
    EXPECT_LT(std::abs(std::remainder(arc.start_rad - truth.start_rad, 2.0 * M_PI)), 0.1);
  }
}

}  // namespace
}  // namespace horopter
