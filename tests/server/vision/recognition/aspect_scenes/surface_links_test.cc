// A printed box on a table: half turns of it look the same but for what is on its faces.
#include "server/vision/recognition/aspect_scenes/surface_links.h"

#include <gtest/gtest.h>

#include <Eigen/Geometry>
#include <numbers>
#include <random>
#include <vector>

#include "server/vision/recognition/object/aspect_model.h"
#include "tests/support/printed_box_scene.h"

namespace horopter {
namespace {

constexpr double kRightRad = 1e-6;

// Of the box about its middle.
std::vector<Rigid3> HalfTurns() {
  const Eigen::Vector3d middle(0.5 * kPrintedSide, 0.5 * 0.8 * kPrintedSide, 0.5 * kPrintedHeight);
  std::vector<Rigid3> out;
  for (int axis = 0; axis < 3; ++axis) {
    const Eigen::Matrix3d turn =
        Eigen::AngleAxisd(std::numbers::pi, Eigen::Vector3d::Unit(axis)).toRotationMatrix();
    out.push_back({turn, middle - turn * middle});
  }
  return out;
}

class SurfaceLinks : public testing::Test {
 protected:
  // The box from its four cameras; hypotheses of each view: the true pose, turned by one of its
  // symmetries at random.
  void See(const Looks& looks, double precision = 0.9) {
    RecordProperty("seed", static_cast<int>(looks.seed));
    PrintedBoxScene box(looks);
    if (object_ == nullptr) {
      ObjectModel model = box.objects[0]->model;
      model.symmetries = HalfTurns();
      object_ = PrepareObject(model, {.aspects = true}).value();
    }
    model_ = AspectModelOf(*object_);
    std::mt19937 random(looks.seed);
    images_.clear();
    hypotheses_.clear();
    priors_.clear();
    truth_.clear();
    for (std::size_t v = 0; v < box.images.size(); ++v) {
      images_.push_back(MakeAspectImage(box.images[v]));
      truth_.push_back(box.views[v]);
      priors_.push_back({truth_.back().camera, 0.35});
      AspectHypothesis h;
      h.object = 0;
      h.camera = truth_.back().camera;
      h.camera_from_object = truth_.back().camera_from_scene * Turn(random() % TurnCount());
      h.precision = precision;
      h.recall = 0.3;
      h.support_px = 400;
      h.score = 0.3;
      hypotheses_.push_back({h});
    }
  }

  std::size_t TurnCount() const { return model_.symmetries.size() + 1; }
  Rigid3 Turn(std::size_t i) const { return i == 0 ? Rigid3{} : model_.symmetries[i - 1]; }

  AspectLinkInput Input() const { return {images_, priors_, hypotheses_, {&model_, 1}}; }

  LinkTurns Turns() const { return LinkTurns({&model_, 1}); }

  std::vector<AspectScene> Scenes() const {
    const AspectLinkInput input = Input();
    return ScenesBySurface(input, options_, ViewLinks(input, options_, {}), {});
  }

  // Angle (radians) between the true rotation from view 0 to view v and a scene's.
  double RotationError(const AspectScene& scene, std::size_t v) const {
    const auto relative = [](const Rigid3& a, const Rigid3& b) { return b.R * a.R.transpose(); };
    const Eigen::Matrix3d off =
        relative(truth_[0].camera_from_scene, truth_[v].camera_from_scene).transpose() *
        relative(scene.views[0]->camera_from_scene, scene.views[v]->camera_from_scene);
    return Eigen::AngleAxisd(off).angle();
  }

