#include "server/vision/euclidean/supporting_plane_search.h"

#include <gtest/gtest.h>

#include <Eigen/Geometry>
#include <random>

namespace horopter {
namespace {

// Two boxes of 40 x 30 x 20 mm on the table z = 0, before two cameras above it.
class FindPlane : public testing::Test {
 protected:
  FindPlane() {
    box_.model.diameter_m = 0.054;
    for (int i = 0; i < 8; ++i) {
      box_.model.mesh.vertices.emplace_back(
          i & 1 ? 0.02 : -0.02, i & 2 ? 0.015 : -0.015, i & 4 ? 0.02 : 0.0);
    }
    Rest(Eigen::Vector3d::UnitZ(), 0.0, 0.015);
    Rest(-Eigen::Vector3d::UnitZ(), 0.02, 0.015);
    Rest(Eigen::Vector3d::UnitX(), 0.02, 0.01);
    Rest(-Eigen::Vector3d::UnitX(), 0.02, 0.01);
    bundle_.objects = {{Rigid3{}, &box_}, {Rigid3{}, &box_}};
    bundle_.objects[1].scene_from_object.t = {0.1, 0.02, 0.0};
    for (const double x : {-0.2, 0.2}) {
      AdjustedView view;
      view.known = true;
      view.camera_from_scene.t = -Eigen::Vector3d(x, 0.1, 0.4);
      bundle_.views.push_back(view);
    }
  }

  void Rest(const Eigen::Vector3d& up, double height_m, double margin_m) {
    StablePose pose;
    pose.up = up;
    pose.height_m = height_m;
    pose.margin_m = margin_m;
    box_.stable_poses.push_back(pose);
  }

  // So many points about the table, and a third as many anywhere above it.
  void AddTexture(int points, unsigned seed) {
    std::mt19937 random(seed);
    std::normal_distribution<double> off(0.0, 0.001);
    std::uniform_real_distribution<double> at(-0.3, 0.3);
    for (int i = 0; i < points + points / 3; ++i) {
      TexturePoint point;
      point.point_in_scene = {at(random), at(random), i < points ? off(random) : 0.2 + at(random)};
      bundle_.texture.points.push_back(point);
    }
  }

  PreparedObject box_;
  SceneBundle bundle_;
};

TEST_F(FindPlane, IsWhereMostObjectsStand) {
  const auto plane = FindSupportingPlane(bundle_);
  ASSERT_TRUE(plane.has_value());
  EXPECT_TRUE(plane->normal.isApprox(Eigen::Vector3d::UnitZ()));
  EXPECT_NEAR(plane->offset_m, 0.0, 1e-9);
}

// One box is turned and hangs below the table: without texture a face at its other side is all that
// no object is below.
class FindPlaneBesideAWrongPose : public FindPlane {
 protected:
  FindPlaneBesideAWrongPose() {
    bundle_.objects[1].scene_from_object.R =
        Eigen::AngleAxisd(0.25, Eigen::Vector3d::UnitY()).toRotationMatrix();
  }
};

TEST_F(FindPlaneBesideAWrongPose, TextureTellsTheTable) {
  for (const unsigned seed : {1u, 2u, 3u}) {
    bundle_.texture.points.clear();
    AddTexture(60, seed);
    const auto plane = FindSupportingPlane(bundle_);
    ASSERT_TRUE(plane.has_value()) << "seed " << seed;
    EXPECT_GT(plane->normal.z(), 0.999) << "seed " << seed;
    EXPECT_NEAR(plane->offset_m, -0.003, 1e-9) << "lowered, but not to the wrong pose";
  }
}

TEST_F(FindPlaneBesideAWrongPose, FewPointsTellNothing) {
  const auto is_table = [&] {
    const auto plane = FindSupportingPlane(bundle_);
    return plane && plane->normal.z() > 0.999;
  };
  EXPECT_FALSE(is_table());
  AddTexture(15, 1);
  EXPECT_FALSE(is_table());
  AddTexture(15, 2);
  EXPECT_TRUE(is_table());
  // Most of the texture is elsewhere.
  for (int i = 0; i < 150; ++i)
    bundle_.texture.points.emplace_back().point_in_scene = {0.002 * i, 0.1, 0.1 + 0.001 * i};
  EXPECT_FALSE(is_table());
}

TEST_F(FindPlane, NoneBelowACamera) {
  for (AdjustedView& view : bundle_.views) view.camera_from_scene.t = {0.0, 0.0, 0.4};
  const auto plane = FindSupportingPlane(bundle_);
  EXPECT_TRUE(!plane || plane->normal.z() < 0.5);
  bundle_.objects.clear();
  EXPECT_FALSE(FindSupportingPlane(bundle_).has_value());
}

}  // namespace
}  // namespace horopter
