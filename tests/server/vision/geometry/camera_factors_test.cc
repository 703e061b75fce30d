#include "server/vision/geometry/camera_factors.h"

#include <gtest/gtest.h>

#include <Eigen/Geometry>
#include <limits>

#include "tests/support/random.h"

namespace horopter {
namespace {

TEST(FactorCamera, GivesBackWhatTheCameraWasMadeOfUpToScaleAndSign) {
  for (unsigned seed = 1; seed <= 200; ++seed) {
    SCOPED_TRACE(testing::Message() << "seed " << seed);
    Random random(seed);
    Eigen::Matrix3d K;
    K << random.Uniform(300, 2000), random.Uniform(-50, 50), random.Uniform(100, 500), 0,
        random.Uniform(300, 2000), random.Uniform(100, 500), 0, 0, 1;
    const Eigen::Vector3d axis(random.Normal(), random.Normal(), random.Normal());
    const Eigen::Matrix3d R =
        Eigen::AngleAxisd(random.Uniform(0, 3.1), axis.normalized()).toRotationMatrix();
    const Eigen::Vector3d t(random.Normal(), random.Normal(), random.Uniform(0.5, 5.0));
    CameraMatrix P;
    P << K * R, K * t;
    P *= (seed % 2 == 0 ? 1.0 : -1.0) * std::pow(10.0, random.Uniform(-6, 6));
    const auto factors = FactorCamera(P);
    ASSERT_TRUE(factors.has_value());
    EXPECT_LT((factors->K - K).norm(), 1e-7 * K.norm());
    EXPECT_LT((factors->camera_from_scene.R - R).norm(), 1e-9);
    EXPECT_LT((factors->camera_from_scene.t - t).norm(), 1e-7 * t.norm());
  }
}

TEST(FactorCamera, RefusesWhatIsNoFiniteCamera) {
  CameraMatrix P = CameraMatrix::Zero();
  EXPECT_FALSE(FactorCamera(P).has_value());
  P << 1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 0, 1;  // affine
  EXPECT_FALSE(FactorCamera(P).has_value());
  P.setRandom();
  P(1, 2) = std::numeric_limits<double>::quiet_NaN();
  EXPECT_FALSE(FactorCamera(P).has_value());
}

}  // namespace
}  // namespace horopter