  static inline std::shared_ptr<const PreparedObject> object_;  // made once: it takes a second
  AspectModel model_;
  std::vector<AspectImage> images_;
  std::vector<AspectViewPrior> priors_;
  std::vector<std::vector<AspectHypothesis>> hypotheses_;
  std::vector<CalibratedCamera> truth_;
  AspectLinkOptions options_;
};

TEST_F(SurfaceLinks, PrintTellsTheTurnOfEachView) {
  for (unsigned seed = 1; seed <= 5; ++seed) {
    for (const double noise : {0.0, 3.0, 8.0}) {
      See({.noise = noise, .seed = seed});
      ASSERT_GT(TurnCount(), 1u);
      const std::vector<AspectScene> scenes = Scenes();
      ASSERT_EQ(scenes.size(), 1u) << "seed " << seed << " noise " << noise;
      for (std::size_t v = 0; v < truth_.size(); ++v) {
        ASSERT_TRUE(scenes[0].views[v]) << "view " << v << " seed " << seed << " noise " << noise;
        EXPECT_LT(RotationError(scenes[0], v), kRightRad)
            << "view " << v << " seed " << seed << " noise " << noise;
      }
    }
  }
}

TEST_F(SurfaceLinks, AViewWithAWrongPoseIsLeftOut) {
  See({.seed = 3});
  const Rigid3 aside{Eigen::AngleAxisd(0.5, Eigen::Vector3d::UnitY()).toRotationMatrix(),
                     Eigen::Vector3d(0.03, 0.0, 0.0)};
  hypotheses_[2][0].camera_from_object = hypotheses_[2][0].camera_from_object * aside;
  const std::vector<AspectScene> scenes = Scenes();
  ASSERT_EQ(scenes.size(), 1u);
  EXPECT_FALSE(scenes[0].views[2]);
  for (const std::size_t v : {1, 3}) EXPECT_LT(RotationError(scenes[0], v), kRightRad);
}

TEST_F(SurfaceLinks, NothingIsLinkedOfWhatIsNotThere) {
  See({.box_is_there = false});
  EXPECT_TRUE(Scenes().empty());
}

TEST_F(SurfaceLinks, PosesWhoseOutlineIsNotFoundAreNotAsked) {
  See({}, 0.5);
  EXPECT_TRUE(Scenes().empty());
}

TEST_F(SurfaceLinks, TwoViewsAreTooFew) {
  See({});
  hypotheses_[1].clear();
  hypotheses_[2].clear();
  EXPECT_TRUE(Scenes().empty());
}

TEST_F(SurfaceLinks, AViewIsTurnedAsTheOthersShowTheSurface) {
  for (unsigned seed = 1; seed <= 5; ++seed) {
    See({.seed = seed});
    std::vector<std::optional<AspectSceneView>> views(4);
    for (const std::size_t v : {0, 1, 2})
      views[v] = AspectSceneView{truth_[v].camera, truth_[v].camera_from_scene, 0.0, 0.35};
    for (std::size_t turn = 0; turn < TurnCount(); ++turn) {
      const std::vector<PoseInView> poses = {
          {truth_[3].camera, truth_[3].camera_from_scene * Turn(turn)}};
      const auto choice = ChooseBySurface(Input(), views, {0, Rigid3{}}, 3, poses, Turns());
      ASSERT_TRUE(choice) << "seed " << seed;
      const Eigen::Matrix3d off = truth_[3].camera_from_scene.R.transpose() *
                                  poses[0].camera_from_object.R * choice->turn.R;
      EXPECT_LT(Eigen::AngleAxisd(off).angle(), kRightRad) << "turn " << turn << " seed " << seed;
      EXPECT_GT(choice->correlation, 0.8);
      if (turn == 0) {
        EXPECT_DOUBLE_EQ(choice->correlation, choice->stated);
      }
    }
  }
}

TEST_F(SurfaceLinks, OfTwoPosesTheOneWhoseSurfaceAgreesIsChosen) {
  See({.seed = 2});
  std::vector<std::optional<AspectSceneView>> views(4);
  views[1] = AspectSceneView{truth_[1].camera, truth_[1].camera_from_scene, 0.0, 0.35};
  const Rigid3 aside{Eigen::AngleAxisd(0.4, Eigen::Vector3d::UnitZ()).toRotationMatrix(),
                     Eigen::Vector3d::Zero()};
  const std::vector<PoseInView> poses = {{truth_[0].camera, truth_[0].camera_from_scene * aside},
                                         {truth_[0].camera, truth_[0].camera_from_scene}};
  const auto choice = ChooseBySurface(Input(), views, {0, Rigid3{}}, 0, poses, Turns());
  ASSERT_TRUE(choice);
  EXPECT_EQ(choice->pose, 1u);
}

TEST_F(SurfaceLinks, NoOtherViewNothingSaid) {
  See({});
  const std::vector<PoseInView> poses = {{truth_[0].camera, truth_[0].camera_from_scene}};
  EXPECT_FALSE(ChooseBySurface(
      Input(), std::vector<std::optional<AspectSceneView>>(4), {0, Rigid3{}}, 0, poses, Turns()));
}

}  // namespace
}  // namespace horopter
