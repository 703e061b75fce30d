// The bundle over a plane against Ceres with automatic derivatives.
#include <gtest/gtest.h>

#include <Eigen/Geometry>
#include <cmath>

#include "server/vision/reconstruction/bundle_adjustment.h"
#include "tests/support/ceres_bundle.h"
#include "tests/support/random.h"

namespace horopter {
namespace {

// Cameras about one unit above the plane z = 0 that look at its middle, points on it and above it;
// seen with noise, `outliers` of the observations anywhere.
struct PlaneScene {
  Bundle truth, start;
};

Rigid3 LookAtMiddle(const Eigen::Vector3d& from) {
  const Eigen::Vector3d z = -from.normalized();
  const Eigen::Vector3d x = Eigen::Vector3d::UnitY().cross(z).normalized();
  Rigid3 out;
  out.R << x.transpose(), z.cross(x).transpose(), z.transpose();
  out.t = -(out.R * from);
  return out;
}

PlaneScene MakePlaneScene(unsigned seed, int views, double noise_px, double outliers) {
  Random random(seed);
  PlaneScene out;
  for (int v = 0; v < views; ++v) {
    BundleView view;
    view.size = {640, 480};
    view.focal_px = random.Uniform(700.0, 1100.0);
    view.k1 = random.Uniform(-0.05, 0.05);
    const double turn = v * 6.28 / views + random.Uniform(-0.3, 0.3);
    view.camera_from_world =
        LookAtMiddle({0.6 * std::cos(turn), 0.6 * std::sin(turn), random.Uniform(0.8, 1.2)});
    out.truth.views.push_back(view);
  }
  for (int k = 0; k < 100; ++k) {
    BundlePoint point;
    point.on_plane = k < 60;
    point.track.on_plane = point.on_plane;
    point.point_in_world = {random.Uniform(-0.2, 0.2),
                            random.Uniform(-0.2, 0.2),
                            point.on_plane ? 0.0 : random.Uniform(0.02, 0.2)};
    for (int v = 0; v < views; ++v) {
      if (random.Uniform(0, 1) < 0.2) continue;
      Eigen::Vector2d pixel =
          *ProjectInto(out.truth.views[v], point.point_in_world) + random.Noise(noise_px);
      if (random.Uniform(0, 1) < outliers) pixel = {random.Uniform(0, 640), random.Uniform(0, 480)};
      point.track.observations.push_back({v, -1, pixel});
    }
    if (point.track.observations.size() >= 2) out.truth.points.push_back(point);
  }
  out.start = out.truth;
  for (BundleView& view : out.start.views) {
    view.focal_px *= std::exp(random.Uniform(-0.05, 0.05));
    view.k1 = 0.0;
    const Eigen::Vector3d turn(
        random.Uniform(-.02, .02), random.Uniform(-.02, .02), random.Uniform(-.02, .02));
    view.camera_from_world.R =
        Eigen::AngleAxisd(turn.norm(), turn.normalized()) * view.camera_from_world.R;
  }
  for (BundlePoint& p : out.start.points) {
    p.point_in_world.head<2>() += random.Noise(0.005);
    if (!p.on_plane) p.point_in_world.z() += random.Uniform(-0.01, 0.01);
  }
  return out;
}

TEST(AdjustBundle, EndsWhereCeresEnds) {
  for (unsigned seed = 1; seed <= 10; ++seed) {
    SCOPED_TRACE(seed);
    const PlaneScene scene = MakePlaneScene(seed, 3 + seed % 4, 0.4, seed % 2 ? 0.0 : 0.05);
    BundleOptions options;
    options.covariance = true;
    Bundle ours = scene.start, peer = scene.start;
    const BundleSummary of_ours = AdjustBundle(options, &ours);
    options.max_iterations = 400;
    const BundleSummary of_peer = AdjustBundleInCeres(options, &peer);
    ASSERT_TRUE(of_ours.usable && of_peer.usable);
    EXPECT_LE(of_ours.cost, of_peer.cost * 1.0001);
    for (std::size_t v = 0; v < ours.views.size(); ++v) {
      EXPECT_NEAR(std::log(ours.views[v].focal_px / peer.views[v].focal_px),
                  0.0,
                  0.1 * peer.views[v].focal_log_sigma);
      EXPECT_NEAR(ours.views[v].focal_log_sigma / peer.views[v].focal_log_sigma, 1.0, 0.02);
      EXPECT_NEAR(ours.views[v].focal_log_sigma_of_center / peer.views[v].focal_log_sigma_of_center,
                  1.0,
                  0.05);
    }
  }
}

TEST(AdjustBundle, KeepsThePlaneAndTheFirstViewsPlace) {
  const PlaneScene scene = MakePlaneScene(20, 4, 0.4, 0.0);
  Bundle bundle = scene.start;
  ASSERT_TRUE(AdjustBundle({}, &bundle).usable);
  const Rigid3& was = scene.start.views[0].camera_from_world;
  const Rigid3& is = bundle.views[0].camera_from_world;
  EXPECT_LT((was.Inverse().t - is.Inverse().t).norm(), 1e-12);
  const Eigen::Matrix3d turn = was.R.transpose() * is.R;
  EXPECT_NEAR(turn(1, 0) - turn(0, 1), 0.0, 1e-9);
  for (const BundlePoint& p : bundle.points) {
    if (p.on_plane) {
      EXPECT_EQ(p.point_in_world.z(), 0.0);
    }
  }
  // What the cameras see does not hang on where the first one is put.
  for (std::size_t k = 0; k < bundle.points.size(); ++k)
    EXPECT_LT(WorstReprojection(bundle, bundle.points[k]), 2.5);
}

TEST(AdjustBundle, LeavesWhatHasNoMeaningAsItIs) {
  PlaneScene scene = MakePlaneScene(30, 3, 0.4, 0.0);
  Bundle none;
  EXPECT_FALSE(AdjustBundle({}, &none).usable);
  Bundle nan = scene.start;
  nan.points[5].point_in_world.x() = NAN;
  EXPECT_FALSE(AdjustBundle({}, &nan).usable);
  Bundle behind = scene.start;
  behind.views[1].camera_from_world.t.z() = -5.0;
  EXPECT_FALSE(AdjustBundle({}, &behind).usable);
  EXPECT_EQ(behind.views[1].focal_px, scene.start.views[1].focal_px);
  Bundle empty = scene.start;
  empty.points.clear();
  EXPECT_TRUE(AdjustBundle({}, &empty).usable);
}

TEST(AdjustBundle, GivesTheSameBytesAgain) {
  const PlaneScene scene = MakePlaneScene(40, 5, 0.4, 0.05);
  Bundle a = scene.start, b = scene.start;
  ASSERT_TRUE(AdjustBundle({}, &a).usable && AdjustBundle({}, &b).usable);
  for (std::size_t v = 0; v < a.views.size(); ++v)
    EXPECT_EQ(a.views[v].focal_px, b.views[v].focal_px);
}

}  // namespace
}  // namespace horopter
