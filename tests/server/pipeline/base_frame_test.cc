#include "server/pipeline/base_frame.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <Eigen/Dense>
#include <random>

namespace horopter {
namespace {

Rigid3 RandomRigid(std::mt19937* rng) {
  const auto next = [&] { return (*rng)() / 2147483648.0 - 1.0; };
  Rigid3 out;
  out.R = Eigen::AngleAxisd(3.0 * next(), Eigen::Vector3d(next(), next(), next()).normalized())
              .toRotationMatrix();
  out.t = Eigen::Vector3d(next(), next(), next());
  return out;
}

struct Rig {
  Rigid3 base_from_scene;
  std::vector<std::optional<CameraPoseHint>> poses;
  std::vector<std::optional<PosedCamera>> cameras;
};

Rig RandomRig(unsigned seed, int views) {
  std::mt19937 rng(seed);
  Rig rig;
  rig.base_from_scene = RandomRigid(&rng);
  for (int v = 0; v < views; ++v) {
    PosedCamera camera;
    camera.camera_from_scene = RandomRigid(&rng);
    rig.cameras.push_back(camera);
    CameraPoseHint hint;
    hint.camera_from_base = camera.camera_from_scene * rig.base_from_scene.Inverse();
    rig.poses.push_back(hint);
  }
  return rig;
}

void ExpectNear(const Rigid3& a, const Rigid3& b, double tolerance) {
  EXPECT_LT((a.R - b.R).norm(), tolerance);
  EXPECT_LT((a.t - b.t).norm(), tolerance);
}

TEST(BaseFromCameras, OneKnownCameraIsEnoughAndMoreAgree) {
  for (unsigned seed = 1; seed <= 20; ++seed) {
    SCOPED_TRACE("seed " + std::to_string(seed));
    Rig rig = RandomRig(seed, 4);
    const BaseFrame all = BaseFromCameras(rig.poses, rig.cameras);
    ASSERT_TRUE(all.base_from_scene) << all.conflict;
    ExpectNear(*all.base_from_scene, rig.base_from_scene, 1e-9);
    rig.poses[0].reset();
    rig.poses[1].reset();
    rig.cameras[2].reset();  // not recovered: its hint says nothing
    const BaseFrame one = BaseFromCameras(rig.poses, rig.cameras);
    ASSERT_TRUE(one.base_from_scene);
    ExpectNear(*one.base_from_scene, rig.base_from_scene, 1e-9);
  }
}

TEST(BaseFromCameras, NoHintOrNoCameraIsNoFrame) {
  Rig rig = RandomRig(1, 2);
  EXPECT_FALSE(BaseFromCameras({}, rig.cameras).base_from_scene);
  EXPECT_FALSE(BaseFromCameras(rig.poses, {}).base_from_scene);
  rig.cameras[0].reset();
  rig.poses[1].reset();
  const BaseFrame none = BaseFromCameras(rig.poses, rig.cameras);
  EXPECT_FALSE(none.base_from_scene);
  EXPECT_TRUE(none.conflict.empty());
}

TEST(BaseFromCameras, HintsThatContradictEachOtherAreNamedAndGiveNoFrame) {
  Rig rig = RandomRig(3, 3);
  Rig turned = rig;
  turned.poses[2]->camera_from_base.R =
      Eigen::AngleAxisd(0.3, Eigen::Vector3d::UnitX()) * turned.poses[2]->camera_from_base.R;
  const BaseFrame by_angle = BaseFromCameras(turned.poses, turned.cameras);
  EXPECT_FALSE(by_angle.base_from_scene);
  EXPECT_THAT(by_angle.conflict, testing::HasSubstr("images 0 and 2"));
  // Two cameras said to be twice as far apart.
  Rig scaled = rig;
  Rigid3 base_from_camera = scaled.poses[1]->camera_from_base.Inverse();
  const Eigen::Vector3d other = scaled.poses[0]->camera_from_base.Inverse().t;
  base_from_camera.t = other + 2.0 * (base_from_camera.t - other);
  scaled.poses[1]->camera_from_base = base_from_camera.Inverse();
  const BaseFrame by_distance = BaseFromCameras(scaled.poses, scaled.cameras);
  EXPECT_FALSE(by_distance.base_from_scene);
  EXPECT_THAT(by_distance.conflict, testing::HasSubstr("images 0 and 1"));
  // Wide deviations forgive it.
  for (auto& pose : scaled.poses) pose->position_sigma_m = 5.0;
  EXPECT_TRUE(BaseFromCameras(scaled.poses, scaled.cameras).base_from_scene);
}

TEST(BaseFromCameras, TheSurerHintCountsMore) {
  Rig rig = RandomRig(5, 2);
  Rigid3 base_from_camera = rig.poses[1]->camera_from_base.Inverse();
  base_from_camera.t += Eigen::Vector3d(0.02, 0.0, 0.0);
  rig.poses[1]->camera_from_base = base_from_camera.Inverse();
  rig.poses[1]->position_sigma_m = 1.0;
  const BaseFrame frame = BaseFromCameras(rig.poses, rig.cameras);
  ASSERT_TRUE(frame.base_from_scene) << frame.conflict;
  ExpectNear(*frame.base_from_scene, rig.base_from_scene, 1e-3);
}

}  // namespace
}  // namespace horopter
