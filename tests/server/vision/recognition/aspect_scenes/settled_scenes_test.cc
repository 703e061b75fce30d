#include "server/vision/recognition/aspect_scenes/settled_scenes.h"

#include <gtest/gtest.h>

namespace horopter {
namespace {

LinkedScene Scene(const std::vector<double>& scores, int registered) {
  LinkedScene scene;
  scene.views.resize(4);
  for (int v = 0; v < registered; ++v) scene.views[v] = AspectSceneView{};
  for (std::size_t i = 0; i < scores.size(); ++i) {
    LinkedObject o;
    o.object = static_cast<int>(i);
    o.score = scores[i];
    scene.objects.push_back(o);
  }
  return scene;
}

std::vector<AspectModel> Models(bool first_is_round) {
  std::vector<AspectModel> models(3);
  if (first_is_round) models[0].round.emplace_back();
  return models;
}

TEST(IsCredible, TwoViewsAndAFairObject) {
  EXPECT_TRUE(IsCredible(Scene({0.5}, 2)));
  EXPECT_FALSE(IsCredible(Scene({0.5}, 1)));
  EXPECT_FALSE(IsCredible(Scene({0.4}, 4)));
  EXPECT_FALSE(IsCredible(Scene({}, 4)));
}

TEST(PartsSettle, AnotherObjectAgreesOrOneAloneLeavesNoDoubt) {
  EXPECT_TRUE(PartsSettle(Scene({0.55, 0.52}, 4), Models(true)));
  EXPECT_FALSE(PartsSettle(Scene({0.6, 0.45}, 4), Models(false)));
  EXPECT_TRUE(PartsSettle(Scene({0.7}, 4), Models(false)));
  EXPECT_FALSE(PartsSettle(Scene({0.6}, 4), Models(false)));
  EXPECT_FALSE(PartsSettle(Scene({0.9}, 4), Models(true)));  // views may turn about its axis
  EXPECT_FALSE(PartsSettle(Scene({}, 4), Models(false)));
}

TEST(PartsSettle, NotWhereViewsShowDifferentSurfaces) {
  LinkedScene scene = Scene({0.9}, 4);
  scene.agreement.surface.mean = 0.2;
  scene.agreement.surface.pairs = 12;
  EXPECT_FALSE(PartsSettle(scene, Models(false)));
  scene.agreement.surface.mean = 0.6;
  EXPECT_TRUE(PartsSettle(scene, Models(false)));
}

TEST(GroundSettles, ThreeViewsThatAgreeOnTheGroundOfAGoodObject) {
  ViewAgreement agreement;
  agreement.ground = 0.4;
  EXPECT_TRUE(GroundSettles(Scene({0.55}, 3), agreement));
  EXPECT_FALSE(GroundSettles(Scene({0.55}, 2), agreement));
  EXPECT_FALSE(GroundSettles(Scene({0.45}, 4), agreement));
  EXPECT_FALSE(GroundSettles(Scene({}, 4), agreement));
  agreement.ground = 0.3;
  EXPECT_FALSE(GroundSettles(Scene({0.9}, 4), agreement));
}

}  // namespace
}  // namespace horopter
