#include "server/pipeline/followed_ground.h"

#include <gtest/gtest.h>

#include <Eigen/LU>
#include <opencv2/core.hpp>

#include "tests/support/textured_plane.h"

namespace horopter {
namespace {

constexpr int kViews = 4;

// One part on the plane z = 0, its frame the scene's; focal lengths `wrong` times the true ones,
// with the cameras so much farther away, as parts alone leave them.
MetricScene Scene(const SyntheticScene& truth, double wrong) {
  MetricScene scene;
  for (int v = 0; v < kViews; ++v) {
    PosedCamera camera;
    camera.camera = truth.cameras[v];
    camera.camera.focal_px *= wrong;
    camera.camera_from_scene = truth.camera_from_world[v];
    camera.camera_from_scene.t.z() *= wrong;
    scene.cameras.push_back(camera);
  }
  scene.objects.emplace_back();
  scene.plane = SupportingPlane{Eigen::Vector3d::UnitZ(), 0.0};
  return scene;
}

SyntheticScene Truth() {
  SyntheticSceneOptions options;
  options.views = kViews;
  return MakeSyntheticScene(options);
}

SceneRequest Request(const SyntheticScene& truth, const cv::Mat& texture) {
  SceneRequest request;
  for (int v = 0; v < kViews; ++v) request.images.push_back(RenderPlane(truth, v, texture, 1.5));
  return request;
}

TEST(PlaneOf, IsWhereTheViewsHaveIt) {
  const SyntheticScene truth = Truth();
  MetricScene scene = Scene(truth, 1.0);
  scene.cameras[2].reset();
  const PlaneInViews plane = PlaneOf(scene);
  ASSERT_EQ(plane.size(), static_cast<std::size_t>(kViews));
  EXPECT_FALSE(plane[2].has_value());
  for (const int v : {1, 3})
    EXPECT_LT(WorstTransfer(truth, 0, v, *plane[v] * plane[0]->inverse()), 1e-6);
}

TEST(PlaneOf, WithoutPlaneOrPartThereIsNone) {
  MetricScene scene = Scene(Truth(), 1.0);
  scene.plane.reset();
  EXPECT_EQ(PlaneOf(scene), PlaneInViews(kViews));
  scene = Scene(Truth(), 1.0);
  scene.objects.clear();
  EXPECT_EQ(PlaneOf(scene), PlaneInViews(kViews));
}

TEST(FollowGround, TellsItsPlaneThoughCamerasAreRough) {
  const SyntheticScene truth = Truth();
  const SceneRequest request = Request(truth, PlaneTexture(3, 15.0));
  for (const double wrong : {1.0, 1.03}) {
    const MatchingResult ground = FollowGround(request, Scene(truth, wrong), {}, {});
    ASSERT_FALSE(ground.planes.empty()) << wrong;
    for (const PlaneHomography& p : ground.planes)
      EXPECT_LT(WorstTransfer(truth, p.view_a, p.view_b, p.b_from_a), 0.3) << wrong;
  }
}

TEST(FollowGround, ABlankGroundTellsNothing) {
  const SyntheticScene truth = Truth();
  SceneRequest request;
  request.images.assign(kViews, cv::Mat(480, 640, CV_8UC1, cv::Scalar(90)));
  EXPECT_TRUE(FollowGround(request, Scene(truth, 1.0), {}, {}).planes.empty());
}

TEST(WithFollowedGround, OnlyRaisesTheFloorOfItsCells) {
  PipelineOptions options;
  const double before = options.euclidean.plane.floor_px;
  EXPECT_GT(WithFollowedGround(options).euclidean.plane.floor_px, before);
  options.euclidean.plane.floor_px = 50.0;
  EXPECT_EQ(WithFollowedGround(options).euclidean.plane.floor_px, 50.0);
}

TEST(KeepsAnswer, WithAllObjectsTheirEdgesAndAPlaneThatIsExplained) {
  MetricScene without;
  without.objects.resize(2);
  without.rms_px = 0.5;
  MetricScene with_plane = without;
  EXPECT_FALSE(KeepsAnswer(with_plane, without));  // no cells
  with_plane.counts["plane_sigmas"] = 0.8;
  with_plane.rms_px = 0.6;
  EXPECT_TRUE(KeepsAnswer(with_plane, without));
  with_plane.counts["plane_sigmas"] = 2.0;
  EXPECT_FALSE(KeepsAnswer(with_plane, without));
  with_plane.counts["plane_sigmas"] = 0.8;
  with_plane.rms_px = 0.9;
  EXPECT_FALSE(KeepsAnswer(with_plane, without));
  with_plane.rms_px = 0.5;
  with_plane.objects.resize(1);
  EXPECT_FALSE(KeepsAnswer(with_plane, without));
}

}  // namespace
}  // namespace horopter
