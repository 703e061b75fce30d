#include "server/vision/recognition/aspect_scenes/aspect_linking.h"

#include <gtest/gtest.h>

#include <random>

#include "tests/support/photo_scene.h"

namespace horopter {
namespace {

AspectPart PartOf(const PhotoPart& photo) {
  AspectPart part;
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

  AspectLinkInput Input() const { return {images_, priors_, hypotheses_, parts_, &known_}; }

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
  std::vector<AspectPart> parts_;
  AspectScene known_;
  AspectLinkOptions options_;
};

TEST_F(KnownScene, WhatOneViewShowsBesideKnownObjectsIsFoundInAll) {
  for (const unsigned seed : {1u, 2u, 3u}) {
    SCOPED_TRACE(testing::Message() << "seed " << seed);
    hypotheses_[1] = {Cube(1, seed)};
    const LinkedScene others = FindOthers(Input(), options_);
    ASSERT_EQ(others.objects.size(), 1u);
    EXPECT_EQ(others.objects[0].object, 1);
    EXPECT_LT((others.objects[0].scene_from_object.t - cube_pose_.t).norm(), 1e-3);
    EXPECT_EQ(others.registered(), kViews);
  }
}

TEST_F(KnownScene, AHypothesisInAKnownObjectsPlaceOrWhereNothingIsAddsNothing) {
  AspectHypothesis there = Cube(1, 1), nowhere = Cube(1, 1);
  there.camera_from_object = CameraFromScene(1);
  nowhere.camera_from_object.t += Eigen::Vector3d(-0.11, 0.02, 0.0);
  hypotheses_[1] = {there, nowhere};
  EXPECT_TRUE(FindOthers(Input(), options_).objects.empty());
  known_.objects.clear();
  EXPECT_TRUE(FindOthers(Input(), options_).objects.empty());
}

// What is taken for another part keeps the place from the right one unless the two are compared.
TEST_F(KnownScene, APartThatOneViewShowsBetterTakesTheWrongOnesPlace) {
  const PhotoPart slab = MakePart(BoxMesh({0.017, 0.012, 0.012}));
  parts_.push_back(PartOf(slab));
  for (const int v : {0, 1, 2}) {
    SCOPED_TRACE(testing::Message() << "view " << v);
    known_.objects = {{0, Rigid3{}}, {2, cube_pose_}};
    options_.min_joint = 0.05;  // enough to keep it
    hypotheses_.assign(kViews, {});
    hypotheses_[v] = {Cube(v, 1)};
    const LinkedScene scene = LinkAspects(Input(), options_);
    EXPECT_EQ(scene.registered(), kViews);
    ASSERT_EQ(scene.objects.size(), 2u);
    EXPECT_EQ(scene.objects[1].object, 1);
    EXPECT_LT((scene.objects[1].scene_from_object.t - cube_pose_.t).norm(), 1e-3);
  }
}

TEST_F(KnownScene, IsCompletedWithoutAnyLinkOfViews) {
  hypotheses_[2] = {Cube(2, 1)};
  const LinkedScene scene = LinkAspects(Input(), options_);
  ASSERT_EQ(scene.objects.size(), 2u);
  EXPECT_EQ(scene.registered(), kViews);
  AspectLinkInput unknown = Input();
  unknown.known = nullptr;
  // A good hypothesis of one view alone is looked for in the others; a poor one is not.
  EXPECT_EQ(LinkAspects(unknown, options_).registered(), kViews);
  hypotheses_[2].front().score = 0.4;
  EXPECT_LT(LinkAspects(unknown, options_).registered(), 2);
}

}  // namespace
}  // namespace horopter
