#include "server/vision/recognition/aspect_scenes/scene_search.h"

#include <gtest/gtest.h>

#include <Eigen/Geometry>
#include <optional>
#include <random>
#include <vector>

#include "server/vision/recognition/aspect_scenes/scene_generator.h"
#include "server/vision/recognition/aspect_scenes/view_links.h"
#include "tests/support/photo_scene.h"

namespace horopter {
namespace {

AspectModel PartOf(const PhotoPart& photo) {
  AspectModel part;
  part.object = &photo.object;
  part.fragments = &photo.fragments;
  part.symmetries = photo.model.symmetries;
  return part;
}

// A block and a cube beside it, and what is known of the block.
class KnownScene : public testing::Test {
 protected:
  static void SetUpTestSuite() {
    block_ = new PhotoPart(MakePart(SteppedBlock()));
    cube_ = new PhotoPart(MakePart(BoxMesh({0.014, 0.012, 0.012})));
  }
  static void TearDownTestSuite() {
    delete block_;
    delete cube_;
  }

  KnownScene() {
    cube_pose_.t = {0.055, 0.0, 0.0};
    for (int v = 0; v < kViews; ++v) {
      images_.push_back(
          MakeAspectImage(PhotoOf({{&block_->object.mesh, CameraFromScene(v)},
                                   {&cube_->object.mesh, CameraFromScene(v) * cube_pose_}},
                                  Camera())));
    }
    parts_ = {PartOf(*block_), PartOf(*cube_)};
    priors_.assign(kViews, {Camera(), 0.35});
    hypotheses_.resize(kViews);
    known_.views = Views();
    known_.objects = {{0, Rigid3{}}};
    options_.standing = 0;
  }

  // A generator lists the known scene, once.
  AspectLinkInput Input() {
    listed_.emplace(0.0, [this] { return std::vector<AspectScene>{known_}; });
    generators_ = {&*listed_};
    AspectLinkInput input{images_, priors_, hypotheses_, parts_};
    input.generators = generators_;
    return input;
  }

  // The cube as one view says it is, a little off.
  AspectHypothesis Cube(int v, unsigned seed) const {
    std::mt19937 random(seed);
    std::normal_distribution<double> off(0.0, 1.0);
    AspectHypothesis h;
    h.object = 1;
    h.camera = Camera();
    h.camera_from_object = CameraFromScene(v) * cube_pose_;
    h.camera_from_object.t += 4e-4 * Eigen::Vector3d(off(random), off(random), 10 * off(random));
    h.score = 0.5;
    return h;
  }

  static inline PhotoPart *block_ = nullptr, *cube_ = nullptr;
  Rigid3 cube_pose_;
  std::vector<AspectImage> images_;
  std::vector<AspectViewPrior> priors_;
  std::vector<std::vector<AspectHypothesis>> hypotheses_;
  std::vector<AspectModel> parts_;
  AspectScene known_;
  std::optional<ListedScenes> listed_;
  std::vector<SceneGenerator*> generators_;
  AspectLinkOptions options_;
};

TEST_F(KnownScene, WhatOneViewShowsBesideKnownObjectsIsFoundInAll) {
  for (const unsigned seed : {1u, 2u, 3u}) {
    SCOPED_TRACE(testing::Message() << "seed " << seed);
    hypotheses_[1] = {Cube(1, seed)};
    const LinkedScene scene = SearchScene(Input(), options_);
    ASSERT_EQ(scene.objects.size(), 2u);
    const LinkedObject& cube = scene.objects[scene.objects[0].object == 1 ? 0 : 1];
    EXPECT_EQ(cube.object, 1);
    EXPECT_EQ(scene.registered(), kViews);
  }
}

TEST_F(KnownScene, AHypothesisInAKnownObjectsPlaceOrWhereNothingIsAddsNothing) {
  AspectHypothesis there = Cube(1, 1), nowhere = Cube(1, 1);
  there.camera_from_object = CameraFromScene(1);
  nowhere.camera_from_object.t += Eigen::Vector3d(-0.11, 0.02, 0.0);
  hypotheses_[1] = {there, nowhere};
  EXPECT_EQ(SearchScene(Input(), options_).objects.size(), 1u);
}

// A scene whose views show nothing of its object leads nowhere.
TEST_F(KnownScene, AWrongStartLeavesTheLinksOfViews) {
  for (int v = 0; v < kViews; ++v) hypotheses_[v] = {Cube(v, 1)};
  known_.objects[0].scene_from_object.t += Eigen::Vector3d(0.1, 0.1, 0.05);
  const LinkedScene scene = SearchScene(Input(), options_);
  EXPECT_EQ(scene.registered(), kViews);
  ASSERT_FALSE(scene.objects.empty());
  EXPECT_EQ(scene.objects[0].object, 1);
}

TEST_F(KnownScene, IsCompletedWithoutAnyLinkOfViews) {
  hypotheses_[2] = {Cube(2, 1)};
  const LinkedScene scene = SearchScene(Input(), options_);
  ASSERT_EQ(scene.objects.size(), 2u);
  EXPECT_EQ(scene.registered(), kViews);
  AspectLinkInput unknown = Input();
  unknown.generators = {};
  // A hypothesis of one view alone links none.
  EXPECT_LT(SearchScene(unknown, options_).registered(), 2);
}

}  // namespace
}  // namespace horopter
