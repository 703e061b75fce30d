#include "server/vision/reconstruction/texture_route.h"

#include <gtest/gtest.h>

#include <Eigen/Geometry>
#include <cmath>
#include <opencv2/core.hpp>

#include "tests/support/textured_scene.h"

namespace horopter {
namespace {

Reconstruction Reconstruct(const std::vector<cv::Mat>& images,
                           std::span<const ViewPrior> priors = {}) {
  const TextureMatching texture = MatchTexture(images, TextureOptions(), ViewGraphOptions(), 2);
  std::vector<ImageSize> sizes;
  for (const cv::Mat& image : images) sizes.push_back({image.cols, image.rows});
  auto result = ReconstructFromTexture(texture, sizes, priors, TextureRouteOptions());
  EXPECT_TRUE(result.ok()) << result.status();
  return *std::move(result);
}

double AngleDeg(const Eigen::Matrix3d& R) {
  return Eigen::AngleAxisd(R).angle() * 180.0 / M_PI;
}

// Largest error of a relative rotation between registered views of one body, degrees.
double WorstRotation(const TexturedScene& scene, const Reconstruction& r, int body = 0) {
  double worst = 0.0;
  for (size_t a = 0; a < r.views.size(); ++a) {
    for (size_t b = a + 1; b < r.views.size(); ++b) {
      if (!r.views[a] || !r.views[b]) continue;
      const Eigen::Matrix3d found =
          r.views[b]->camera_from_scene.R * r.views[a]->camera_from_scene.R.transpose();
      const Eigen::Matrix3d truth = scene.CameraFromBody(static_cast<int>(b), body).R *
                                    scene.CameraFromBody(static_cast<int>(a), body).R.transpose();
      worst = std::max(worst, AngleDeg(found * truth.transpose()));
    }
  }
  return worst;
}

int Registered(const Reconstruction& r) {
  int n = 0;
  for (const auto& view : r.views) n += view.has_value();
  return n;
}

// What is given with trust is right, and what is not says why.
void ExpectRefusedOrRight(const TexturedScene& scene, const Reconstruction& r) {
  EXPECT_EQ(r.trusted, r.refusal.empty());
  EXPECT_TRUE(!r.trusted || WorstRotation(scene, r) < 2.0) << WorstRotation(scene, r);
}

TEST(ReconstructFromTexture, FindsTheCamerasOfABench) {
  const TexturedScene scene = MakeTexturedScene({.seed = 11, .views = 5});
  const Reconstruction r = Reconstruct(RenderTextured(scene));
  ASSERT_TRUE(r.trusted) << r.refusal;
  EXPECT_EQ(Registered(r), 5);
  EXPECT_LT(WorstRotation(scene, r), 1.0);
  for (size_t v = 0; v < r.views.size(); ++v) {
    const double error = std::log(r.views[v]->camera.focal_px / scene.views[v].camera.focal_px);
    EXPECT_LT(std::abs(error), 0.03);
    EXPECT_LT(std::abs(error), 3.0 * r.views[v]->focal_log_sigma);
    EXPECT_EQ(r.view_matches[v].source, MatchSource::kTexture);
    EXPECT_GT(r.view_matches[v].matches, 50);
    EXPECT_LT(r.view_matches[v].rms_px, 1.0);
  }
}

TEST(ReconstructFromTexture, ThePlaneThatThingsStandOnIsZero) {
  const TexturedScene scene = MakeTexturedScene({.seed = 12, .views = 5});
  const Reconstruction r = Reconstruct(RenderTextured(scene));
  ASSERT_TRUE(r.trusted) << r.refusal;
  ASSERT_TRUE(r.has_plane);
  for (size_t v = 0; v < r.views.size(); ++v) {
    const Eigen::Vector3d up = r.views[v]->camera_from_scene.R.col(2);
    const Eigen::Vector3d truth = scene.views[v].camera_from_world.R.col(2);
    EXPECT_LT(std::acos(std::min(1.0, up.dot(truth))) * 180.0 / M_PI, 1.5);
    EXPECT_GT(r.views[v]->camera_from_scene.Inverse().t.z(), 0.0);
  }
}

TEST(ReconstructFromTexture, AViewOfAnotherFocalLengthGetsItsOwn) {
  const TexturedScene scene = MakeTexturedScene({.seed = 13, .views = 5, .boxes = 6, .zoom = 1.5});
  const Reconstruction r = Reconstruct(RenderTextured(scene));
  ASSERT_TRUE(r.trusted) << r.refusal;
  EXPECT_LT(WorstRotation(scene, r), 2.0);
  for (size_t v = 0; v < r.views.size(); ++v) {
    if (!r.views[v]) continue;
    const double error = std::log(r.views[v]->camera.focal_px / scene.views[v].camera.focal_px);
    EXPECT_LT(std::abs(error), 3.0 * r.views[v]->focal_log_sigma);
  }
}

TEST(ReconstructFromTexture, AGivenFocalLengthIsKept) {
  const TexturedScene scene = MakeTexturedScene({.seed = 14, .views = 4, .boxes = 0});
  std::vector<ViewPrior> priors(4);
  for (size_t v = 0; v < priors.size(); ++v) {
    priors[v].focal_px = scene.views[v].camera.focal_px;
    priors[v].focal_log_sigma = 0.005;
  }
  const Reconstruction r = Reconstruct(RenderTextured(scene), priors);
  ASSERT_TRUE(r.trusted) << r.refusal;
  EXPECT_LT(WorstRotation(scene, r), 1.0);
  for (size_t v = 0; v < r.views.size(); ++v)
    EXPECT_NEAR(r.views[v]->camera.focal_px / scene.views[v].camera.focal_px, 1.0, 0.02);
}

// Priors that say nothing of focal lengths are none: a plane and a zoom leave them to the noise.
TEST(ReconstructFromTexture, PriorsWithoutFocalLengthsLeaveAZoomedPlaneInDoubt) {
  const TexturedScene scene = MakeTexturedScene({.seed = 23, .views = 4, .boxes = 0, .zoom = 1.4});
  const std::vector<cv::Mat> images = RenderTextured(scene);
  const Reconstruction without = Reconstruct(images);
  const Reconstruction empty = Reconstruct(images, std::vector<ViewPrior>(4));
  EXPECT_FALSE(without.trusted);
  EXPECT_FALSE(empty.trusted);
  EXPECT_EQ(empty.refusal, without.refusal);
}

TEST(ReconstructFromTexture, WhatMovesIsReconstructedAndNotTheBackground) {
  const TexturedScene scene = OnTurntable(15, 5);
  const Reconstruction r = Reconstruct(RenderTextured(scene));
  EXPECT_TRUE(!r.trusted || WorstRotation(scene, r, 1) < 2.0);
}

TEST(ReconstructFromTexture, AnImageOfAnotherSceneIsLeftOut) {
  const TexturedScene scene = MakeTexturedScene({.seed = 16, .views = 5});
  std::vector<cv::Mat> images = RenderTextured(scene);
  images[2] = RenderTextured(MakeTexturedScene({.seed = 99, .views = 5}), 2);
  const Reconstruction r = Reconstruct(images);
  ASSERT_TRUE(r.trusted) << r.refusal;
  EXPECT_FALSE(r.views[2].has_value());
  EXPECT_FALSE(r.view_refusals[2].empty());
  EXPECT_EQ(Registered(r), 4);
  EXPECT_LT(WorstRotation(scene, r), 1.0);
}

TEST(ReconstructFromTexture, WhatTellsNothingIsRefusedWithAReason) {
  for (const TexturedScene& scene : {TurnedOnly(17, 4),
                                     WithoutOverlap(18, 4),
                                     MakeTexturedScene({.seed = 19, .views = 1}),
                                     MakeTexturedScene({.seed = 20, .views = 2})}) {
    const Reconstruction r = Reconstruct(RenderTextured(scene));
    EXPECT_FALSE(r.trusted);
    EXPECT_FALSE(r.refusal.empty());
    EXPECT_EQ(r.views.size(), scene.views.size());
  }
}

TEST(ReconstructFromTexture, RepeatsAreRefusedOrRight) {
  const TexturedScene scene = OnRepeats(21, 4, CheckerTexture(12, 40), 0.0005);
  ExpectRefusedOrRight(scene, Reconstruct(RenderTextured(scene)));
}

// A standing camera before a wall: what moves past it is the scene. Moved along a line it leaves
// the focal length open.
TEST(ReconstructFromTexture, ABeltIsReconstructedAndNotTheWallBehindIt) {
  const TexturedScene scene = OnConveyor(24, 4);
  const Reconstruction r = Reconstruct(RenderTextured(scene));
  EXPECT_EQ(Registered(r), 4);
  EXPECT_LT(WorstRotation(scene, r, 1), 1.0);
  EXPECT_FALSE(r.trusted);
  EXPECT_FALSE(r.refusal.empty());
}

TEST(ReconstructFromTexture, ScreensAndMirrorsDoNotMoveTheCameras) {
  const TexturedScene scene = WithScreenAndMirror(25, 4);
  const Reconstruction r = Reconstruct(RenderTextured(scene));
  ASSERT_TRUE(r.trusted) << r.refusal;
  EXPECT_LT(WorstRotation(scene, r), 1.0);
}

TEST(ReconstructFromTexture, BoardsOfMarkersAreRefusedOrRight) {
  for (const bool alike : {true, false}) {
    const TexturedScene scene = OnRepeats(26, 4, MarkerTexture(8, alike, 3), 0.0008);
    ExpectRefusedOrRight(scene, Reconstruct(RenderTextured(scene)));
  }
}

TEST(ReconstructFromTexture, AMirroredImageIsLeftOut) {
  TexturedScene scene = MakeTexturedScene({.seed = 28, .views = 5});
  scene.views[3].mirrored = true;
  const Reconstruction r = Reconstruct(RenderTextured(scene));
  ASSERT_TRUE(r.trusted) << r.refusal;
  EXPECT_FALSE(r.views[3].has_value());
  EXPECT_FALSE(r.view_refusals[3].empty());
  EXPECT_EQ(Registered(r), 4);
  EXPECT_LT(WorstRotation(scene, r), 1.0);
}

TEST(ReconstructFromTexture, ARollingShutterIsRefusedOrRight) {
  TexturedScene scene = MakeTexturedScene({.seed = 29, .views = 4});
  for (const double turn_rad : {0.002, 0.02}) {
    for (TexturedView& view : scene.views) view.row_turn_rad = {0.0, turn_rad, 0.25 * turn_rad};
    ExpectRefusedOrRight(scene, Reconstruct(RenderTextured(scene)));
  }
}

// Half of one and half of another: the cameras are of one of them, and the others' images say that
// they share nothing with it.
TEST(ReconstructFromTexture, OfTwoScenesMixedOneIsReconstructed) {
  const TexturedScene scene = MakeTexturedScene({.seed = 30, .views = 7});
  std::vector<cv::Mat> images = RenderTextured(scene);
  for (const int v : {1, 3, 5})
    images[v] = RenderTextured(MakeTexturedScene({.seed = 98, .views = 7}), v);
  const Reconstruction r = Reconstruct(images);
  ASSERT_TRUE(r.trusted) << r.refusal;
  for (int v = 0; v < 7; ++v) {
    EXPECT_EQ(r.views[v].has_value(), v % 2 == 0) << v;
    EXPECT_EQ(r.view_refusals[v].empty(), v % 2 == 0) << v;
    EXPECT_EQ(r.view_matches[v].matches > 0, v % 2 == 0) << v;
  }
  EXPECT_LT(WorstRotation(scene, r), 1.5);
}

// Neighbours show hardly any parallax; first and last do.
TEST(ReconstructFromTexture, ImagesOfAVideoGiveTheirCameras) {
  const TexturedScene scene =
      MakeTexturedScene({.seed = 31, .views = 14, .arc_rad = 0.8, .width = 320, .height = 240});
  const Reconstruction r = Reconstruct(RenderTextured(scene));
  ASSERT_TRUE(r.trusted) << r.refusal;
  EXPECT_EQ(Registered(r), 14);
  EXPECT_LT(WorstRotation(scene, r), 1.0);
}

TEST(ReconstructFromTexture, ThirtyTwoNearlyEqualImagesAreRefused) {
  const TexturedScene scene =
      MakeTexturedScene({.seed = 32, .views = 32, .arc_rad = 0.02, .width = 320, .height = 240});
  const Reconstruction r = Reconstruct(RenderTextured(scene));
  EXPECT_FALSE(r.trusted);
  EXPECT_FALSE(r.refusal.empty());
}

TEST(ReconstructFromTexture, RefusesSizesThatDoNotAgree) {
  const TextureMatching texture;
  const std::vector<ImageSize> sizes(2, {640, 480});
  EXPECT_EQ(ReconstructFromTexture(texture, sizes, {}, TextureRouteOptions()).status().code(),
            absl::StatusCode::kInvalidArgument);
}

TEST(ReconstructFromTexture, IsCancelled) {
  const std::vector<cv::Mat> images = RenderTextured(MakeTexturedScene({.seed = 22, .views = 3}));
  const TextureMatching texture = MatchTexture(images, TextureOptions(), ViewGraphOptions(), 2);
  const std::vector<ImageSize> sizes(3, {640, 480});
  EXPECT_EQ(ReconstructFromTexture(texture, sizes, {}, TextureRouteOptions(), [] { return true; })
                .status()
                .code(),
            absl::StatusCode::kCancelled);
}

}  // namespace
}  // namespace horopter
