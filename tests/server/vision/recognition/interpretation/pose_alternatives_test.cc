// A block with a small peg: symmetric but for it.
#include "server/vision/recognition/interpretation/pose_alternatives.h"

#include <gtest/gtest.h>

#include <Eigen/Geometry>
#include <memory>
#include <numbers>

#include "server/vision/recognition/interpretation/aspect_route.h"
#include "server/vision/recognition/object/prepared_object.h"
#include "tests/support/shaded_photo.h"
#include "tests/support/solid_meshes.h"
#include "tests/support/synthetic_part.h"

namespace horopter {
namespace {

const Eigen::Vector3d kPeg(0.028, 0.0, 0.018);  // its middle

// 80 x 40 x 28 mm; the peg of 8 x 8 x 8 mm stands on its upper side, near one end.
ObjectModel Block(const char* id, bool with_peg) {
  ObjectModel model;
  model.id = id;
  model.mesh = BoxMesh({0.04, 0.02, 0.014});
  if (with_peg) Append(BoxMesh({0.004, 0.004, 0.004}), kPeg, &model.mesh);
  for (const auto& a : model.mesh.vertices) {
    for (const auto& b : model.mesh.vertices)
      model.diameter_m = std::max(model.diameter_m, (a - b).norm());
  }
  return model;
}

// 80 mm long, 40 mm wide at one end and 16 mm at the other.
ObjectModel Wedge() {
  ObjectModel model = Block("wedge", false);
  model.mesh = SweptMesh({{-0.04, -0.02}, {0.04, -0.008}, {0.04, 0.008}, {-0.04, 0.02}}, 0.012);
  model.symmetries = {
      {Eigen::AngleAxisd(std::numbers::pi, Eigen::Vector3d::UnitX()).toRotationMatrix(),
       Eigen::Vector3d::Zero()}};
  return model;
}

Rigid3 HalfTurn() {
  return {Eigen::AngleAxisd(std::numbers::pi, Eigen::Vector3d::UnitZ()).toRotationMatrix(),
          Eigen::Vector3d::Zero()};
}

class PoseAlternatives : public testing::Test {
 protected:
  static void SetUpTestSuite() {
    objects_ = new std::vector<std::shared_ptr<const PreparedObject>>;
    objects_->push_back(PrepareObject(Block("pegged", true), {.aspects = true}).value());
    objects_->push_back(PrepareObject(Block("plain", false), {.aspects = true}).value());
    objects_->push_back(PrepareObject(Wedge(), {.aspects = true}).value());
  }
  static void TearDownTestSuite() { delete objects_; }

  // Three views of the pegged block (or another object) in the origin, the answer `pose` of it.
  // from_above: the peg is seen; else the cameras look at the lower side.
  void See(bool from_above, const Rigid3& pose, int object = 0) {
    result_ = {};
    images_.clear();
    result_.state = RecognitionState::kRecognized;
    context_.objects = *objects_;
    for (int v = 0; v < 3; ++v) {
      const double a = 0.4 + 0.5 * v;
      const PinholeCamera camera = CenteredCamera(640, 480, 800);
      const Rigid3 camera_from_scene = LookAt(
          {0.22 * std::sin(a), -0.22 * std::cos(a), from_above ? 0.2 : -0.2}, {0.0, 0.0, 0.0});
      images_.push_back(MakeAspectImage(
          ShadedPhoto({{&(*objects_)[object]->model.mesh, camera_from_scene}}, camera)));
      result_.views.push_back(CalibratedCamera{camera, camera_from_scene});
    }
    SceneObject answer;
    answer.object = object;
    answer.scene_from_object = pose;
    result_.objects.push_back(answer);
  }

  void Find(std::vector<OtherPose> alternatives = {}) {
    choices_ = FindPoseAlternatives(
        context_, images_, result_, 0, RatePoses(context_, images_, result_, 0, alternatives));
    Say();
  }

  void Say() {
    const RatedPoses rated = RateTurns(context_, images_, result_, 0);
    SayPoseAlternatives(context_, images_, {&rated, 1}, &result_);
  }

  const PoseChoice* ChoiceAt(int object, const Rigid3& object_from_alternative) const {
    for (const PoseChoice& c : choices_) {
      if (c.object == object &&
          (c.object_from_alternative.R - object_from_alternative.R).norm() < 0.05)
        return &c;
    }
    return nullptr;
  }

