#include "server/vision/recognition/initialization/plane_initialization.h"

#include <gtest/gtest.h>

#include "tests/support/synthetic_table.h"

namespace horopter {
namespace {

class Noise : public testing::TestWithParam<double> {};

TEST_P(Noise, FindAPartAndTheScale) {
  const Rigid3 truth = Standing(0.7, 0.02, -0.01, 0);
  Table table = MakeTable({{0, truth}}, 4, GetParam(), 13);
  const JointContext context = table.Context();
  constexpr double kUnits = 2.7;  // per metre
  Reconstruction reconstruction;
  for (std::size_t v = 0; v < table.cameras.size(); ++v) {
    CalibratedView view;
    view.camera = table.cameras[v];
    view.camera_from_scene = table.camera_from_table[v];
    view.camera_from_scene.t *= kUnits;
    reconstruction.views.push_back(view);
  }
  const std::vector<SceneModel> found = PlaneInitialScenes(context, reconstruction);
  ASSERT_FALSE(found.empty());
  const SceneModel& best = found[0];
  ASSERT_EQ(best.objects[0].object, 0);
  for (std::size_t v = 0; v < table.cameras.size(); ++v) {
    ASSERT_TRUE(best.views[v]);
    EXPECT_LT(
        ProjectionDistance(*table.objects[0],
                           best.views[v]->camera,
                           best.views[v]->camera_from_scene * best.objects[0].scene_from_object,
                           table.cameras[v],
                           table.camera_from_table[v] * truth,
                           1.0),
        5.0);
  }
}

INSTANTIATE_TEST_SUITE_P(Sweep, Noise, testing::Values(0.0, 0.3, 0.6));

TEST(PlaneInitialScenes, NeedTwoViews) {
  Table table = MakeTable({{0, Standing(0.7, 0.02, -0.01, 0)}}, 1, 0.0, 15);
  Reconstruction reconstruction;
  reconstruction.views.resize(1);
  EXPECT_TRUE(PlaneInitialScenes(table.Context(), reconstruction).empty());
}

// A scale that objects of several kinds agree on is surer than one that a single object fits best.
TEST(BestScales, ScalesThatOtherObjectsShareComeFirstAndEachScaleOnce) {
  const auto scaled = [](int object, double score, double units) {
    ScaledHypothesis h;
    h.units_per_metre = units;
    PlacedObject p;
    p.object = object;
    p.score = score;
    p.total.supported = 1000.0;
    p.total.sharp = 1000.0 * score;
    p.description_gain = 100.0 * score;
    h.scene.objects.push_back(p);
    h.scene.description_gain = p.description_gain;
    return h;
  };
  const std::vector<SceneModel> best = BestScales({scaled(0, 0.80, 2.0),
                                                   scaled(1, 0.78, 1.0),
                                                   scaled(2, 0.77, 1.01),
                                                   scaled(1, 0.50, 4.0),
                                                   ScaledHypothesis{}},
                                                  2,
                                                  20);
  ASSERT_EQ(best.size(), 2u);
  EXPECT_EQ(best[0].objects[0].object, 1);
  EXPECT_EQ(best[1].objects[0].object, 0);
  EXPECT_TRUE(BestScales({}, 3, 20).empty());
}

}  // namespace
}  // namespace horopter
