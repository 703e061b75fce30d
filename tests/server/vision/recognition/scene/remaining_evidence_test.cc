#include "server/vision/recognition/scene/remaining_evidence.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <optional>

#include "tests/support/synthetic_table.h"

namespace horopter {
namespace {

SceneModel SceneOf(const Table& table,
                   const JointContext& context,
                   int object,
                   const Rigid3& pose) {
  SceneModel scene;
  for (std::size_t v = 0; v < table.cameras.size(); ++v)
    scene.views.push_back(CalibratedCamera{table.cameras[v], table.camera_from_table[v]});
  PlacedObject& placed = scene.objects.emplace_back();
  placed.object = object;
  placed.scene_from_object = pose;
  EvaluateTogether(context, &scene);
  return scene;
}

int Unexplained(const ImageFeatures& features) {
  return static_cast<int>(std::count_if(features.segments.begin(),
                                        features.segments.end(),
                                        [](const Segment& s) { return !s.in_texture; }));
}

TEST(WithoutExplained, LeavesTheOtherPart) {
  const Rigid3 bracket = Standing(0.4, -0.04, 0, 0), wedge = Standing(1.1, 0.08, 0.02, 0);
  Table both = MakeTable({{0, bracket}, {1, wedge}}, 4, 0.2, 7);
  const Table alone = MakeTable({{1, wedge}}, 4, 0.2, 7);
  const JointContext context = both.Context();
  const SceneModel scene = SceneOf(both, context, 0, bracket);
  const RemainingEvidence rest = WithoutExplained(context, scene, 1.0);
  VerifyScratch scratch;
  for (std::size_t v = 0; v < both.features.size(); ++v) {
    SCOPED_TRACE(v);
    EXPECT_EQ((*rest.features)[v].segments.size(), both.features[v].segments.size());
    EXPECT_NEAR(Unexplained((*rest.features)[v]), Unexplained(alone.features[v]), 1);
    const auto precision = [&](const JointContext& c, int object, const Rigid3& pose) {
      return VerifyPose(*both.objects[object],
                        c.views[v],
                        both.cameras[v],
                        both.camera_from_table[v] * pose,
                        nullptr,
                        &scratch)
          .Precision();
    };
    EXPECT_GT(precision(context, 0, bracket), 0.9);
    EXPECT_LT(precision(rest.context, 0, bracket), 0.3);
    EXPECT_GT(precision(rest.context, 1, wedge), 0.8);
  }
}

TEST(WithoutExplained, DoubtfulPartsExplainNothing) {
  const Rigid3 bracket = Standing(0.4, -0.04, 0, 0);
  Table table = MakeTable({{0, bracket}}, 3, 0.2, 8);
  const JointContext context = table.Context();
  const SceneModel scene = SceneOf(table, context, 0, bracket);
  const RemainingEvidence rest = WithoutExplained(context, scene, 1e9);
  for (std::size_t v = 0; v < table.features.size(); ++v) {
    EXPECT_EQ(Unexplained((*rest.features)[v]), Unexplained(table.features[v]));
    EXPECT_EQ(rest.context.views[v].maps.points.size(), context.views[v].maps.points.size());
  }
}

TEST(WithoutExplained, ViewsWithoutCameraHaveNoMaps) {
  const Rigid3 bracket = Standing(0.4, -0.04, 0, 0);
  Table table = MakeTable({{0, bracket}}, 3, 0.2, 9);
  const JointContext context = table.Context();
  SceneModel scene = SceneOf(table, context, 0, bracket);
  scene.views[1].reset();
  const RemainingEvidence rest = WithoutExplained(context, scene, 1.0);
  EXPECT_TRUE(rest.context.views[1].maps.points.empty());
  EXPECT_EQ(Unexplained((*rest.features)[1]), Unexplained(table.features[1]));
}

TEST(WithoutExplained, AHurryReachesTheSearchInTheRest) {
  const Rigid3 bracket = Standing(0.4, -0.04, 0, 0);
  Table table = MakeTable({{0, bracket}}, 3, 0.2, 10);
  bool hurry = false;
  JointContext context = table.Context();
  context.give_up = [&] { return hurry; };
  const RemainingEvidence rest =
      WithoutExplained(context, SceneOf(table, context, 0, bracket), 1.0);
  EXPECT_FALSE(IsStopRequested(rest.context.give_up));
  hurry = true;
  EXPECT_TRUE(IsStopRequested(rest.context.give_up));
}

TEST(WithoutExplained, ACopyOutlivesItsOriginal) {
  const Rigid3 bracket = Standing(0.4, -0.04, 0, 0);
  Table table = MakeTable({{0, bracket}}, 3, 0.2, 11);
  const JointContext context = table.Context();
  std::optional<RemainingEvidence> original =
      WithoutExplained(context, SceneOf(table, context, 0, bracket), 1.0);
  const RemainingEvidence copy = *original;
  original.reset();
  for (std::size_t v = 0; v < table.features.size(); ++v) {
    EXPECT_EQ(copy.context.views[v].features, &(*copy.features)[v]);
    EXPECT_EQ(copy.context.views[v].features->segments.size(), table.features[v].segments.size());
  }
}

}  // namespace
}  // namespace horopter
