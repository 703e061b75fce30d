#include "server/vision/recognition/aspect_scenes/scene_similarity.h"

#include <gtest/gtest.h>

#include <Eigen/Geometry>
#include <numbers>

namespace horopter {
namespace {

Rigid3 TurnZ(double angle) {
  return {Eigen::AngleAxisd(angle, Eigen::Vector3d::UnitZ()).toRotationMatrix(),
          Eigen::Vector3d::Zero()};
}

// A part of 100 mm that half a turn about z leaves as it is, seen by two cameras.
class IsWithinTest : public testing::Test {
 protected:
  IsWithinTest() {
    aspects_.mesh.diameter_m = 0.1;
    part_.object = &aspects_;
    part_.symmetries = symmetries_;
    for (int v = 0; v < 2; ++v) {
      AspectSceneView view;
      view.camera = CenteredCamera(640, 480, 700.0);
      view.camera_from_scene = {
          Eigen::AngleAxisd(2.5 + 0.3 * v, Eigen::Vector3d::UnitX()).toRotationMatrix(),
          Eigen::Vector3d(0.0, 0.0, 0.5)};
      scene_.views.emplace_back(view);
    }
    scene_.objects.push_back({0, Rigid3{}});
  }

  bool Within(const AspectScene& scene, const AspectScene& other) const {
    return IsWithin(scene, other, {&part_, 1});
  }

  ObjectAspects aspects_;
  std::vector<Rigid3> symmetries_ = {TurnZ(std::numbers::pi)};
  AspectModel part_;
  AspectScene scene_;
};

TEST_F(IsWithinTest, ASceneIsWithinItselfAndOneThatHasMore) {
  EXPECT_TRUE(Within(scene_, scene_));
  AspectScene less = scene_;
  less.views[1].reset();
  EXPECT_TRUE(Within(less, scene_));
  EXPECT_FALSE(Within(scene_, less));
}

TEST_F(IsWithinTest, OneSymmetryForAllViewsChangesNothing) {
  AspectScene turned = scene_;
  turned.objects[0].scene_from_object = TurnZ(std::numbers::pi);
  EXPECT_TRUE(Within(turned, scene_));
  turned.objects[0].scene_from_object = TurnZ(0.5 * std::numbers::pi);
  EXPECT_FALSE(Within(turned, scene_));
}

// Each view shows the part as before, but the cameras stand elsewhere to each other.
TEST_F(IsWithinTest, ASymmetryOfOneViewIsAnotherScene) {
  AspectScene turned = scene_;
  turned.views[1]->camera_from_scene = turned.views[1]->camera_from_scene * TurnZ(std::numbers::pi);
  EXPECT_FALSE(Within(turned, scene_));
}

TEST_F(IsWithinTest, AnotherPlaceIsAnotherScene) {
  AspectScene moved = scene_;
  moved.objects[0].scene_from_object.t.x() = 0.02;
  EXPECT_FALSE(Within(moved, scene_));
  moved.objects[0].scene_from_object.t.x() = 0.001;
  EXPECT_TRUE(Within(moved, scene_));
}

}  // namespace
}  // namespace horopter
