#include "server/vision/recognition/aspect_scenes/hypothesis_support.h"

#include <gtest/gtest.h>

#include <Eigen/Geometry>
#include <cmath>
#include <optional>
#include <vector>

#include "tests/support/photo_scene.h"

namespace horopter {
namespace {

class SupportOfBlock : public PhotographedBlock {
 protected:
  SupportOfBlock() {
    part_.object = &block_->object;
    part_.fragments = &block_->fragments;
    priors_.assign(kViews, {Camera(), 0.35});
    hypotheses_.resize(kViews);
  }

  HypothesisSupport Support() {
    models_ = {part_};
    input_.emplace(AspectLinkInput{images_, priors_, hypotheses_, models_});
    return HypothesisSupport(*input_, options_);
  }

  static AspectHypothesis Block(int v, const Rigid3& turn = {}) {
    AspectHypothesis h;
    h.object = 0;
    h.camera = Camera();
    h.camera_from_object = CameraFromScene(v) * turn;
    h.score = 0.7;
    return h;
  }

  AspectModel part_;
  std::vector<AspectModel> models_;
  std::vector<AspectViewPrior> priors_;
  std::vector<std::vector<AspectHypothesis>> hypotheses_;
  AspectLinkOptions options_;
  std::optional<AspectLinkInput> input_;
};

TEST_P(SupportOfBlock, ARoundPartAgreesWhateverItsTurn) {
  const double angle = 0.8 + 0.7 * GetParam();
  SCOPED_TRACE(testing::Message() << "turned by " << angle);
  hypotheses_[1] = {Block(1, Turn(Eigen::Vector3d::UnitZ(), angle))};
  const AspectSceneView view = *Views()[1];
  EXPECT_EQ(Support().BestAgreeing(1, view, 0, CameraFromScene(1)).first, -1);
  part_.round = {{Eigen::Vector3d::UnitZ(), Eigen::Vector3d::Zero(), 0}};
  const auto [index, value] = Support().BestAgreeing(1, view, 0, CameraFromScene(1));
  EXPECT_EQ(index, 0);
  hypotheses_[1] = {Block(1)};
  // As small features may tell its turn, the same one agrees more.
  EXPECT_GT(Support().BestAgreeing(1, view, 0, CameraFromScene(1)).second, value);
  // Upside down is no turn about the axis.
  hypotheses_[1] = {Block(1, Turn(Eigen::Vector3d::UnitX(), M_PI))};
  EXPECT_EQ(Support().BestAgreeing(1, view, 0, CameraFromScene(1)).first, -1);
}

TEST_P(SupportOfBlock, APlaceIsCarriedOnceAndWhatIsKnownThereNever) {
  const auto views = Views();
  hypotheses_[0] = {Block(0)};
  const double one = Support().CarriedSupport(*views[0], *views[1], 0, 1, {});
  EXPECT_GT(one, 0.1);
  for (unsigned k = 0; k <= GetParam(); ++k)
    hypotheses_[0].push_back(Block(0, Turn(Eigen::Vector3d::UnitZ(), 0.02 * (k + 1))));
  const HypothesisSupport support = Support();
  EXPECT_NEAR(support.CarriedSupport(*views[0], *views[1], 0, 1, {}), one, 0.2 * one);
  EXPECT_EQ(support.CarriedSupport(*views[0], *views[1], 0, 1, {1}), 0.0);
}

INSTANTIATE_TEST_SUITE_P(Turns, SupportOfBlock, testing::Values(0u, 1u, 2u));

}  // namespace
}  // namespace horopter
