#include "server/vision/features/conic_fit.h"

#include <gtest/gtest.h>

#include <Eigen/Eigenvalues>
#include <Eigen/LU>
#include <algorithm>
#include <cmath>
#include <functional>
#include <limits>
#include <random>

namespace horopter {
namespace {

using Points = std::vector<Eigen::Vector2f>;
using Vector5 = Eigen::Matrix<double, 5, 1>;

// Curve points moved by noise in both coordinates, turned and shifted.
Points Sample(const std::function<Eigen::Vector2d(double)>& curve,
              double from,
              double to,
              int count,
              double turn,
              const Eigen::Vector2d& shift,
              double noise,
              std::mt19937* rng) {
  std::normal_distribution<double> normal(0.0, 1.0);
  Points points;
  for (int k = 0; k < count; ++k) {
    const Eigen::Vector2d p = curve(from + (to - from) * k / (count - 1));
    const Eigen::Vector2d e(normal(*rng), normal(*rng));
    points.push_back((Eigen::Vector2d(std::cos(turn) * p.x() - std::sin(turn) * p.y(),
                                      std::sin(turn) * p.x() + std::cos(turn) * p.y()) +
                      shift + noise * e)
                         .cast<float>());
  }
  return points;
}

Points SampleArc(const EllipseArc& e, int count, double noise, std::mt19937* rng) {
  return Sample(
      [&](double t) {
        return Eigen::Vector2d(e.semi_major_px * std::cos(t), e.semi_minor_px * std::sin(t));
      },
      e.start_rad,
      e.start_rad + e.sweep_rad,
      count,
      e.angle_rad,
      e.center,
      noise,
      rng);
}

EllipseArc RandomArc(double sweep, std::mt19937* rng) {
  std::uniform_real_distribution<double> u(0.0, 1.0);
  EllipseArc e;
  e.center = {600 * u(*rng), 400 * u(*rng)};
  e.semi_major_px = 25 + 60 * u(*rng);
  e.semi_minor_px = e.semi_major_px * (0.4 + 0.5 * u(*rng));
  e.angle_rad = M_PI * (u(*rng) - 0.5);
  e.start_rad = 6.0 * u(*rng);
  e.sweep_rad = sweep;
  return e;
}

// Truth about which ellipse this is, with the axes named as `like` names them.
Vector5 Difference(const EllipseArc& fit, const EllipseArc& truth) {
  Vector5 d;
  d << fit.center - truth.center, fit.semi_major_px - truth.semi_major_px,
      fit.semi_minor_px - truth.semi_minor_px,
      std::remainder(fit.angle_rad - truth.angle_rad, M_PI);
  return d;
}

TEST(NearestOnEllipse, IsOnTheEllipseAndNoPointOfItIsNearer) {
  std::mt19937 rng(31);
  std::uniform_real_distribution<double> u(-1.0, 1.0);
  for (int trial = 0; trial < 300; ++trial) {
    EllipseArc e = RandomArc(6.28, &rng);
    if (trial % 5 == 0) e.semi_minor_px = e.semi_major_px;
    if (trial % 5 == 1) e.semi_minor_px = 0.01 * e.semi_major_px;
    Eigen::Vector2d p = e.center + 120.0 * Eigen::Vector2d(u(rng), u(rng));
    if (trial % 7 == 0) p = e.center;
    if (trial % 7 == 1) {  // on the major axis, where the nearest point may leave it
      p = e.center +
          u(rng) * e.semi_major_px * Eigen::Vector2d(std::cos(e.angle_rad), std::sin(e.angle_rad));
    }
    const Eigen::Vector2d foot = NearestOnEllipse(e, p);
    EXPECT_LT(EllipseDistance(e, foot), 1e-6);
    double nearest = 1e9;
    for (int k = 0; k < 2000; ++k) {
      const double t = 2 * M_PI * k / 2000, c = std::cos(e.angle_rad), s = std::sin(e.angle_rad);
      const double x = e.semi_major_px * std::cos(t), y = e.semi_minor_px * std::sin(t);
      nearest =
          std::min(nearest, (e.center + Eigen::Vector2d(c * x - s * y, s * x + c * y) - p).norm());
    }
    EXPECT_LE((foot - p).norm(), nearest + 1e-9);
  }
}

class ConicNoise : public testing::TestWithParam<double> {};

TEST_P(ConicNoise, EllipsoidOfTheEllipseHoldsTheTruth) {
  std::mt19937 rng(35 + static_cast<unsigned>(1000 * GetParam()));
  for (double sweep : {1.8, 2.5, 6.2}) {
    int inside = 0;
    constexpr int kTrials = 1000;
    Vector5 single = Vector5::Zero();
    for (int trial = 0; trial < kTrials; ++trial) {
      const EllipseArc truth = RandomArc(sweep, &rng);
      const auto fit = FitEllipseGeometric(SampleArc(truth, 120, GetParam(), &rng), {});
      ASSERT_TRUE(fit.ok()) << fit.status();
      const Vector5 d = Difference(fit->arc, truth);
      inside += d.dot(fit->covariance.ldlt().solve(d)) < 11.07;
      single.array() +=
          (d.array().abs() < 1.96 * fit->covariance.diagonal().array().sqrt()).cast<double>();
    }
    std::printf("noise %.2f sweep %.1f: in 95%% %.3f; one by one",
                GetParam(),
                sweep,
                1.0 * inside / kTrials);
    for (int k = 0; k < 5; ++k) std::printf(" %.3f", single[k] / kTrials);
    std::printf("\n");
    for (int k = 0; k < 5; ++k) {
      EXPECT_GE(single[k] / kTrials, 0.93) << sweep << " " << k;
      EXPECT_LE(single[k] / kTrials, 0.97) << sweep << " " << k;
    }
    // A shorter arc's centre and axes err together along a bent curve, which no ellipsoid follows.
    if (sweep < 2.0) continue;
    EXPECT_GE(1.0 * inside / kTrials, 0.93) << sweep;
    EXPECT_LE(1.0 * inside / kTrials, 0.97) << sweep;
  }
}

INSTANTIATE_TEST_SUITE_P(Px, ConicNoise, testing::Values(0.05, 0.1, 0.2));

TEST(FitEllipseGeometric, IsNearerTheTruthThanTheDirectFitOnShortArcs) {
  std::mt19937 rng(37);
  double direct = 0.0, geometric = 0.0, noise = 0.0;
  for (int trial = 0; trial < 300; ++trial) {
    const EllipseArc truth = RandomArc(2.0, &rng);
    const Points points = SampleArc(truth, 100, 0.2, &rng);
    const auto fit = FitEllipseGeometric(points, {});
    ASSERT_TRUE(fit.ok());
    direct += std::abs(FitEllipse(points)->semi_major_px - truth.semi_major_px);
    geometric += std::abs(fit->arc.semi_major_px - truth.semi_major_px);
    noise += fit->sigma_px;
    EXPECT_NEAR(fit->arc.sweep_rad, 2.0, 0.5);
  }
  std::printf(
      "mean semi-major error: direct %.3f, geometric %.3f\n", direct / 300, geometric / 300);
  EXPECT_LT(geometric, direct);
  EXPECT_NEAR(noise / 300, 0.2, 0.01);
}

TEST(FitEllipseGeometric, GivesBackWhatBlurTakesFromACurvedEdge) {
  std::mt19937 rng(42);
  for (int trial = 0; trial < 50; ++trial) {
    const EllipseArc truth = RandomArc(6.2, &rng);
    const double a = truth.semi_major_px, b = truth.semi_minor_px, blur = 1.5;
    // The edge lies inside by curvature x sigma^2 / 2 along the normal.
    const Points points = Sample(
        [&](double t) {
          const Eigen::Vector2d n = Eigen::Vector2d(std::cos(t) / a, std::sin(t) / b).normalized();
          const double root = std::hypot(b * std::cos(t), a * std::sin(t));
          const double curvature = a * b / (root * root * root);
          return Eigen::Vector2d(Eigen::Vector2d(a * std::cos(t), b * std::sin(t)) -
                                 0.5 * blur * blur * curvature * n);
        },
        0.0,
        6.2,
        200,
        truth.angle_rad,
        truth.center,
        0.0,
        &rng);
    ConicFitOptions options;
    const auto plain = FitEllipseGeometric(points, options);
    options.blur_sigma_px = blur;
    const auto fit = FitEllipseGeometric(points, options);
    ASSERT_TRUE(plain.ok() && fit.ok());
    EXPECT_LT(Difference(fit->arc, truth).head<4>().norm(), 0.005);
    EXPECT_GT(Difference(plain->arc, truth).head<4>().norm(), 0.01);
  }
}

TEST(FitEllipseGeometric, OfACircleHasAFiniteCovarianceWithAnUnknownAngle) {
  std::mt19937 rng(38);
  EllipseArc circle = RandomArc(6.28, &rng);
  circle.semi_minor_px = circle.semi_major_px;
  const auto fit = FitEllipseGeometric(SampleArc(circle, 200, 0.1, &rng), {});
  ASSERT_TRUE(fit.ok());
  EXPECT_TRUE(fit->covariance.allFinite());
  EXPECT_GT(fit->covariance(4, 4), 0.01);
  EXPECT_LE(fit->covariance(4, 4), 0.83);
  EXPECT_LT(fit->covariance(0, 0), 0.01);
}

TEST(FitEllipseGeometric, CorrelatedNoiseWidensTheCovariance) {
  std::mt19937 rng(39);
  std::normal_distribution<double> normal(0.0, 0.2);
  int inside = 0, inside_plain = 0;
  constexpr int kTrials = 600;
  for (int trial = 0; trial < kTrials; ++trial) {
    const EllipseArc truth = RandomArc(6.0, &rng);
    Points points = SampleArc(truth, 200, 0.0, &rng);
    double level = normal(rng);
    for (Eigen::Vector2f& p : points) {  // first order, correlation 0.5 from point to point
      level = 0.5 * level + std::sqrt(0.75) * normal(rng);
      const Eigen::Vector2d out = (p.cast<double>() - truth.center).normalized();
      p += (level * out).cast<float>();
    }
    ConicFitOptions options;
    const auto inside_with = [&] {
      const auto fit = FitEllipseGeometric(points, options);
      const Vector5 d = Difference(fit->arc, truth);
      return d.dot(fit->covariance.ldlt().solve(d)) < 11.07;
    };
    inside_plain += inside_with();
    options.correlated_noise = true;
    inside += inside_with();
  }
  std::printf("correlated noise: in 95%% %.3f, taken as independent %.3f\n",
              1.0 * inside / kTrials,
              1.0 * inside_plain / kTrials);
  EXPECT_GE(1.0 * inside / kTrials, 0.88);
  EXPECT_LT(1.0 * inside_plain / kTrials, 0.75);
}

TEST(FitEllipseGeometric, RefusesWhatDeterminesNoEllipse) {
  const Points same(30, Eigen::Vector2f(7, 9));
  EXPECT_EQ(FitEllipseGeometric(same, {}).status().code(), absl::StatusCode::kFailedPrecondition);
  Points few = {{0, 0}, {1, 0}, {2, 1}, {0, 3}, {5, 5}};
  EXPECT_EQ(FitEllipseGeometric(few, {}).status().code(), absl::StatusCode::kInvalidArgument);
  few.emplace_back(std::numeric_limits<float>::quiet_NaN(), 0);
  EXPECT_EQ(FitEllipseGeometric(few, {}).status().code(), absl::StatusCode::kInvalidArgument);
  ConicFitOptions options;
  options.sigma_px = -1;
  EXPECT_EQ(FitEllipseGeometric(same, options).status().code(), absl::StatusCode::kInvalidArgument);
  options = {};
  options.blur_sigma_px = std::numeric_limits<double>::quiet_NaN();
  EXPECT_EQ(FitEllipseGeometric(same, options).status().code(), absl::StatusCode::kInvalidArgument);
}

TEST(FitEllipseGeometric, AnyPointsGiveAnErrorOrFiniteNumbers) {
  std::mt19937 rng(41);
  std::uniform_real_distribution<float> u(-1.0f, 1.0f);
  for (int trial = 0; trial < 400; ++trial) {
    Points points;
    const float size = std::pow(10.0f, 8.0f * u(rng));
    for (int k = 0; k < 6 + trial % 20; ++k) {
      points.emplace_back(size * u(rng), size * u(rng) * (trial % 3 == 0 ? 1e-3f : 1.0f));
    }
    if (const auto fit = FitEllipseGeometric(points, {}); fit.ok()) {
      EXPECT_TRUE(fit->covariance.allFinite() && std::isfinite(fit->arc.semi_major_px));
      EXPECT_GE(fit->arc.semi_major_px, fit->arc.semi_minor_px);
    }
  }
}

}  // namespace
}  // namespace horopter
