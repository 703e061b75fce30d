#include "server/vision/recognition/object/prepared_object.h"

#include <gtest/gtest.h>

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <random>

#include "server/vision/recognition/object/prepared_blob.h"
#include "tests/support/solid_meshes.h"
#include "tests/support/synthetic_part.h"
#include "tests/support/view_sphere.h"

namespace horopter {
namespace {

ObjectModel Box(double x, double y, double z) {
  return Prism("box", {{0, 0}, {x, 0}, {x, y}, {0, y}}, z);
}

TEST(PrepareObject, SamplesOfNineOfTwelveBoxEdgesAreSeenFromACorner) {
  const auto box = PrepareObject(Box(0.05, 0.06, 0.07));
  ASSERT_TRUE(box.ok());
  const std::vector<double> seen = EdgesSeenFrom(**box, {0.6, 0.7, 0.8});
  int visible = 0;
  for (const double share : seen) {
    EXPECT_TRUE(share > 0.9 || share < 0.1) << share;
    visible += share > 0.9;
  }
  EXPECT_EQ(seen.size(), 12u);
  EXPECT_EQ(visible, 9);
}

TEST(PrepareObject, SamplesLieOnTheirEdges) {
  const auto part = PrepareObject(LBracket());
  ASSERT_TRUE(part.ok());
  for (const EdgeSample& s : (*part)->samples) {
    const auto& line = (*part)->model.edges[s.edge].polyline;
    const Eigen::Vector3d along = (line[1] - line[0]).normalized();
    EXPECT_LT((s.point.cast<double>() - line[0]).cross(along).norm(), 1e-7);
  }
}

TEST(PrepareObject, ASmoothPartIsKnownByItsAspects) {
  ObjectModel ball;
  ball.id = "ball";
  ball.mesh = SphereMesh(0.02, 24);
  ball.diameter_m = 0.04;
  const auto made = PrepareObject(ball, {.aspects = true});
  ASSERT_TRUE(made.ok()) << made.status();
  EXPECT_TRUE((*made)->sphere);
  EXPECT_TRUE((*made)->samples.empty());
  ASSERT_NE((*made)->aspects, nullptr);
  EXPECT_FALSE((*made)->aspects->fragments.fragments.empty());
  EXPECT_FALSE((*made)->stable_poses.empty());
  const PreparedBytes bytes = EncodePrepared(**made, {.aspects = true});
  const auto restored = RestorePrepared(ball, bytes, {.aspects = true});
  ASSERT_TRUE(restored.ok()) << restored.status();
  EXPECT_EQ(EncodePrepared(**restored, {.aspects = true}), bytes);
}

TEST(PrepareObject, RefusesModelsWithoutMeshOrExtent) {
  ObjectModel no_mesh = LBracket();
  no_mesh.mesh.triangles.clear();
  EXPECT_EQ(PrepareObject(no_mesh).status().code(), absl::StatusCode::kInvalidArgument);
  ObjectModel flat = LBracket();
  flat.diameter_m = 0.0;
  EXPECT_EQ(PrepareObject(flat).status().code(), absl::StatusCode::kInvalidArgument);
}

TEST(StablePoses, RoundPartsRollAndFewPosesStandForAll) {
  const auto cylinder = FindStablePoses(CylinderMesh(0.02, 0.03, 64));
  int flat = 0;
  double widest = 0.0;
  for (const StablePose& p : cylinder) flat += !p.rolls;
  EXPECT_EQ(flat, 2);
  EXPECT_LE(static_cast<int>(cylinder.size()), kRollingPoses + 2);
  for (int i = 0; i < 360; ++i) {
    const Eigen::Vector3d d(std::cos(i * M_PI / 180), std::sin(i * M_PI / 180), 0.0);
    double nearest = M_PI;
    for (const StablePose& p : cylinder) {
      if (!p.rolls) continue;
      EXPECT_NEAR(p.height_m, 0.02, 1e-4);
      nearest = std::min(nearest, std::acos(std::clamp(p.up.dot(d), -1.0, 1.0)));
    }
    widest = std::max(widest, nearest);
  }
  // Of 64 facets every third may be left alone: 1.5 x 360 / 64 degrees.
  EXPECT_LT(widest, 1.51 * 2 * M_PI / 64);
  const auto ball = FindStablePoses(SphereMesh(0.02, 40));  // 3122 vertices
  EXPECT_FALSE(ball.empty());
  EXPECT_LE(static_cast<int>(ball.size()), kRollingPoses);
  for (const StablePose& p : ball) EXPECT_TRUE(p.rolls);
  for (const StablePose& p : FindStablePoses(Box(0.05, 0.06, 0.07).mesh)) EXPECT_FALSE(p.rolls);
}

TEST(StablePoses, BoxRestsOnItsSixFaces) {
  const std::vector<StablePose> poses = FindStablePoses(Box(0.05, 0.06, 0.07).mesh);
  ASSERT_EQ(poses.size(), 6u);
  for (const StablePose& p : poses) {
    EXPECT_NEAR(p.up.cwiseAbs().maxCoeff(), 1.0, 1e-3);
    EXPECT_GE(p.margin_m, 0.0249);
  }
}

TEST(StablePoses, LowestPointTouchesThePlane) {
  const ObjectModel part = LBracket();
  const auto poses = FindStablePoses(part.mesh);
  ASSERT_FALSE(poses.empty());
  for (const StablePose& p : poses) {
    double lowest = 1e9;
    for (const auto& v : part.mesh.vertices) lowest = std::min(lowest, p.up.dot(v));
    EXPECT_NEAR(lowest, -p.height_m, 1e-3);
  }
}

TEST(StablePoses, FlatAndEmptyMeshesHaveNone) {
  EXPECT_TRUE(FindStablePoses({}).empty());
  TriangleMesh flat;
  flat.vertices = {{0, 0, 0}, {1, 0, 0}, {1, 1, 0}, {0, 1, 0}};
  flat.triangles = {{0, 1, 2}, {0, 2, 3}};
  EXPECT_TRUE(FindStablePoses(flat).empty());
}

}  // namespace
}  // namespace horopter
