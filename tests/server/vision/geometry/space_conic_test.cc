#include "server/vision/geometry/space_conic.h"

#include <gtest/gtest.h>

#include <Eigen/Dense>
#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <numbers>
#include <random>

namespace horopter {
namespace {

CalibratedCamera LookingAtOrigin(const Eigen::Vector3d& centre, double k1) {
  CalibratedCamera view;
  view.camera = CenteredCamera(640, 480, 700.0);
  view.camera.k1 = k1;
  const Eigen::Vector3d z = -centre.normalized();
  const Eigen::Vector3d x = z.cross(Eigen::Vector3d(0.1, 0.2, 1.0)).normalized();
  view.camera_from_scene.R << x.transpose(), z.cross(x).transpose(), z.transpose();
  view.camera_from_scene.t = -(view.camera_from_scene.R * centre);
  return view;
}

struct Trial {
  SpaceConic truth;
  std::vector<ConicSight> sights;
};

// A conic near the origin seen from about 0.6 m, `sweep` of it in each view, with noise.
Trial Draw(std::mt19937* rng, int views, bool circle, double noise_px, double sweep, double k1) {
  std::uniform_real_distribution<double> unit(-1.0, 1.0);
  std::normal_distribution<double> noise(0.0, 1.0);
  Trial out;
  const Eigen::Vector3d normal(0.5 * unit(*rng), 0.5 * unit(*rng), 1.0);
  out.truth.scene_from_conic.R =
      Eigen::Quaterniond::FromTwoVectors(Eigen::Vector3d::UnitZ(), normal).toRotationMatrix() *
      Eigen::AngleAxisd(3.0 * unit(*rng), Eigen::Vector3d::UnitZ()).toRotationMatrix();
  out.truth.scene_from_conic.t = 0.05 * Eigen::Vector3d(unit(*rng), unit(*rng), unit(*rng));
  out.truth.semi_major = 0.03 + 0.015 * unit(*rng);
  out.truth.semi_minor =
      circle ? out.truth.semi_major : (0.6 + 0.2 * unit(*rng)) * out.truth.semi_major;
  out.truth.circle = circle;
  const double phase = 3.0 * unit(*rng);
  for (int v = 0; v < views; ++v) {
    const double azimuth = 0.5 * v + 0.2 * unit(*rng);
    ConicSight sight;
    sight.view = LookingAtOrigin(
        {0.45 * std::cos(azimuth), 0.45 * std::sin(azimuth), 0.4 + 0.1 * unit(*rng)}, k1);
    for (int k = 0; k < 32; ++k) {
      const Eigen::Vector3d x =
          sight.view.camera_from_scene * PointOfConic(out.truth, phase + sweep * k / 32.0);
      sight.points.push_back(Project(sight.view.camera, x) +
                             noise_px * Eigen::Vector2d(noise(*rng), noise(*rng)));
    }
    out.sights.push_back(std::move(sight));
  }
  return out;
}

// Errors in the parameters of the covariance; of an ellipse modulo half turns about its normal and
// the normal's sense, of a circle modulo all turns about it.
Eigen::Matrix<double, 8, 1> ErrorOf(const SpaceConic& found, const SpaceConic& truth) {
  Eigen::Matrix<double, 8, 1> error;
  Eigen::Matrix3d relative = found.scene_from_conic.R.transpose() * truth.scene_from_conic.R;
  if (relative(2, 2) < 0.0) relative = relative * Eigen::Vector3d(1, -1, -1).asDiagonal();
  if (relative(0, 0) < 0.0) relative = relative * Eigen::Vector3d(-1, -1, 1).asDiagonal();
  if (truth.circle) {
    const Eigen::Vector3d n = relative.col(2);
    error.head<3>() << -n.y(), n.x(), 0.0;
  } else {
    const Eigen::AngleAxisd turn(relative);
    error.head<3>() = turn.angle() * turn.axis();
  }
  error.segment<3>(3) = truth.scene_from_conic.t - found.scene_from_conic.t;
  error(6) = std::log(truth.semi_major / found.semi_major);
  error(7) = std::log(truth.semi_minor / found.semi_minor);
  return error;
}

TEST(FitSpaceCircle, WithoutNoiseItIsTheCircle) {
  std::mt19937 rng(1);
  for (int trial = 0; trial < 40; ++trial) {
    SCOPED_TRACE(testing::Message() << "seed 1, trial " << trial);
    const Trial t = Draw(&rng, 2 + trial % 3, true, 0.0, 2.0 * std::numbers::pi, 0.0);
    const auto found = FitSpaceCircle(t.sights);
    ASSERT_TRUE(found);
    EXPECT_TRUE(found->circle);
    EXPECT_LT(ErrorOf(*found, t.truth).cwiseAbs().maxCoeff(), 1e-5);
    EXPECT_LT(found->rms_px, 1e-4);
  }
}

TEST(FitSpaceEllipse, WithoutNoiseItIsTheEllipse) {
  std::mt19937 rng(2);
  for (int trial = 0; trial < 40; ++trial) {
    SCOPED_TRACE(testing::Message() << "seed 2, trial " << trial);
    const Trial t = Draw(&rng, 3 + trial % 3, false, 0.0, 2.0 * std::numbers::pi, 0.0);
    const auto found = FitSpaceConic(t.sights, {.max_rms_px = 0.1});
    ASSERT_TRUE(found);
    EXPECT_FALSE(found->circle);
    EXPECT_FALSE(FitSpaceEllipse(std::span(t.sights).first(2)));  // two of them are in both cones
    EXPECT_LT(ErrorOf(*found, t.truth).cwiseAbs().maxCoeff(), 1e-4);
  }
}

TEST(FitSpaceConic, AnArcAndALensAreEnough) {
  std::mt19937 rng(3);
  for (const double k1 : {-0.1, 0.0, 0.1}) {
    for (int trial = 0; trial < 20; ++trial) {
      SCOPED_TRACE(testing::Message() << "seed 3, k1 " << k1 << ", trial " << trial);
      const Trial t = Draw(&rng, 3, true, 0.0, 0.7 * std::numbers::pi, k1);
      const auto found = FitSpaceConic(t.sights);
      ASSERT_TRUE(found);
      EXPECT_LT(ErrorOf(*found, t.truth).cwiseAbs().maxCoeff(), 1e-3);
    }
  }
}

// The errors have the stated covariance: chi^2 of the parameters by it.
TEST(FitSpaceConic, StatesItsCovariance) {
  for (const bool circle : {true, false}) {
    for (const double noise_px : {0.1, 0.3, 0.6}) {
      std::mt19937 rng(4);
      SpaceConicOptions options;
      options.sigma_px = noise_px;
      double chi2 = 0.0;
      int trials = 0, inside = 0;
      const int freedom = circle ? 6 : 8;
      for (int trial = 0; trial < 100; ++trial) {
        const Trial t = Draw(&rng, 3, circle, noise_px, 2.0 * std::numbers::pi, 0.0);
        const auto found =
            circle ? FitSpaceCircle(t.sights, options) : FitSpaceEllipse(t.sights, options);
        ASSERT_TRUE(found) << "seed 4, noise " << noise_px << ", trial " << trial;
        Eigen::Matrix<double, 8, 1> e = ErrorOf(*found, t.truth);
        Eigen::MatrixXd S = found->covariance;
        Eigen::VectorXd x = e;
        if (circle) {  // without the turn about the normal and the second axis
          Eigen::MatrixXd keep = Eigen::MatrixXd::Zero(6, 8);
          for (int i = 0; i < 6; ++i) keep(i, i < 2 ? i : i + 1) = 1.0;
          S = keep * S * keep.transpose();
          x = keep * e;
        }
        const double d = x.dot(S.ldlt().solve(x));
        chi2 += d;
        inside += d < (circle ? 12.6 : 15.5);  // 95 %
        ++trials;
      }
      SCOPED_TRACE(testing::Message() << (circle ? "circle" : "ellipse") << ", noise " << noise_px
                                      << ", chi^2 / freedom " << chi2 / trials / freedom
                                      << ", in the 95 % " << inside);
      EXPECT_GT(chi2 / trials / freedom, 0.6);
      EXPECT_LT(chi2 / trials / freedom, 1.3);
      EXPECT_GE(inside, 85);  // of ellipses in much noise some more are beyond
    }
  }
}

TEST(FitSpaceConic, WhatIsNoOneConicIsNone) {
  std::mt19937 rng(5);
  for (int trial = 0; trial < 20; ++trial) {
    SCOPED_TRACE(testing::Message() << "seed 5, trial " << trial);
    Trial a = Draw(&rng, 3, true, 0.1, 2.0 * std::numbers::pi, 0.0);
    const Trial b = Draw(&rng, 3, true, 0.1, 2.0 * std::numbers::pi, 0.0);
    for (Eigen::Vector2d& x : a.sights[2].points) x += Eigen::Vector2d(25.0, -20.0);
    EXPECT_FALSE(FitSpaceConic(a.sights));
  }
}

TEST(FitSpaceConic, DegenerateSightsAreNone) {
  std::mt19937 rng(6);
  const Trial t = Draw(&rng, 2, true, 0.0, 2.0 * std::numbers::pi, 0.0);
  EXPECT_FALSE(FitSpaceConic({}));
  EXPECT_FALSE(FitSpaceConic(std::span(t.sights).first(1)));
  std::vector<ConicSight> same = {t.sights[0], t.sights[0]};  // no parallax
  EXPECT_FALSE(FitSpaceConic(same));
  std::vector<ConicSight> few = t.sights;
  few[1].points.resize(5);
  EXPECT_FALSE(FitSpaceConic(few));
  std::vector<ConicSight> line = t.sights;  // seen from its plane
  for (std::size_t k = 0; k < line[1].points.size(); ++k) line[1].points[k] = {10.0 * k, 5.0 * k};
  EXPECT_FALSE(FitSpaceConic(line));
  std::vector<ConicSight> point = t.sights;
  for (Eigen::Vector2d& x : point[1].points) x = {320.0, 240.0};
  EXPECT_FALSE(FitSpaceConic(point));
}

TEST(DistancesToImage, AreThoseOfThePoints) {
  std::mt19937 rng(7);
  Trial t = Draw(&rng, 2, true, 0.0, 2.0 * std::numbers::pi, 0.0);
  for (const double d : DistancesToImage(t.truth, t.sights[0])) EXPECT_NEAR(d, 0.0, 1e-9);
  Eigen::Vector2d middle = Eigen::Vector2d::Zero();
  for (const auto& x : t.sights[0].points) middle += x / 32.0;
  for (auto& x : t.sights[0].points) x += 0.5 * (x - middle).normalized();
  for (const double d : DistancesToImage(t.truth, t.sights[0])) {
    EXPECT_GT(d, 0.3);
    EXPECT_LT(d, 0.55);
  }
}

}  // namespace
}  // namespace horopter
