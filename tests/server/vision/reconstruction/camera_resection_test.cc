#include "server/vision/reconstruction/camera_resection.h"

#include <gtest/gtest.h>

#include <Eigen/Dense>
#include <algorithm>
#include <array>
#include <cmath>
#include <random>

namespace horopter {
namespace {

class Random {
 public:
  explicit Random(unsigned seed) : rng_(seed) {}
  double Uniform(double a, double b) { return a + (b - a) * (rng_() / 4294967296.0); }
  double Normal() {
    return std::sqrt(-2.0 * std::log(Uniform(1e-12, 1.0))) * std::cos(Uniform(0.0, 2.0 * M_PI));
  }
  Eigen::Vector3d InBox(double half) {
    return {Uniform(-half, half), Uniform(-half, half), Uniform(-half, half)};
  }

 private:
  std::mt19937 rng_;
};

struct Truth {
  PinholeCamera camera;
  Rigid3 camera_from_world;
};

Truth RandomCamera(Random* random) {
  Truth truth;
  truth.camera = CenteredCamera(640, 480, random->Uniform(500.0, 1500.0));
  const Eigen::Vector3d centre =
      4.0 *
      Eigen::Vector3d(random->Uniform(-1, 1), random->Uniform(-1, 1), random->Uniform(0.5, 1.5))
          .normalized();
  const Eigen::Vector3d z = -centre.normalized();
  const Eigen::Vector3d x = z.cross(Eigen::Vector3d(0.1, 1.0, 0.2)).normalized();
  truth.camera_from_world.R << x.transpose(), z.cross(x).transpose(), z.transpose();
  truth.camera_from_world.t = -(truth.camera_from_world.R * centre);
  return truth;
}

struct Sights {
  std::vector<PointSight> points;
  std::vector<LineSight> lines;
};

// The first `wrong` of the points and lines are seen anywhere.
Sights Look(const Truth& truth, int points, int lines, int wrong, double sigma_px, Random* random) {
  Sights out;
  const auto anywhere = [&] {
    return Eigen::Vector2d(random->Uniform(0, 639), random->Uniform(0, 479));
  };
  const auto see = [&](const Eigen::Vector3d& x) {
    return Eigen::Vector2d(Project(truth.camera, truth.camera_from_world * x) +
                           sigma_px * Eigen::Vector2d(random->Normal(), random->Normal()));
  };
  for (int i = 0; i < points; ++i) {
    const Eigen::Vector3d x = random->InBox(0.6);
    out.points.push_back({x, i < wrong ? anywhere() : see(x)});
  }
  for (int i = 0; i < lines; ++i) {
    const Eigen::Vector3d a = random->InBox(0.6), b = random->InBox(0.6);
    out.lines.push_back({JoinPoints(a.homogeneous(), b.homogeneous()),
                         i < wrong ? anywhere() : see(a),
                         i < wrong ? anywhere() : see(b)});
  }
  return out;
}

double Degrees(const Eigen::Matrix3d& a, const Eigen::Matrix3d& b) {
  return Eigen::AngleAxisd(a * b.transpose()).angle() * 180.0 / M_PI;
}

absl::StatusOr<ResectedCamera> Resect(const Sights& s, const ViewPrior& prior = {}) {
  return ResectPinhole(s.points, s.lines, {640, 480}, prior, {});
}

TEST(PosesFromThreePoints, TheTruePoseIsAmongThem) {
  Random random(7);
  for (int trial = 0; trial < 500; ++trial) {
    SCOPED_TRACE("trial " + std::to_string(trial));
    const Truth truth = RandomCamera(&random);
    std::array<Eigen::Vector3d, 3> X, rays;
    for (int k = 0; k < 3; ++k) {
      X[k] = random.InBox(0.6);
      rays[k] = random.Uniform(0.1, 5.0) * (truth.camera_from_world * X[k]);
    }
    double nearest = 1e9;
    const std::vector<Rigid3> poses = PosesFromThreePoints(X, rays);
    EXPECT_LE(poses.size(), 4u);
    for (const Rigid3& pose : poses) {
      EXPECT_NEAR(pose.R.determinant(), 1.0, 1e-9);
      nearest = std::min(nearest, (pose.R - truth.camera_from_world.R).norm());
      // Each of them sees the three points where they are.
      for (int k = 0; k < 3; ++k) {
        EXPECT_LT((pose * X[k]).normalized().cross(rays[k].normalized()).norm(), 1e-3);
      }
    }
    EXPECT_LT(nearest, 1e-4);
  }
}

TEST(PosesFromThreePoints, CollinearAndEqualPointsGiveNothing) {
  const std::array<Eigen::Vector3d, 3> rays = {
      Eigen::Vector3d(0, 0, 1), Eigen::Vector3d(0.1, 0, 1), Eigen::Vector3d(0.2, 0, 1)};
  const Eigen::Vector3d a(0, 0, 0), b(1, 0, 0), c(2, 0, 0);
  EXPECT_TRUE(PosesFromThreePoints(std::array{a, b, c}, rays).empty());
  EXPECT_TRUE(PosesFromThreePoints(std::array{a, a, a}, rays).empty());
}

class Noise : public testing::TestWithParam<double> {};

TEST_P(Noise, ErrorsGrowNoFasterThanNoiseAndDeviationsHold) {
  const double sigma_px = GetParam();
  double squared = 0.0;
  int n = 0;
  for (unsigned seed = 1; seed <= 8; ++seed) {
    SCOPED_TRACE("seed " + std::to_string(seed));
    Random random(seed);
    const Truth truth = RandomCamera(&random);
    const auto found = Resect(Look(truth, 30, 15, 0, sigma_px, &random));
    ASSERT_TRUE(found.ok()) << found.status();
    const double log_error = std::log(found->camera.focal_px / truth.camera.focal_px);
    EXPECT_LT(std::abs(log_error), 0.005 + 0.1 * sigma_px);
    EXPECT_LT(Degrees(found->camera_from_scene.R, truth.camera_from_world.R), 0.1 + sigma_px);
    EXPECT_GE(found->points, 27);
    squared += std::pow(log_error / found->focal_log_sigma, 2);
    ++n;
  }
  if (sigma_px >= 0.3) {
    EXPECT_LT(std::sqrt(squared / n), 1.8);
  }
}
INSTANTIATE_TEST_SUITE_P(Sweep, Noise, testing::Values(0.0, 0.1, 0.5, 1.0));

TEST(ResectPinhole, FindsOneRightMatchInFour) {
  for (unsigned seed = 21; seed <= 26; ++seed) {
    SCOPED_TRACE("seed " + std::to_string(seed));
    Random random(seed);
    const Truth truth = RandomCamera(&random);
    const auto found = Resect(Look(truth, 120, 80, 90, 0.4, &random));
    ASSERT_TRUE(found.ok()) << found.status();
    EXPECT_LT(Degrees(found->camera_from_scene.R, truth.camera_from_world.R), 1.0);
    EXPECT_LT(std::abs(std::log(found->camera.focal_px / truth.camera.focal_px)), 0.06);
  }
}

TEST(ResectPinhole, MatchesThatMeanNothingGiveNoCamera) {
  for (unsigned seed = 41; seed <= 52; ++seed) {
    SCOPED_TRACE("seed " + std::to_string(seed));
    Random random(seed);
    const auto found = Resect(Look(RandomCamera(&random), 100, 60, 100, 0.4, &random));
    EXPECT_EQ(found.status().code(), absl::StatusCode::kFailedPrecondition);
  }
}

TEST(ResectPinhole, AKnownFocalLengthIsKept) {
  Random random(61);
  const Truth truth = RandomCamera(&random);
  ViewPrior prior;
  prior.focal_px = truth.camera.focal_px;
  prior.focal_log_sigma = 1e-4;
  const auto found = Resect(Look(truth, 14, 8, 0, 0.5, &random), prior);
  ASSERT_TRUE(found.ok()) << found.status();
  EXPECT_NEAR(found->camera.focal_px, truth.camera.focal_px, 0.2);
  EXPECT_LT(found->focal_log_sigma, 2e-4);
}

TEST(ResectPinhole, TooFewPointsAndPlanesSeenFrontallyAreRefusedWithNumbers) {
  Random random(71);
  const Truth truth = RandomCamera(&random);
  const auto few = Resect(Look(truth, 5, 30, 0, 0.1, &random));
  EXPECT_EQ(few.status().code(), absl::StatusCode::kFailedPrecondition);
  EXPECT_NE(std::string(few.status().message()).find("5 known points"), std::string::npos);
  // Parallel to the image plane: focal length and distance are one unknown.
  Sights flat;
  const PinholeCamera camera = CenteredCamera(640, 480, 900.0);
  for (int i = 0; i < 40; ++i) {
    const Eigen::Vector3d x(random.Uniform(-1, 1), random.Uniform(-1, 1), 0.0);
    flat.points.push_back({x, Project(camera, x + Eigen::Vector3d(0, 0, 4.0))});
  }
  const auto open = Resect(flat);
  EXPECT_EQ(open.status().code(), absl::StatusCode::kFailedPrecondition) << "frontal plane";
}

TEST(ResectPinhole, AStopIsHonoured) {
  Random random(81);
  const Sights s = Look(RandomCamera(&random), 30, 0, 0, 0.1, &random);
  EXPECT_EQ(
      ResectPinhole(s.points, s.lines, {640, 480}, {}, {}, [] { return true; }).status().code(),
      absl::StatusCode::kCancelled);
}

}  // namespace
}  // namespace horopter
