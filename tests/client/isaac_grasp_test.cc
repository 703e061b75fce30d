#include "client/isaac_grasp.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "client/bop_dataset.h"
#include "client/bop_export.h"
#include "tests/client/temp_folder.h"

namespace horopter {
namespace {

using testing::HasSubstr;

constexpr char kFile[] = R"(format: isaac_grasp
format_version: "1.0"
object_frame_link: /World/part
gripper_frame_link: /World/hand
grasps:
  grasp_0:
    confidence: 0.75
    position: [0.01, -0.02, 0.03]
    orientation: {w: 0.7071067811865476, xyz: [0.7071067811865476, 0.0, 0.0]}
    cspace_position: {finger_joint: 0.01}
    pregrasp_cspace_position: {left: 0.02, right: 0.03}
)";

TEST(IsaacGraspTest, ReadsPoseQualityAndOpenings) {
  TempFolder folder;
  const auto grasps = ReadGrasps(folder.Write("g.yaml", kFile));
  ASSERT_TRUE(grasps.ok()) << grasps.status();
  ASSERT_EQ(grasps->size(), 1u);
  const Grasp& g = grasps->front();
  EXPECT_EQ(g.name, "grasp_0");
  EXPECT_DOUBLE_EQ(g.quality, 0.75);
  EXPECT_DOUBLE_EQ(g.grip_width_m, 0.02);   // one joint: both fingers
  EXPECT_DOUBLE_EQ(g.jaw_opening_m, 0.05);  // two joints: their sum
  EXPECT_LT((g.object_from_gripper.R.col(2) - Eigen::Vector3d(0, -1, 0)).norm(), 1e-12);
  EXPECT_LT((g.object_from_gripper.t - Eigen::Vector3d(0.01, -0.02, 0.03)).norm(), 1e-15);
}

TEST(IsaacGraspTest, WhatIsWrittenReadsBack) {
  TempFolder folder;
  const auto grasps = ReadIsaacGrasps(folder.Write("g.yaml", kFile)).value();
  const std::string path = folder.path() + "/h.yaml";
  ASSERT_TRUE(WriteIsaacGrasps(path, "part", grasps).ok());
  const auto again = ReadIsaacGrasps(path);
  ASSERT_TRUE(again.ok()) << again.status();
  ASSERT_EQ(again->size(), 1u);
  EXPECT_EQ((*again)[0].name, grasps[0].name);
  EXPECT_DOUBLE_EQ((*again)[0].jaw_opening_m, grasps[0].jaw_opening_m);
  EXPECT_DOUBLE_EQ((*again)[0].grip_width_m, grasps[0].grip_width_m);
  EXPECT_LT(((*again)[0].object_from_gripper.R - grasps[0].object_from_gripper.R).norm(), 1e-12);
}

TEST(IsaacGraspTest, PreGraspsGoBothWaysInYamlAndJson) {
  TempFolder folder;
  std::string text = kFile;
  text +=
      "    pregrasp_position: [0.01, 0.08, 0.03]\n"
      "    pregrasp_orientation: {w: 0.7071067811865476, xyz: [0.7071067811865476, 0.0, 0.0]}\n";
  const auto grasps = ReadIsaacGrasps(folder.Write("g.yaml", text));
  ASSERT_TRUE(grasps.ok()) << grasps.status();
  ASSERT_TRUE((*grasps)[0].object_from_pregrasp);
  const Rigid3 before = *(*grasps)[0].object_from_pregrasp;
  EXPECT_LT((before.t - Eigen::Vector3d(0.01, 0.08, 0.03)).norm(), 1e-15);
  ASSERT_TRUE(WriteIsaacGrasps(folder.path() + "/h.yaml", "part", *grasps).ok());
  ASSERT_TRUE(WriteGrasps(folder.path() + "/h.json", *grasps).ok());
  for (const char* name : {"/h.yaml", "/h.json"}) {
    const auto again = ReadGrasps(folder.path() + name);
    ASSERT_TRUE(again.ok()) << again.status();
    ASSERT_TRUE((*again)[0].object_from_pregrasp) << name;
    EXPECT_LT(((*again)[0].object_from_pregrasp->t - before.t).norm(), 1e-12) << name;
    EXPECT_LT(((*again)[0].object_from_pregrasp->R - before.R).norm(), 1e-12) << name;
  }
  text.replace(text.rfind("w: 0.7"), 6, "w: 9.7");
  EXPECT_THAT(std::string(ReadIsaacGrasps(folder.Write("b.yaml", text)).status().message()),
              HasSubstr("grasp_0: pregrasp: the orientation"));
}

TEST(IsaacGraspTest, AnExportedObjectHasItsGraspsInBothForms) {
  TempFolder folder;
  BopExportEntry entry;
  entry.obj_id = 3;
  entry.model.grasps = ReadIsaacGrasps(folder.Write("g.yaml", kFile)).value();
  ASSERT_TRUE(WriteBopObject(folder.path(), entry).ok());
  for (const char* name : {"/grasps/obj_000003.yaml", "/grasps/obj_000003.json"}) {
    const auto again = ReadGrasps(folder.path() + name);
    ASSERT_TRUE(again.ok()) << again.status();
    ASSERT_EQ(again->size(), entry.model.grasps.size()) << name;
    const Grasp &a = again->front(), &b = entry.model.grasps.front();
    EXPECT_EQ(a.name, b.name);
    EXPECT_LT((a.object_from_gripper.t - b.object_from_gripper.t).norm(), 1e-12) << name;
    EXPECT_NEAR(a.jaw_opening_m, b.jaw_opening_m, 1e-12) << name;
  }
}

TEST(IsaacGraspTest, RefusalsNameTheGrasp) {
  TempFolder folder;
  const auto refusal = [&](const std::string& text) {
    const auto status = ReadIsaacGrasps(folder.Write("bad.yaml", text)).status();
    EXPECT_EQ(status.code(), absl::StatusCode::kInvalidArgument);
    return std::string(status.message());
  };
  EXPECT_THAT(refusal("a: 1\n"), HasSubstr("isaac_grasp"));
  EXPECT_THAT(refusal("[unclosed"), HasSubstr("bad.yaml"));
  std::string text = kFile;
  text.replace(text.find("0.7071067811865476"), 18, "7.0");
  EXPECT_THAT(refusal(text), HasSubstr("grasp_0: the orientation"));
  text = kFile;
  text.replace(text.find("[0.01"), 5, "[x");
  EXPECT_THAT(refusal(text), HasSubstr("grasp_0"));
  EXPECT_EQ(ReadIsaacGrasps(folder.path() + "/none.yaml").status().code(),
            absl::StatusCode::kNotFound);
}

}  // namespace
}  // namespace horopter