  static std::vector<std::shared_ptr<const PreparedObject>>* objects_;
  JointContext context_;
  std::vector<AspectImage> images_;
  RecognitionResult result_;
  std::vector<PoseChoice> choices_;
};

std::vector<std::shared_ptr<const PreparedObject>>* PoseAlternatives::objects_ = nullptr;

TEST_F(PoseAlternatives, ThePegIsANearSymmetry) {
  ASSERT_FALSE((*objects_)[0]->near_symmetries.empty());
  EXPECT_TRUE((*objects_)[1]->near_symmetries.empty());
}

TEST_F(PoseAlternatives, APegThatIsSeenDecides) {
  See(true, Rigid3());
  Find();
  const PoseChoice* turned = ChoiceAt(0, HalfTurn());
  EXPECT_LT(turned == nullptr ? 0.0 : turned->probability, 0.05);
  EXPECT_EQ(result_.state, RecognitionState::kRecognized);
}

TEST_F(PoseAlternatives, ThePoseThatThePegContradictsIsTheLessLikelyOne) {
  See(true, HalfTurn());
  Find();
  const PoseChoice* right = ChoiceAt(0, HalfTurn());
  ASSERT_NE(right, nullptr);
  EXPECT_GT(right->probability, 0.9);
  EXPECT_EQ(result_.state, RecognitionState::kAmbiguous);
}

TEST_F(PoseAlternatives, AnAnswerThatThePegContradictsIsTurned) {
  See(true, HalfTurn());
  TurnToLikeliest(context_, images_, &result_);
  const Rigid3& turned = result_.objects[0].scene_from_object;
  EXPECT_LT((turned.R - Rigid3().R).norm(), 0.02);
  EXPECT_LT((turned * kPeg - kPeg).norm(), 0.001);
}

// No near symmetry: every turn end for end is asked for.
TEST_F(PoseAlternatives, AnAnswerTheWrongWayRoundIsTurned) {
  constexpr int kWedge = 2;
  ASSERT_TRUE((*objects_)[kWedge]->near_symmetries.empty());
  for (const bool right : {false, true}) {
    See(true, right ? Rigid3() : HalfTurn(), kWedge);
    const std::vector<RatedPoses> rated = TurnToLikeliest(context_, images_, &result_);
    const Rigid3& turned = result_.objects[0].scene_from_object;
    // Upside down it is the same.
    EXPECT_LT((turned.R.col(0) - Eigen::Vector3d::UnitX()).norm(), 0.02) << right;
    SayPoseAlternatives(context_, images_, rated, &result_);
    EXPECT_EQ(result_.state, RecognitionState::kRecognized) << right;
    EXPECT_GT(result_.objects[0].pose_probability, 0.95) << right;
  }
}

TEST_F(PoseAlternatives, AnAnswerThatNothingContradictsStays) {
  for (const bool from_above : {false, true}) {
    See(from_above, Rigid3());
    TurnToLikeliest(context_, images_, &result_);
    const Rigid3& pose = result_.objects[0].scene_from_object;
    EXPECT_TRUE(pose.R == Rigid3().R && pose.t == Rigid3().t) << from_above;
  }
}

TEST_F(PoseAlternatives, APegThatNoImageShowsLeavesTheTurnOpenAndIsNamed) {
  See(false, Rigid3());
  Find();
  const PoseChoice* turned = ChoiceAt(0, HalfTurn());
  ASSERT_NE(turned, nullptr);
  EXPECT_GT(turned->probability, 0.2);
  EXPECT_LT(turned->probability, 0.8);
  EXPECT_EQ(result_.state, RecognitionState::kAmbiguous);
  EXPECT_EQ(result_.objects[0].alternatives, std::vector<int>{0});
  EXPECT_NE(result_.detail.find("pegged: 0."), std::string::npos) << result_.detail;
  bool named_own = false, named_other = false;
  for (const DecidingFeature& f : turned->features) {
    const Eigen::Vector3d peg = f.only_in_alternative ? HalfTurn() * kPeg : kPeg;
    if ((f.place - peg).norm() > 0.008) continue;
    (f.only_in_alternative ? named_other : named_own) = true;
    EXPECT_LT(f.visible_px, 5.0);
    EXPECT_GT(f.size_m, 0.005);
    EXPECT_LT(f.size_m, 0.03);
  }
  EXPECT_TRUE(named_own);
  EXPECT_TRUE(named_other);
}

TEST_F(PoseAlternatives, ALookAlikeIsListedWhereItsDifferenceIsHidden) {
  See(false, Rigid3());
  Find({{1, Rigid3()}});
  const PoseChoice* plain = ChoiceAt(1, Rigid3());
  ASSERT_NE(plain, nullptr);
  EXPECT_GT(plain->probability, 0.15);
  ASSERT_FALSE(plain->features.empty());
  EXPECT_FALSE(plain->features[0].only_in_alternative);
  EXPECT_LT((plain->features[0].place - kPeg).norm(), 0.008);

  See(true, Rigid3());
  Find({{1, Rigid3()}});
  const PoseChoice* excluded = ChoiceAt(1, Rigid3());
  EXPECT_LT(excluded == nullptr ? 0.0 : excluded->probability, 0.05);
}

TEST_F(PoseAlternatives, ProbabilitiesAddUpToAtMostOne) {
  for (const bool from_above : {false, true}) {
    See(from_above, Rigid3());
    Find({{1, Rigid3()}, {1, HalfTurn()}});
    double sum = 0.0, last = 1.0;
    for (const PoseChoice& c : choices_) {
      EXPECT_LE(c.probability, last);
      last = c.probability;
      sum += c.probability;
    }
    EXPECT_LT(sum, 1.0);
  }
}

}  // namespace
}  // namespace horopter
