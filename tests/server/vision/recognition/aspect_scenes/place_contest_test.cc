#include "server/vision/recognition/aspect_scenes/place_contest.h"

#include <gtest/gtest.h>

#include <Eigen/Geometry>
#include <random>

#include "tests/support/photo_scene.h"

namespace horopter {
namespace {

// A stepped block before four cameras, found where it is or turned end for end, and what single
// images say of it.
class PlaceContests : public PhotographedBlock {
 protected:
  // The scene with the block at `found` after the contest with one hypothesis of the second view
  // and what was looked at on a plane.
  static std::optional<LinkedScene> Contested(const Rigid3& found,
                                              const Rigid3& rival,
                                              const std::vector<AspectSceneObject>& standing = {}) {
    const std::vector<AspectModel> models = {
        {&block_->object, &block_->fragments, block_->model.symmetries}};
    const std::vector<AspectViewPrior> priors(images_.size());
    std::vector<std::vector<AspectHypothesis>> hypotheses(images_.size());
    hypotheses[1].push_back({0, Camera(), CameraFromScene(1) * rival, 0.9, 0.9, 800.0, 0.9});
    const AspectLinkInput input{images_, priors, hypotheses, models};
    const AspectLinkOptions options;
    const StopRequested never;
    const ViewLinks links(input, options, never);
    const SceneObjects objects(input, options, never);
    AspectScene scene;
    scene.views = Views();
    scene.objects = {{0, found}};
    LinkedScene linked;
    linked.views = scene.views;
    linked.objects = objects.Judge(scene, kFineRenderPx);
    if (!PlaceContest(input, options, links, objects).Contest(&linked, standing))
      return std::nullopt;
    return linked;
  }

  static Rigid3 EndForEnd() { return Turn(Eigen::Vector3d::UnitZ(), M_PI); }
};

TEST_P(PlaceContests, ABetterPoseOfOneViewTakesThePlace) {
  std::mt19937 random(GetParam());
  std::uniform_real_distribution<double> m(-0.001, 0.001);
  Rigid3 near;
  near.t = {m(random), m(random), m(random)};
  const auto contested = Contested(EndForEnd(), near);
  ASSERT_TRUE(contested) << "seed " << GetParam();
  EXPECT_LT(contested->objects[0].scene_from_object.t.norm(), 0.001) << "seed " << GetParam();
  EXPECT_GT(contested->objects[0].scene_from_object.R.trace(), 2.9) << "seed " << GetParam();
  EXPECT_FALSE(Contested(Rigid3{}, EndForEnd())) << "seed " << GetParam();
}

// ... and what was looked at on a plane, whether or not a single image listed it.
TEST_P(PlaceContests, ABetterPoseOnThePlaneTakesThePlace) {
  std::mt19937 random(GetParam());
  std::uniform_real_distribution<double> m(-0.001, 0.001);
  Rigid3 near;
  near.t = {m(random), m(random), m(random)};
  const Rigid3 tilted = Turn(Eigen::Vector3d(1, 1, 0).normalized(), 0.9);  // of the single image
  const auto contested = Contested(EndForEnd(), tilted, {{0, near}});
  ASSERT_TRUE(contested) << "seed " << GetParam();
  EXPECT_LT(contested->objects[0].scene_from_object.t.norm(), 0.001) << "seed " << GetParam();
  EXPECT_GT(contested->objects[0].scene_from_object.R.trace(), 2.9) << "seed " << GetParam();
  EXPECT_FALSE(Contested(Rigid3{}, tilted, {{0, EndForEnd()}})) << "seed " << GetParam();
}

// Whatever a single image is told to say.
TEST_P(PlaceContests, ARivalWhoseEdgesAreNotThereTakesNone) {
  std::mt19937 random(GetParam());
  std::uniform_real_distribution<double> rad(0.6, 1.2);
  const Rigid3 tilted = Turn(Eigen::Vector3d(1, 1, 0).normalized(), rad(random));
  EXPECT_FALSE(Contested(Rigid3{}, tilted)) << "seed " << GetParam();
}

INSTANTIATE_TEST_SUITE_P(Seeds, PlaceContests, testing::Values(1u, 2u, 3u));

}  // namespace
}  // namespace horopter
