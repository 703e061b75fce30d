#include "server/vision/recognition/aspect_scenes/scene_objects.h"

#include <gtest/gtest.h>

#include <Eigen/Geometry>
#include <opencv2/core.hpp>
#include <random>
#include <vector>

#include "tests/support/photo_scene.h"

namespace horopter {
namespace {

constexpr double kRenderPx = 110.0;

class SettledObjects : public PhotographedBlock {};

TEST_P(SettledObjects, ComeToWhereTheEdgesAreAndKeepTheirRenderings) {
  std::mt19937 random(GetParam());
  std::uniform_real_distribution<double> m(-0.0015, 0.0015), rad(-0.04, 0.04);
  Rigid3 off;
  off.R = Eigen::AngleAxisd(rad(random), Eigen::Vector3d::UnitZ()).toRotationMatrix();
  off.t = {m(random), m(random), m(random)};
  auto settled = SettleInViews(images_, block_->object.mesh, Views(), {0, off}, kRenderPx, 0.34);
  ASSERT_TRUE(settled) << "seed " << GetParam();
  EXPECT_LT(settled->placed.scene_from_object.t.norm(), 0.0006) << "seed " << GetParam();
  ASSERT_EQ(settled->rendered.size(), static_cast<std::size_t>(kViews));
  SceneJudgementOptions judging;
  judging.render_px = kRenderPx;
  const double fresh =
      JudgeInViews(images_, block_->object.mesh, Views(), settled->placed, judging).score;
  const double kept =
      JudgeInViews(
          images_, block_->object.mesh, Views(), settled->placed, judging, {}, settled->rendered)
          .score;
  EXPECT_GT(fresh, 0.6) << "seed " << GetParam();
  EXPECT_NEAR(kept, fresh, 0.02) << "seed " << GetParam();
}

TEST_P(SettledObjects, AreGivenUpWhereFewEdgesMeet) {
  std::mt19937 random(GetParam());
  std::uniform_real_distribution<double> rad(0.0, 6.28);
  const double at = rad(random);
  Rigid3 away;
  away.t = 0.05 * Eigen::Vector3d(std::cos(at), std::sin(at), 0.0);
  const RenderMesh& mesh = block_->object.mesh;
  EXPECT_FALSE(SettleInViews(images_, mesh, Views(), {0, away}, kRenderPx, 0.34))
      << "seed " << GetParam();
  EXPECT_TRUE(SettleInViews(images_, mesh, Views(), {0, away}, kRenderPx)) << GetParam();
}

// What others hide is not looked for: with all of it hidden nothing is met, and nothing moves.
TEST_P(SettledObjects, AreNotDrawnToWhatHidesThem) {
  std::mt19937 random(GetParam());
  std::uniform_real_distribution<double> m(-0.0015, 0.0015);
  Rigid3 off;
  off.t = {m(random), m(random), m(random)};
  const RenderMesh& mesh = block_->object.mesh;
  std::vector<ObjectLayer> covering(images_.size()), left(images_.size());
  for (std::size_t v = 0; v < images_.size(); ++v) {
    ObjectLayer& all = covering[v];
    all.width = images_[v].width;
    all.height = images_[v].height;
    all.inverse_depth.assign(static_cast<std::size_t>(all.width) * all.height, 1000.0f);
    all.edge_bin.assign(all.inverse_depth.size(), ObjectLayer::kNoEdge);
    left[v] = all;  // the left half of the block's image
    const Rigid3 pose = Views()[v]->camera_from_scene;
    const double middle = Project(WorkingCamera(images_[v], Views()[v]->camera),
                                  Eigen::Vector3d(pose * mesh.center.cast<double>()))
                              .x();
    for (int y = 0; y < all.height; ++y) {
      for (int x = static_cast<int>(middle); x < all.width; ++x)
        left[v].inverse_depth[left[v].Cell(x, y)] = 0.0f;
    }
  }
  const std::vector<ObjectLayer>* hidden[] = {&covering};
  EXPECT_FALSE(SettleInViews(images_, mesh, Views(), {0, off}, kRenderPx, 0.34, hidden));
  const auto still = SettleInViews(images_, mesh, Views(), {0, off}, kRenderPx, 0.0, hidden);
  ASSERT_TRUE(still);
  EXPECT_EQ(still->placed.scene_from_object.t, off.t);
  const std::vector<ObjectLayer>* half[] = {&left};
  const auto settled = SettleInViews(images_, mesh, Views(), {0, off}, kRenderPx, 0.34, half);
  ASSERT_TRUE(settled) << "seed " << GetParam();
  EXPECT_LT(settled->placed.scene_from_object.t.norm(), 0.0012) << "seed " << GetParam();
}

// One part as two: the same may not stand so near, another may.
TEST_P(SettledObjects, AnotherPartMayStandNearer) {
  std::mt19937 random(GetParam());
  std::uniform_real_distribution<double> rad(0.0, 6.28);
  const double at = rad(random);
  const AspectModel block{&block_->object, &block_->fragments, block_->model.symmetries};
  const std::vector<AspectModel> models = {block, block};
  const std::vector<AspectViewPrior> priors(images_.size());
  const std::vector<std::vector<AspectHypothesis>> hypotheses(images_.size());
  const AspectLinkInput input{images_, priors, hypotheses, models};
  const AspectLinkOptions options;
  const StopRequested never;
  const SceneObjects objects(input, options, never);
  const std::vector<AspectSceneObject> taken = {{0, Rigid3{}}};
  const auto is_free = [&](int object, double share) {
    Rigid3 pose;
    pose.t =
        share * block_->object.mesh.diameter_m * Eigen::Vector3d(std::cos(at), std::sin(at), 0.0);
    return objects.IsFree(Views(), taken, {object, pose});
  };
  EXPECT_FALSE(is_free(0, 0.3)) << "seed " << GetParam();
  EXPECT_TRUE(is_free(1, 0.3)) << "seed " << GetParam();
  EXPECT_FALSE(is_free(1, 0.1)) << "seed " << GetParam();
  EXPECT_TRUE(is_free(0, 1.5)) << "seed " << GetParam();
}

// What was refused is not asked for again, but only in its place of the same views.
TEST_P(SettledObjects, ARefusedPlaceIsAskedForAgainInOtherViewsAndKeepsNoOtherOut) {
  std::mt19937 random(GetParam());
  std::uniform_real_distribution<double> rad(0.0, 6.28);
  const double at = rad(random);
  Rigid3 away;
  away.t = 0.05 * Eigen::Vector3d(std::cos(at), std::sin(at), 0.0);
  const std::vector<AspectModel> models = {
      {&block_->object, &block_->fragments, block_->model.symmetries}};
  const std::vector<AspectViewPrior> priors(images_.size());
  const std::vector<std::vector<AspectHypothesis>> hypotheses(images_.size());
  const AspectLinkInput input{images_, priors, hypotheses, models};
  const AspectLinkOptions options;
  const StopRequested never;
  const SceneObjects objects(input, options, never);
  const auto placed = [&](const std::vector<AspectSceneObject>& candidates, double turned_rad) {
    AspectScene scene;
    scene.views = Views();
    const Eigen::AngleAxisd turn(turned_rad, Eigen::Vector3d::UnitY());
    for (auto& view : scene.views) {
      view->camera_from_scene.R = turn * view->camera_from_scene.R;
      view->camera_from_scene.t = turn * view->camera_from_scene.t;
    }
    objects.Place(candidates, &scene);
    return scene.objects.size();
  };
  EXPECT_EQ(placed({{0, away}}, 0.0), 0u) << "seed " << GetParam();
  EXPECT_EQ(placed({{0, away}}, 0.0), 0u) << "seed " << GetParam();
  EXPECT_EQ(placed({{0, Rigid3{}}}, 0.12), 0u) << "seed " << GetParam();
  EXPECT_EQ(placed({{0, away}, {0, Rigid3{}}}, 0.0), 1u) << "seed " << GetParam();
}

INSTANTIATE_TEST_SUITE_P(Seeds, SettledObjects, testing::Values(1u, 2u, 3u, 4u, 5u));

TEST(ExplainedTogether, CountsEveryViewOfOneObjectAndAllButOneOfTheOthers) {
  EXPECT_EQ(ExplainedTogether({}), 0.0);
  EXPECT_NEAR(ExplainedTogether(std::vector<Explained>{{1.6, 4}}), 1.6, 1e-12);
  EXPECT_NEAR(ExplainedTogether(std::vector<Explained>{{1.6, 4}, {0.8, 4}}), 1.6 + 0.6, 1e-12);
  EXPECT_NEAR(ExplainedTogether(std::vector<Explained>{{0.8, 4}, {1.6, 4}}), 1.6 + 0.6, 1e-12);
  EXPECT_NEAR(ExplainedTogether(std::vector<Explained>{{0.4, 1}, {0.0, 0}}), 0.4, 1e-12);
}

// A bracket in four views, or in two of them with small parts in its holes (figures of a scene).
TEST(ExplainedTogether, FourViewsOfOneObjectAreMoreThanTwoWithSmallPartsThatFitByChance) {
  const std::vector<Explained> four{{4 * 0.43, 4}};
  const std::vector<Explained> two{{2 * 0.42, 2}, {2 * 0.25, 2}, {2 * 0.13, 2}, {2 * 0.12, 2}};
  EXPECT_GT(ExplainedTogether(four), ExplainedTogether(two));
}

}  // namespace
}  // namespace horopter
