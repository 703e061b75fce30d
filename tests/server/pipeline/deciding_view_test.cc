#include "server/pipeline/deciding_view.h"

#include <gtest/gtest.h>

#include <Eigen/Geometry>
#include <Eigen/LU>
#include <vector>

namespace horopter {
namespace {

// Two cameras half a metre from the origin, above the plane z = 0.
MetricScene Scene(bool with_plane = true) {
  MetricScene scene;
  for (const double x : {-0.3, 0.3}) {
    PosedCamera camera;
    const Eigen::Vector3d at(x, 0.0, 0.4), forward = -at.normalized();
    const Eigen::Vector3d right = forward.cross(Eigen::Vector3d::UnitZ()).normalized();
    Rigid3 pose;
    pose.R.col(0) = right;
    pose.R.col(1) = forward.cross(right);
    pose.R.col(2) = forward;
    pose.t = at;
    camera.camera_from_scene = pose.Inverse();
    scene.cameras.push_back(camera);
  }
  scene.cameras.emplace_back();
  if (with_plane) {
    scene.plane.emplace();
    scene.plane->normal = Eigen::Vector3d::UnitZ();
  }
  return scene;
}

const std::vector<ViewDifference> kViews = {{Eigen::Vector3d::UnitZ(), 10.0},
                                            {-Eigen::Vector3d::UnitZ(), 90.0},
                                            {Eigen::Vector3d(1, 0, 1).normalized(), 40.0},
                                            {Eigen::Vector3d::UnitX(), 60.0}};

TEST(DecidingView, IsTheMostDifferentOneAboveThePlane) {
  const auto view = FindDecidingView(kViews, Rigid3(), Eigen::Vector3d::Zero(), Scene());
  ASSERT_TRUE(view);
  EXPECT_EQ(view->differing_px, 40.0);
  const Eigen::Vector3d expected = 0.5 * Eigen::Vector3d(1, 0, 1).normalized();
  EXPECT_LT((view->scene_from_camera.t - expected).norm(), 1e-9);
  // Looks at the object, upright.
  const Eigen::Vector3d object = view->scene_from_camera.Inverse() * Eigen::Vector3d(0, 0, 0);
  EXPECT_LT((object - Eigen::Vector3d(0, 0, 0.5)).norm(), 1e-9);
  EXPECT_NEAR(view->scene_from_camera.R.determinant(), 1.0, 1e-9);
  EXPECT_LT(view->scene_from_camera.R(2, 1), 0.0);
}

TEST(DecidingView, TurnsWithTheObject) {
  Rigid3 upside_down;
  upside_down.R = Eigen::Vector3d(1, -1, -1).asDiagonal();
  upside_down.t = {0.1, 0.0, 0.05};
  const auto view = FindDecidingView(kViews, upside_down, Eigen::Vector3d(0.0, 0.0, 0.01), Scene());
  ASSERT_TRUE(view);
  EXPECT_EQ(view->differing_px, 90.0);
  const Eigen::Vector3d middle = upside_down * Eigen::Vector3d(0.0, 0.0, 0.01);
  EXPECT_GT((view->scene_from_camera.t - middle).normalized().z(), 0.999);
}

TEST(DecidingView, AnyDirectionServesWithoutAPlane) {
  const auto view = FindDecidingView(kViews, Rigid3(), Eigen::Vector3d::Zero(), Scene(false));
  ASSERT_TRUE(view);
  EXPECT_EQ(view->differing_px, 90.0);
  EXPECT_NEAR(view->scene_from_camera.R.determinant(), 1.0, 1e-9);
}

TEST(DecidingView, NoneWhereNothingDiffersOrNoCameraIsKnown) {
  EXPECT_FALSE(FindDecidingView({}, Rigid3(), Eigen::Vector3d::Zero(), Scene()));
  const std::vector<ViewDifference> alike = {{Eigen::Vector3d::UnitZ(), 1.0}};
  EXPECT_FALSE(FindDecidingView(alike, Rigid3(), Eigen::Vector3d::Zero(), Scene()));
  MetricScene nowhere;
  nowhere.cameras.resize(3);
  EXPECT_FALSE(FindDecidingView(kViews, Rigid3(), Eigen::Vector3d::Zero(), nowhere));
}

}  // namespace
}  // namespace horopter
