#include "server/vision/euclidean/grasps.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <Eigen/Geometry>
#include <random>

#include "server/vision/geometry/grasp_kind.h"
#include "tests/support/synthetic_part.h"

namespace horopter {
namespace {

// A block 40 x 20 x 30 mm standing on z = 0 about the origin, gripped across its 20 mm from above
// and from the side.
ObjectModel Block() {
  ObjectModel m =
      Prism("block", {{-0.02, -0.01}, {0.02, -0.01}, {0.02, 0.01}, {-0.02, 0.01}}, 0.03);
  Grasp top;
  top.name = "top";
  top.object_from_gripper.R.col(0) = Eigen::Vector3d::UnitY();
  top.object_from_gripper.R.col(1) = Eigen::Vector3d::UnitX();
  top.object_from_gripper.R.col(2) = -Eigen::Vector3d::UnitZ();
  top.object_from_gripper.t = {0, 0, 0.02};
  top.jaw_opening_m = 0.03;
  top.grip_width_m = 0.02;
  Grasp side = top;
  side.name = "side";
  side.object_from_gripper.R.col(1) = Eigen::Vector3d::UnitZ();
  side.object_from_gripper.R.col(2) = Eigen::Vector3d::UnitX();  // comes from -x
  side.object_from_gripper.t = {-0.01, 0, 0.015};
  Grasp below = top;
  below.name = "below";
  below.object_from_gripper.R.col(1) = -Eigen::Vector3d::UnitX();
  below.object_from_gripper.R.col(2) = Eigen::Vector3d::UnitZ();
  below.object_from_gripper.t = {0, 0, 0.01};
  m.grasps = {top, side, below};
  return m;
}

std::vector<std::string> Names(const std::vector<SceneGrasp>& grasps) {
  std::vector<std::string> out;
  for (const SceneGrasp& g : grasps) out.push_back(g.name);
  return out;
}

TEST(PlanGrasps, NothingThroughThePlaneOrThroughANeighbour) {
  const ObjectModel block = Block();
  GraspScene scene;
  scene.objects = {{&block, {}, Matrix6d::Zero()}};
  EXPECT_EQ(PlanGrasps(scene, 0, {}).size(), 3u);
  scene.plane = SupportingPlane{};
  GraspCounts counts;
  EXPECT_EQ(Names(PlanGrasps(scene, 0, {}, &counts)), (std::vector<std::string>{"top", "side"}));
  EXPECT_EQ(counts.considered, 3);
  EXPECT_EQ(counts.below_plane, 1);
  // A neighbour where the gripper of "side" comes from.
  GraspScene::Object neighbour{&block, {}, Matrix6d::Zero()};
  neighbour.scene_from_object.t = {-0.06, 0.0, 0.0};
  neighbour.scene_from_object.R = RotationFromVector({0, 0, M_PI / 2});
  scene.objects.push_back(neighbour);
  EXPECT_EQ(Names(PlanGrasps(scene, 0, {}, &counts)), (std::vector<std::string>{"top"}));
  EXPECT_EQ(counts.blocked, 1);
}

TEST(PlanGrasps, OnlyGraspsOfTheRobotsGripperAreOffered) {
  ObjectModel block = Block();
  Grasp cup = block.grasps[0];
  cup.name = "cup";
  SetSuction(0.005, &cup);
  cup.object_from_gripper.t.z() = 0.03;  // on the top face
  block.grasps.push_back(cup);
  GraspScene scene;
  scene.objects = {{&block, {}, Matrix6d::Zero()}};
  EXPECT_EQ(PlanGrasps(scene, 0, {}).size(), 4u);
  GraspOptions options;
  options.parallel_jaw.reset();
  GraspCounts counts;
  EXPECT_EQ(Names(PlanGrasps(scene, 0, options, &counts)), (std::vector<std::string>{"cup"}));
  EXPECT_EQ(counts.other_gripper, 3);
  options = {};
  options.suction.reset();
  options.parallel_jaw->max_opening_m = 0.029;
  EXPECT_TRUE(PlanGrasps(scene, 0, options, &counts).empty());
  EXPECT_EQ(counts.other_gripper, 4);
}

TEST(PlanGrasps, ACupNeedsRoomForItsHolderAndASurePlaceAndTilt) {
  ObjectModel block = Block();
  Grasp cup = block.grasps[0];
  SetSuction(0.005, &cup);
  cup.object_from_gripper.t.z() = 0.03;
  block.grasps = {cup};
  GraspScene scene;
  scene.objects = {{&block, {}, Matrix6d::Zero()}};
  scene.plane = SupportingPlane{};
  ASSERT_EQ(PlanGrasps(scene, 0, {}).size(), 1u);
  EXPECT_EQ(PlanGrasps(scene, 0, {})[0].success, 1.0);
  // A higher neighbour 25 mm aside: room for the cup, not for a wide holder.
  const ObjectModel tower =
      Prism("tower", {{-0.01, -0.01}, {0.01, -0.01}, {0.01, 0.01}, {-0.01, 0.01}}, 0.08);
  GraspScene::Object neighbour{&tower, {}, Matrix6d::Zero()};
  neighbour.scene_from_object.t.y() = 0.025;
  scene.objects.push_back(neighbour);
  EXPECT_EQ(PlanGrasps(scene, 0, {}).size(), 1u);
  GraspOptions wide;
  wide.suction->holder_radius_m = 0.02;
  GraspCounts counts;
  EXPECT_TRUE(PlanGrasps(scene, 0, wide, &counts).empty());
  EXPECT_EQ(counts.blocked, 1);
  // Turns about the cup's axis do not matter, tilts do.
  scene.objects[0].covariance(2, 2) = 1.0;
  EXPECT_EQ(PlanGrasps(scene, 0, {}).size(), 1u);
  scene.objects[0].covariance(0, 0) = 0.01;
  EXPECT_TRUE(PlanGrasps(scene, 0, {}, &counts).empty());
  EXPECT_EQ(counts.unsure, 1);
}

TEST(PlanGrasps, TheOpeningMustPassThePart) {
  ObjectModel block = Block();
  for (Grasp& g : block.grasps) g.grip_width_m = g.jaw_opening_m;
  GraspScene scene;
  scene.objects = {{&block, {}, Matrix6d::Zero()}};
  GraspCounts counts;
  EXPECT_TRUE(PlanGrasps(scene, 0, {}, &counts).empty());
  EXPECT_EQ(counts.too_narrow, 3);
}

TEST(PlanGrasps, TheSurerGraspComesFirstAndTheUnsureNotAtAll) {
  const ObjectModel block = Block();
  GraspScene scene;
  Matrix6d covariance = Matrix6d::Zero();
  covariance(5, 5) = 1.2e-3 * 1.2e-3;  // unsure along z: "side" slides along its fingers' width
  scene.objects = {{&block, {}, covariance}};
  GraspOptions options;
  options.least_success = 0.0;
  const auto all = PlanGrasps(scene, 0, options);
  for (std::size_t i = 0; i + 1 < all.size(); ++i) {
    EXPECT_GE(all[i].quality * all[i].success, all[i + 1].quality * all[i + 1].success);
  }
  scene.objects[0].covariance = 1e-4 * Matrix6d::Identity();
  EXPECT_TRUE(PlanGrasps(scene, 0, {}).empty());
  scene.objects[0].covariance = Matrix6d::Zero();
  for (const SceneGrasp& g : PlanGrasps(scene, 0, {})) EXPECT_EQ(g.success, 1.0);
}

// The robot's base moves part, plane and neighbours alike.
TEST(PlanGrasps, AnUncertainBaseTakesNoGraspAwayAndLowersItsSuccess) {
  const ObjectModel block = Block();
  GraspScene scene;
  scene.objects = {{&block, {}, Matrix6d::Zero()}};
  scene.plane = SupportingPlane{};
  const std::vector<std::string> sure = Names(PlanGrasps(scene, 0, {}));
  ASSERT_EQ(sure.size(), 2u);
  Matrix6d base = Matrix6d::Zero();
  base.topLeftCorner<3, 3>().diagonal().setConstant(0.01 * 0.01);
  base.bottomRightCorner<3, 3>().diagonal().setConstant(0.005 * 0.005);
  scene.objects[0].covariance_in_base = base;
  GraspCounts counts;
  const auto grasps = PlanGrasps(scene, 0, {}, &counts);
  EXPECT_THAT(Names(grasps), testing::UnorderedElementsAreArray(sure));
  EXPECT_EQ(counts.unsure, 0);
  for (const SceneGrasp& g : grasps) {
    EXPECT_EQ(g.scene_success, 1.0) << g.name;
    EXPECT_LT(g.success, 0.3) << g.name;
    EXPECT_GT(g.success, 0.0) << g.name;
  }
}

TEST(PlanGrasps, WhatTwoPartsErrByInCommonIsNoMarginBetweenThem) {
  const ObjectModel block = Block();
  GraspScene scene;
  scene.objects = {{&block, {}, Matrix6d::Zero()}};
  // 5 mm beside the fingers of "top", which close along y.
  GraspScene::Object neighbour{&block, {}, Matrix6d::Zero()};
  neighbour.scene_from_object.t = {0.0, 0.038, 0.0};
  scene.objects.push_back(neighbour);
  GraspOptions options;
  options.least_success = 0.0;
  const std::vector<std::string> sure = Names(PlanGrasps(scene, 0, options));
  ASSERT_FALSE(sure.empty());
  Matrix6d shift = Matrix6d::Zero();
  shift.bottomRightCorner<3, 3>().diagonal().setConstant(0.02 * 0.02);
  for (GraspScene::Object& o : scene.objects) o.covariance = shift;
  scene.joint_covariance = Eigen::MatrixXd::Zero(12, 12);
  scene.joint_covariance.topLeftCorner<6, 6>() = shift;
  scene.joint_covariance.bottomRightCorner<6, 6>() = shift;
  GraspCounts counts;
  PlanGrasps(scene, 0, options, &counts);
  EXPECT_EQ(counts.blocked, 3);  // each errs on its own
  scene.joint_covariance.topRightCorner<6, 6>() = shift;
  scene.joint_covariance.bottomLeftCorner<6, 6>() = shift;
  EXPECT_EQ(Names(PlanGrasps(scene, 0, options, &counts)), sure);
  EXPECT_EQ(counts.blocked, 0);
}

TEST(PlanGrasps, ThePregraspLiesStraightBeforeTheGrasp) {
  const ObjectModel block = Block();
  GraspScene scene;
  Rigid3 pose;
  pose.R = RotationFromVector({0.1, 0.2, 0.3});
  pose.t = {0.3, 0.2, 0.1};
  scene.objects = {{&block, pose, Matrix6d::Zero()}};
  GraspOptions options;
  for (const SceneGrasp& g : PlanGrasps(scene, 0, options)) {
    const Rigid3 gripper_from_pregrasp = g.scene_from_gripper.Inverse() * g.scene_from_pregrasp;
    EXPECT_LT((gripper_from_pregrasp.t - Eigen::Vector3d(0, 0, -options.approach_m)).norm(), 1e-12);
    EXPECT_LT((gripper_from_pregrasp.R - Eigen::Matrix3d::Identity()).norm(), 1e-12);
  }
}

TEST(BoxMeetsTriangle, AgreesWithDensePoints) {
  constexpr unsigned kSeed = 8;
  std::mt19937 rng(kSeed);
  std::uniform_real_distribution<double> u(-1.0, 1.0);
  int met = 0;
  for (int trial = 0; trial < 2000; ++trial) {
    const Eigen::Vector3d half(0.1 + 0.3 * std::abs(u(rng)), 0.2, 0.3);
    const Eigen::Vector3d center(u(rng), u(rng), u(rng));
    const Eigen::Matrix3d R = RotationFromVector({u(rng), u(rng), u(rng)});
    const Eigen::Vector3d a(u(rng), u(rng), u(rng)), b(u(rng), u(rng), u(rng)),
        c(u(rng), u(rng), u(rng));
    // Largest margin by which a point of the triangle is inside the box.
    double deepest = -1e9;
    for (int i = 0; i <= 60; ++i) {
      for (int j = 0; i + j <= 60; ++j) {
        const Eigen::Vector3d x = a + (b - a) * (i / 60.0) + (c - a) * (j / 60.0);
        deepest = std::max(deepest, (half - (R.transpose() * (x - center)).cwiseAbs()).minCoeff());
      }
    }
    const bool meets = BoxMeetsTriangle(center, R, half, a, b, c);
    met += meets;
    if (deepest > 0.0) {
      EXPECT_TRUE(meets) << "seed " << kSeed << " trial " << trial;
    }
    if (deepest < -0.05) {
      EXPECT_FALSE(meets) << "seed " << kSeed << " trial " << trial;
    }
  }
  EXPECT_GT(met, 100);
  EXPECT_LT(met, 1900);
}

}  // namespace
}  // namespace horopter
