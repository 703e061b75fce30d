#include "server/vision/geometry/grasp_check.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

namespace horopter {
namespace {

using testing::ElementsAre;
using testing::HasSubstr;
using testing::IsEmpty;

// Box of 40 x 30 x 20 mm with its lower corner in the origin, gripped from above along x.
ObjectModel GrippedBox() {
  ObjectModel m;
  for (int i = 0; i < 8; ++i) {
    m.mesh.vertices.emplace_back(i & 1 ? 0.04 : 0, i & 2 ? 0.03 : 0, i & 4 ? 0.02 : 0);
  }
  const int faces[6][4] = {
      {0, 2, 3, 1}, {4, 5, 7, 6}, {0, 1, 5, 4}, {2, 6, 7, 3}, {0, 4, 6, 2}, {1, 3, 7, 5}};
  for (const auto& f : faces) {
    m.mesh.triangles.emplace_back(f[0], f[1], f[2]);
    m.mesh.triangles.emplace_back(f[0], f[2], f[3]);
  }
  m.diameter_m = 0.054;
  Grasp grasp;
  grasp.name = "top";
  grasp.object_from_gripper.R << 1, 0, 0, 0, -1, 0, 0, 0, -1;  // z down
  grasp.object_from_gripper.t = {0.02, 0.015, 0.01};
  grasp.jaw_opening_m = 0.05;
  grasp.grip_width_m = 0.04;
  m.grasps = {grasp};
  return m;
}

TEST(GraspCheckTest, AGoodGraspPasses) {
  EXPECT_THAT(CheckGrasps(GrippedBox()), IsEmpty());
}

TEST(GraspCheckTest, NamesWhatDoesNotFit) {
  ObjectModel m = GrippedBox();
  m.grasps[0].jaw_opening_m = 0.038;  // fingers would come down inside
  EXPECT_THAT(CheckGrasps(m), testing::Contains(HasSubstr("top: the part is wider")));
  EXPECT_THAT(CheckGrasps(m), testing::Contains(HasSubstr("passes through")));
  m = GrippedBox();
  m.grasps[0].grip_width_m = 0.03;
  EXPECT_THAT(CheckGrasps(m), ElementsAre(HasSubstr("40.0 mm wide between the fingers")));
  m = GrippedBox();
  m.grasps[0].object_from_gripper.t.z() = 0.03;  // above the part
  EXPECT_THAT(CheckGrasps(m), ElementsAre(HasSubstr("nothing is between")));
  m = GrippedBox();
  m.grasps[0].object_from_gripper.t.x() = 0.035;  // one finger inside
  EXPECT_THAT(CheckGrasps(m), testing::Contains(HasSubstr("passes through")));
}

TEST(GraspCheckTest, APreGraspLiesBeforeTheGraspOnTheApproachAxis) {
  ObjectModel m = GrippedBox();
  Rigid3 before = m.grasps[0].object_from_gripper;
  before.t.z() += 0.1;
  m.grasps[0].object_from_pregrasp = before;
  EXPECT_THAT(CheckGrasps(m), IsEmpty());
  m.grasps[0].object_from_pregrasp->t.x() += 0.02;
  EXPECT_THAT(CheckGrasps(m), ElementsAre(HasSubstr("not along the approach axis")));
  m.grasps[0].object_from_pregrasp = before;
  m.grasps[0].object_from_pregrasp->t.z() = -0.1;
  EXPECT_THAT(CheckGrasps(m), testing::Contains(HasSubstr("not before the part")));
  m.grasps[0].object_from_pregrasp = before;
  m.grasps[0].object_from_pregrasp->R.col(0) *= -1.0;
  m.grasps[0].object_from_pregrasp->R.col(1) *= -1.0;
  EXPECT_THAT(CheckGrasps(m), ElementsAre(HasSubstr("turns after the pre-grasp")));
}

}  // namespace
}  // namespace horopter
