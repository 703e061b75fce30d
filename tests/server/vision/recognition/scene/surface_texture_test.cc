#include "server/vision/recognition/scene/surface_texture.h"

#include <gtest/gtest.h>

#include "tests/support/printed_box_scene.h"

namespace horopter {
namespace {

using Scene = PrintedBoxScene;

Rigid3 Shifted(double x, double y, double z) {
  return {Eigen::Matrix3d::Identity(), {x, y, z}};
}

TEST(SurfaceTexture, OfARightPoseIsAlikeOfAWrongOneUnlike) {
  for (const double noise : {0.0, 2.0, 5.0}) {
    SCOPED_TRACE(noise);
    Looks looks;
    looks.noise = noise;
    Scene scene(looks);
    const SurfaceTexture right = scene.At({});
    EXPECT_GT(right.alike, 40);
    EXPECT_LE(right.unlike, right.alike / 20);
    const SurfaceTexture far = scene.At(Shifted(-0.02, 0.03, 0.02));
    EXPECT_GT(far.unlike, 3 * far.alike);
    const SurfaceTexture high = scene.At(Shifted(0, 0, 0.008));  // its sides stay where they were
    EXPECT_LT(high.alike, 0.8 * right.alike);
    EXPECT_GT(high.unlike, right.unlike + 10);
    // Along its faces a printed box may slide: the planes are where they were.
    EXPECT_GT(scene.At(Shifted(0.004, 0, 0)).alike, 0);
  }
}

TEST(SurfaceTexture, OfAPlainPartSaysNothing) {
  for (const unsigned seed : {1u, 2u, 3u}) {
    Looks looks;
    looks.printed_box = false;
    looks.noise = 5.0;
    looks.seed = seed;
    Scene scene(looks);
    const SurfaceTexture found = scene.At({});
    EXPECT_EQ(found.alike, 0) << "seed " << seed;
    EXPECT_EQ(found.unlike, 0) << "seed " << seed;
  }
}

TEST(SurfaceTexture, OfTheTableDoesNotSpeakForWhatIsNotThere) {
  Looks looks;
  looks.printed_table = true;
  looks.box_is_there = false;
  Scene scene(looks);
  for (const double sunk : {0.0, 0.03, 0.059}) {  // the last: its top hardly above the table
    const SurfaceTexture found = scene.At(Shifted(0, 0, -sunk));
    EXPECT_LE(found.alike, found.unlike) << sunk;
    EXPECT_LT(found.alike, 4) << sunk;
  }
  EXPECT_GT(scene.At({}).unlike, 10);
}

TEST(SurfaceTexture, BehindAnotherObjectDoesNotCount) {
  Scene scene({});
  const int all = scene.At({}).alike;
  PlacedObject front;
  front.object = 0;
  front.scene_from_object = Shifted(0.03, -0.12, 0.05);
  scene.scene.objects.push_back(front);
  const SurfaceTexture hidden = scene.At({});
  EXPECT_LT(hidden.alike, all);
  EXPECT_LE(hidden.unlike, hidden.alike / 10);
}

TEST(SurfaceTexture, NeedsParallaxAndImages) {
  Scene scene({});
  Scene still({});
  for (int v = 0; v < 4; ++v) {
    still.scene.views[v] = still.scene.views[0];
    still.images[v] = still.images[0];
  }
  const SurfaceTexture none = still.At({});
  EXPECT_EQ(none.alike + none.unlike, 0);
  scene.surface_images = nullptr;
  const SurfaceTexture blind = scene.At({});
  EXPECT_EQ(blind.alike + blind.unlike, 0);
  scene.scene.views.assign(4, std::nullopt);
  scene.surface_images = MakeSurfaceImages(scene.images, 1);
  const SurfaceTexture lost = scene.At({});
  EXPECT_EQ(lost.alike + lost.unlike, 0);
}

TEST(SurfaceTexture, IsTheSameInLargeImages) {
  Scene scene({});
  const SurfaceTexture small = scene.At({});
  for (int v = 0; v < 4; ++v) {
    cv::resize(scene.images[v], scene.images[v], {}, 3.0, 3.0, cv::INTER_CUBIC);
    PinholeCamera& c = scene.scene.views[v]->camera;
    c = {3 * c.width, 3 * c.height, 3 * c.focal_px, 3 * c.cx + 1, 3 * c.cy + 1, c.k1};
  }
  const SurfaceTexture large = scene.At({});
  EXPECT_NEAR(large.alike, small.alike, 0.2 * small.alike);
  EXPECT_LE(large.unlike, large.alike / 20);
}

TEST(TextureLogLikelihoodRatio, GrowsWithAgreementAndIsBounded) {
  EXPECT_EQ(TextureLogLikelihoodRatio({0, 0}), 0.0);
  EXPECT_GT(TextureLogLikelihoodRatio({12, 0}), 1.0);
  EXPECT_GT(TextureLogLikelihoodRatio({12, 0}), TextureLogLikelihoodRatio({12, 3}));
  EXPECT_LT(TextureLogLikelihoodRatio({3, 6}), -1.0);
  EXPECT_EQ(TextureLogLikelihoodRatio({1000, 0}), TextureLogLikelihoodRatio({2000, 0}));
  EXPECT_EQ(TextureLogLikelihoodRatio({0, 1000}), TextureLogLikelihoodRatio({0, 2000}));
}

}  // namespace
}  // namespace horopter
