#include "server/vision/recognition/scene/scene_refine.h"

#include <gtest/gtest.h>

#include <cmath>

#include "tests/support/synthetic_table.h"

namespace horopter {
namespace {

// A bracket and a wedge in exact views.
struct TwoObjects {
  Rigid3 bracket = Standing(0.3, 0.0, 0.0, 0), wedge = Standing(1.1, 0.09, 0.03, 0);
  Table table = MakeTable({{0, bracket}, {1, wedge}}, 4, 0.0, 23);
  JointContext context = table.Context();
  SceneModel scene;

  TwoObjects() {
    for (std::size_t v = 0; v < table.cameras.size(); ++v)
      scene.views.push_back(CalibratedCamera{table.cameras[v], table.camera_from_table[v]});
    for (const auto& [object, pose] : {std::pair(0, bracket), std::pair(1, wedge)}) {
      PlacedObject& placed = scene.objects.emplace_back();
      placed.object = object;
      placed.scene_from_object = pose;
    }
  }
  // Largest error of an object in any view as the scene has them, pixels.
  double Error(int k, const Rigid3& truth) const {
    double largest = 0.0;
    for (std::size_t v = 0; v < scene.views.size(); ++v) {
      largest = std::max(
          largest,
          ProjectionDistance(*table.objects[k],
                             scene.views[v]->camera,
                             scene.views[v]->camera_from_scene * scene.objects[k].scene_from_object,
                             table.cameras[v],
                             table.camera_from_table[v] * truth,
                             1.0));
    }
    return largest;
  }
};

TEST(RefineScene, BringsObjectsAndCamerasBackAndFixesTheFirstObject) {
  TwoObjects two;
  two.scene.objects[1].scene_from_object.t.x() += 0.003;
  two.scene.views[2]->camera_from_scene.t.y() += 0.002;
  const double before = std::max(two.Error(0, two.bracket), two.Error(1, two.wedge));
  ASSERT_GT(before, 2.0);
  ASSERT_TRUE(RefineScene(two.context, &two.scene));
  EXPECT_LT(two.Error(0, two.bracket), 0.3 * before);
  EXPECT_LT(two.Error(1, two.wedge), 0.3 * before);
  EXPECT_EQ(two.scene.objects[0].scene_from_object.t, two.bracket.t);
  EXPECT_EQ(two.scene.objects[0].scene_from_object.R, two.bracket.R);
}

TEST(RefineScene, LeavesTheTruthWhereItIs) {
  TwoObjects two;
  ASSERT_TRUE(RefineScene(two.context, &two.scene));
  EXPECT_LT(std::max(two.Error(0, two.bracket), two.Error(1, two.wedge)), 1.5);
}

TEST(RefineScene, WhatWouldTakeTooLongAStepStaysAsItIs) {
  TwoObjects two;
  SceneModel nothing;
  nothing.views = two.scene.views;
  EXPECT_FALSE(RefineScene(two.context, &nothing));
  // Six times the focal length that is known to a thousandth: no small step leads there.
  two.context.focal_log_sigma[0] = 0.001;
  two.scene.views[0]->camera.focal_px *= 6.0;
  const double before = two.scene.views[0]->camera.focal_px;
  EXPECT_FALSE(RefineScene(two.context, &two.scene));
  EXPECT_EQ(two.scene.views[0]->camera.focal_px, before);
  EXPECT_EQ(two.scene.objects[0].scene_from_object.t, two.bracket.t);
}

// Matched points of the plane hold the cameras where a small part alone would let focal length and
// distance compensate each other.
TEST(RefineScene, ThePlanesTextureKeepsTheFocalLengths) {
  const Rigid3 truth = Standing(0.3, 0.0, 0.0, 0);
  double error[2];
  for (const bool textured : {false, true}) {
    Table table = MakeTable({{1, truth}}, 4, 0.8, 16);
    if (textured) {
      for (int a = 0; a < 4; ++a) {
        for (int b = a + 1; b < 4; ++b) {
          PlaneHomography plane;
          plane.view_a = a;
          plane.view_b = b;
          for (int i = -5; i <= 5; ++i) {
            for (int k = -5; k <= 5; ++k) {
              const Eigen::Vector3d p(0.03 * i, 0.03 * k, 0);
              plane.inliers_a.push_back(Project(table.cameras[a], table.camera_from_table[a] * p));
              plane.inliers_b.push_back(Project(table.cameras[b], table.camera_from_table[b] * p));
            }
          }
          table.matching.planes.push_back(plane);
        }
      }
    }
    JointContext context = table.Context();
    SceneModel scene;
    for (std::size_t v = 0; v < table.cameras.size(); ++v) {
      context.focal_log_sigma[v] = 0.35;
      CalibratedCamera view{table.cameras[v], table.camera_from_table[v]};
      view.camera.focal_px *= 1.02;
      scene.views.push_back(view);
    }
    PlacedObject placed;
    placed.object = 1;
    placed.scene_from_object = truth;
    scene.objects.push_back(placed);
    ASSERT_TRUE(RefineScene(context, &scene));
    double worst = 0.0;
    for (std::size_t v = 0; v < table.cameras.size(); ++v) {
      worst = std::max(
          worst, std::abs(std::log(scene.views[v]->camera.focal_px / table.cameras[v].focal_px)));
    }
    error[textured] = worst;
  }
  EXPECT_LT(error[1], 0.04);
  EXPECT_LT(error[1], 0.7 * error[0]);
}

}  // namespace
}  // namespace horopter
