#include "server/vision/recognition/interpretation/scene_expansion.h"

#include <gtest/gtest.h>

#include <Eigen/Geometry>

#include "server/vision/recognition/initialization/view_linking.h"
#include "tests/support/synthetic_table.h"

namespace horopter {
namespace {

const Rigid3 kBracket = Standing(0.4, -0.08, 0.02, 0), kOther = Standing(2.2, 0.10, 0.09, 0);
const Rigid3 kWedge = Standing(1.1, 0.06, -0.05, 0);

// Two brackets and a wedge, of which every third edge is hidden in every view by something unknown.
struct HiddenWedge {
  Table table;
  JointContext context;
  SceneModel scene;  // the brackets

  explicit HiddenWedge(unsigned seed) {
    const std::vector<Shown> brackets = {{0, kBracket}, {0, kOther}};
    std::vector<Shown> all = brackets;
    all.push_back({1, kWedge});
    const Table without = MakeTable(brackets, 4, 0.2, seed);
    table = MakeTable(all, 4, 0.2, seed);
    for (std::size_t v = 0; v < table.features.size(); ++v) {
      std::vector<Segment>& segments = table.features[v].segments;
      for (std::size_t i = without.features[v].segments.size(); i < segments.size(); i += 3)
        segments[i].start = segments[i].end = {1.0, 1.0};
    }
    context = table.Context();
    for (std::size_t v = 0; v < table.cameras.size(); ++v)
      scene.views.push_back(CalibratedCamera{table.cameras[v], table.camera_from_table[v]});
    scene.plane = SupportingPlane();
    for (const Shown& s : brackets) {
      PlacedObject& placed = scene.objects.emplace_back();
      placed.object = s.object;
      placed.scene_from_object = s.plane_from_object;
    }
    EvaluateTogether(context, &scene);
  }

  PlacedObject At(const Rigid3& pose) const {
    PlacedObject p;
    p.object = 1;
    p.scene_from_object = pose;
    VerifyScratch scratch;
    EvaluatePlacement(context, scene.views, {}, &scratch, &p);
    return p;
  }
};

TEST(AddHiddenObjects, AddsThePartThatStandsAndFitsSharply) {
  for (unsigned seed = 1; seed <= 4; ++seed) {
    SCOPED_TRACE(seed);
    HiddenWedge hidden(seed);
    const PlacedObject right = hidden.At(kWedge);
    PlacementAcceptance& acceptance = hidden.context.options.acceptance.placements;
    ASSERT_GT(right.score, acceptance.hidden_score - acceptance.hidden_slack);
    acceptance.hidden_score = std::min(acceptance.hidden_score, right.score - 0.02);
    AddHiddenObjects(hidden.context, std::vector<PlacedObject>{right}, &hidden.scene);
    ASSERT_EQ(hidden.scene.objects.size(), 3u);
    EXPECT_EQ(hidden.scene.objects[2].object, 1);
    EXPECT_LT((hidden.scene.objects[2].scene_from_object.t - kWedge.t).norm(), 0.002);
    // Once is enough.
    AddHiddenObjects(hidden.context, std::vector<PlacedObject>{right}, &hidden.scene);
    EXPECT_EQ(hidden.scene.objects.size(), 3u);
  }
}

TEST(AddHiddenObjects, FloatingPartsAndScenesOfOnePartGetNone) {
  HiddenWedge hidden(5);
  PlacementAcceptance& acceptance = hidden.context.options.acceptance.placements;
  acceptance.hidden_score = 0.3;
  acceptance.hidden_sharpness = 0.3;
  Rigid3 floating = kWedge, lying = kWedge;
  floating.t.z() += 0.03;
  lying.R = lying.R * Eigen::AngleAxisd(0.5, Eigen::Vector3d::UnitX());
  const std::vector<PlacedObject> candidates = {hidden.At(floating), hidden.At(lying)};
  AddHiddenObjects(hidden.context, candidates, &hidden.scene);
  EXPECT_EQ(hidden.scene.objects.size(), 2u);
  const std::vector<PlacedObject> right = {hidden.At(kWedge)};
  SceneModel alone = hidden.scene;
  alone.objects.pop_back();
  AddHiddenObjects(hidden.context, right, &alone);
  EXPECT_EQ(alone.objects.size(), 1u);
  SceneModel in_the_air = hidden.scene;
  in_the_air.plane.reset();
  AddHiddenObjects(hidden.context, right, &in_the_air);
  EXPECT_EQ(in_the_air.objects.size(), 2u);
}

// A camera that shows one bracket where the other is, and the rest nowhere.
TEST(DropContradictedViews, DropsTheViewThatShowsOnePartAndLosesTheOthers) {
  HiddenWedge hidden(6);
  hidden.scene.objects.push_back(hidden.At(kWedge));
  hidden.table.matching.component.assign(4, -1);
  SceneModel scene = hidden.scene;
  EXPECT_EQ(DropContradictedViews(hidden.context, &scene), 0);
  scene.views[2]->camera_from_scene =
      scene.views[2]->camera_from_scene * kOther * kBracket.Inverse();
  EXPECT_EQ(DropContradictedViews(hidden.context, &scene), 1);
  EXPECT_FALSE(scene.views[2].has_value());
  EXPECT_EQ(scene.registered(), 3);
}

}  // namespace
}  // namespace horopter
