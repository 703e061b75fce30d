#include "server/vision/recognition/initialization/view_linking.h"

#include <gtest/gtest.h>

#include <Eigen/Geometry>

#include "tests/support/synthetic_table.h"

namespace horopter {
namespace {

Eigen::Matrix3d PlaneMap(const PinholeCamera& camera, const Rigid3& camera_from_table) {
  Eigen::Matrix3d M;
  M << camera_from_table.R.col(0), camera_from_table.R.col(1), camera_from_table.t;
  return camera.K() * M;
}

// A bracket in four views; each view has the true hypothesis of it.
struct LinkedTable {
  Rigid3 truth = Standing(0.4, 0.02, 0.0, 0);
  Table table = MakeTable({{0, truth}}, 4, 0.2, 31);
  JointContext context;
  HypothesisTable hypotheses;

  // plane: with homographies of the plane, else every view in a component of its own.
  explicit LinkedTable(bool plane) {
    for (std::size_t v = 0; v < table.cameras.size(); ++v) {
      table.matching.view_from_plane[v] = PlaneMap(table.cameras[v], table.camera_from_table[v]);
      if (!plane) table.matching.component[v] = -1;
    }
    context = table.Context();
    hypotheses = table.NoHypotheses();
    for (int v = 0; v < 4; ++v) {
      ViewHypothesis h;
      h.object = 0;
      h.view = v;
      h.camera = table.cameras[v];
      h.camera_from_object = table.camera_from_table[v] * truth;
      h.score = 0.8;
      hypotheses[v][0].best.push_back(h);
      hypotheses[v][0].pool.push_back(h);
    }
  }
  double Error(const SceneModel& scene, std::size_t v) const {
    return ProjectionDistance(
        *table.objects[0],
        scene.views[v]->camera,
        scene.views[v]->camera_from_scene * scene.objects[0].scene_from_object,
        table.cameras[v],
        table.camera_from_table[v] * truth,
        1.0);
  }
};

TEST(PlaneTransfer, TakesPlanePointsFromViewToViewWithinOneChain) {
  LinkedTable linked(true);
  linked.table.matching.component[3] = 1;
  const auto& t = linked.table;
  const auto H = PlaneTransfer(t.matching, 0, 2);
  ASSERT_TRUE(H.has_value());
  for (const Eigen::Vector3d& p :
       {Eigen::Vector3d(0.05, 0.02, 0), Eigen::Vector3d(-0.1, 0.07, 0)}) {
    const Eigen::Vector2d from = Project(t.cameras[0], t.camera_from_table[0] * p);
    const Eigen::Vector2d to = Project(t.cameras[2], t.camera_from_table[2] * p);
    EXPECT_LT(((*H * from.homogeneous()).hnormalized() - to).norm(), 1e-6);
  }
  EXPECT_FALSE(PlaneTransfer(t.matching, 0, 3).has_value());
}

TEST(LinkedByPlane, NeedsAnotherRegisteredViewOfTheChain) {
  LinkedTable linked(true);
  SceneModel scene;
  scene.views.resize(4);
  scene.views[0] = CalibratedCamera{linked.table.cameras[0], linked.table.camera_from_table[0]};
  EXPECT_FALSE(LinkedByPlane(linked.context, scene, 0));
  scene.views[1] = CalibratedCamera{linked.table.cameras[1], linked.table.camera_from_table[1]};
  EXPECT_TRUE(LinkedByPlane(linked.context, scene, 0));
  EXPECT_FALSE(LinkedByPlane(LinkedTable(false).context, scene, 0));
}

TEST(LinkedInitialScenes, LinkAllViewsThroughThePlaneAndWithoutIt) {
  for (const bool plane : {true, false}) {
    SCOPED_TRACE(plane);
    const LinkedTable linked(plane);
    // Hypotheses of the other kind of views are not asked.
    EXPECT_TRUE(LinkedInitialScenes(linked.context, linked.hypotheses, !plane).empty());
    const std::vector<SceneModel> found =
        LinkedInitialScenes(linked.context, linked.hypotheses, plane);
    ASSERT_FALSE(found.empty());
    const SceneModel& best = found[0];
    ASSERT_EQ(best.objects.size(), 1u);
    EXPECT_EQ(best.objects[0].object, 0);
    EXPECT_GE(best.registered(), 3);
    for (std::size_t v = 0; v < 4; ++v) {
      if (best.views[v]) {
        EXPECT_LT(linked.Error(best, v), 5.0) << v;
      }
    }
  }
}

TEST(RegisterMissingViews, AddsTheViewFromItsOwnHypotheses) {
  const LinkedTable linked(false);
  SceneModel scene;
  for (int v = 0; v < 4; ++v) {
    scene.views.push_back(
        CalibratedCamera{linked.table.cameras[v], linked.table.camera_from_table[v]});
  }
  PlacedObject& placed = scene.objects.emplace_back();
  placed.object = 0;
  placed.scene_from_object = linked.truth;
  EvaluateTogether(linked.context, &scene);
  EXPECT_EQ(RegisterMissingViews(linked.context, linked.hypotheses, &scene), 0);  // none is missing
  scene.views[2].reset();
  EXPECT_EQ(RegisterMissingViews(linked.context, linked.hypotheses, &scene), 1);
  ASSERT_TRUE(scene.views[2].has_value());
  EXPECT_LT(linked.Error(scene, 2), 3.0);
}

}  // namespace
}  // namespace horopter
