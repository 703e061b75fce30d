#include "server/vision/recognition/initialization/rig_initialization.h"

#include <gtest/gtest.h>

#include <Eigen/Geometry>

#include "tests/support/synthetic_table.h"

namespace horopter {
namespace {

// A part that leans on nothing: its poses come from single views, its scale from the others.
TEST(RigInitialScenes, FindAPartThatDoesNotStand) {
  Rigid3 truth = Standing(0.4, 0.02, 0.0, 0.05);
  truth.R =
      Eigen::AngleAxisd(0.5, Eigen::Vector3d(1, 1, 0).normalized()).toRotationMatrix() * truth.R;
  Table table = MakeTable({{0, truth}}, 4, 0.3, 17);
  const JointContext context = table.Context();
  HypothesisTable hypotheses = table.NoHypotheses();
  constexpr double kUnits = 0.6;  // per metre
  Reconstruction reconstruction;
  for (std::size_t v = 0; v < table.cameras.size(); ++v) {
    CalibratedView view;
    view.camera = table.cameras[v];
    view.camera_from_scene = table.camera_from_table[v];
    view.camera_from_scene.t *= kUnits;
    reconstruction.views.push_back(view);
    ViewHypothesis h;
    h.object = 0;
    h.view = static_cast<int>(v);
    h.camera = table.cameras[v];
    h.camera.focal_px *= 1.1;  // as found with a wrong focal length, so farther away
    h.camera_from_object = table.camera_from_table[v] * truth;
    h.camera_from_object.t *= 1.1;
    h.score = 0.8;
    hypotheses[v][0].best.push_back(h);
  }
  const std::vector<SceneModel> found = RigInitialScenes(context, hypotheses, reconstruction);
  ASSERT_FALSE(found.empty());
  EXPECT_GT(found[0].objects[0].score, 0.6);
  for (std::size_t v = 0; v < table.cameras.size(); ++v) {
    EXPECT_LT(ProjectionDistance(
                  *table.objects[0],
                  found[0].views[v]->camera,
                  found[0].views[v]->camera_from_scene * found[0].objects[0].scene_from_object,
                  table.cameras[v],
                  table.camera_from_table[v] * truth,
                  1.0),
              5.0);
  }
  reconstruction.views.resize(1);
  reconstruction.views.resize(4);
  EXPECT_TRUE(
      RigInitialScenes(context, hypotheses, reconstruction).empty());  // one view has no scale
}

}  // namespace
}  // namespace horopter
