// Frames, references and findings of the answer.
#include "server/pipeline/answer.h"

#include <gtest/gtest.h>

#include <algorithm>

#include "tests/support/synthetic_metric_scene.h"
#include "tests/support/synthetic_part.h"

namespace horopter {
namespace {

class FillAnswerTest : public testing::Test {
 protected:
  void SetUp() override {
    MetricSceneOptions options;
    options.parts = {PrepareObject(LBracket()).value(), PrepareObject(Wedge()).value()};
    truth_ = MakeMetricScene(options);
    metric_ = RefineMetricScene(truth_.Input(), truth_.recognition, {}).value();
    request_.images.resize(truth_.cameras.size());
    base_from_world_.R = RotationFromVector({0.2, -0.1, 1.2});
    base_from_world_.t = {0.5, -0.2, 0.1};
  }
  SceneAnswer Answer() {
    SceneAnswer answer;
    EXPECT_TRUE(FillAnswer(metric_, truth_.objects, request_, {}, &answer).ok());
    return answer;
  }
  // The poses of these cameras in the base are known to 1 mm and 2 mrad.
  void KnowCameras(std::initializer_list<int> views) {
    request_.camera_poses.resize(truth_.cameras.size());
    for (const int v : views) {
      request_.camera_poses[v] =
          CameraPoseHint{truth_.camera_from_world[v] * base_from_world_.Inverse(), 0.002, 0.001};
    }
  }
  static bool Has(const SceneAnswer& answer, FindingKind kind) {
    return std::any_of(answer.findings.begin(), answer.findings.end(), [&](const auto& f) {
      return f.kind == kind;
    });
  }

  MetricSceneTruth truth_;
  MetricScene metric_;
  SceneRequest request_;
  Rigid3 base_from_world_;
};

TEST_F(FillAnswerTest, AReferenceObjectGivesTheBaseFrameAndItsCovariance) {
  request_.reference = ReferenceObject{"wedge", base_from_world_ * truth_.world_from_object[1]};
  const SceneAnswer answer = Answer();
  ASSERT_TRUE(answer.base_from_scene.has_value());
  for (const AnswerObject& o : answer.objects) {
    const int k = o.object_id == "wedge" ? 1 : 0;
    const Rigid3 expected = base_from_world_ * truth_.world_from_object[k];
    EXPECT_LT((o.base_from_object->pose.t - expected.t).norm(), 0.003) << o.object_id;
    // The reference itself is known exactly.
    EXPECT_EQ(o.base_from_object->covariance.norm() < 1e-18, k == 1) << o.object_id;
    for (const auto& c : o.camera_covariances) {
      ASSERT_TRUE(c.has_value());
      EXPECT_GT(c->trace(), 0.0);
    }
  }
  // The first object is the scene frame; the joint covariance says what the objects say.
  ASSERT_EQ(answer.joint_covariance.rows(), 12);
  for (int i = 0; i < 2; ++i) {
    const Matrix6d block = answer.joint_covariance.block<6, 6>(6 * i, 6 * i);
    EXPECT_LT((block - answer.objects[i].covariance).norm(), 1e-9 + 1e-6 * block.norm());
  }
}

TEST_F(FillAnswerTest, CamerasInTheBaseMeasureTheScaleToo) {
  KnowCameras({0, 4});
  const SceneAnswer answer = Answer();
  EXPECT_FALSE(Has(answer, FindingKind::kScaleConflict));
  ASSERT_TRUE(answer.base_from_scene.has_value());
  EXPECT_TRUE(std::any_of(answer.scales.begin(), answer.scales.end(), [](const AnswerScale& s) {
    return s.kind == ScaleSourceKind::kReferenceCameras && s.agrees;
  }));
}

// All parts enrolled in the wrong unit: only the cameras can tell.
TEST_F(FillAnswerTest, CamerasFurtherApartThanThePartsAllowAreAScaleConflict) {
  KnowCameras({0, 4});
  for (auto& hint : request_.camera_poses) {
    if (hint) hint->camera_from_base.t *= 25.4;
  }
  const SceneAnswer answer = Answer();
  EXPECT_TRUE(Has(answer, FindingKind::kScaleConflict));
  EXPECT_TRUE(Has(answer, FindingKind::kReferenceConflict));
  EXPECT_FALSE(answer.base_from_scene.has_value());
  // Neither hides the other.
  EXPECT_TRUE(HasReason(answer, ReasonKind::kScaleConflict));
  EXPECT_TRUE(HasReason(answer, ReasonKind::kReferenceConflict));
}

// One of two parts was enrolled 4 % too large: nobody may act on either size unawares.
TEST_F(FillAnswerTest, PartsWhoseSizesContradictEachOtherAreAReason) {
  EXPECT_TRUE(Answer().reasons.empty());
  constexpr double kFactor = 1.04;
  truth_.objects[1] = PrepareObject(Scaled(Wedge(), kFactor)).value();
  Rigid3& pose = truth_.recognition.objects[1].scene_from_object;
  pose.t -= pose.R * (truth_.objects[1]->center * (1.0 - 1.0 / kFactor));
  metric_ = RefineMetricScene(truth_.Input(), truth_.recognition, {}).value();
  const SceneAnswer answer = Answer();
  EXPECT_TRUE(Has(answer, FindingKind::kScaleConflict));
  EXPECT_TRUE(HasReason(answer, ReasonKind::kScaleConflict)) << ReasonsText(answer);
  EXPECT_EQ(answer.objects.size(), 2u);
  EXPECT_TRUE(std::any_of(
      answer.scales.begin(), answer.scales.end(), [](const AnswerScale& s) { return !s.agrees; }));
}

TEST_F(FillAnswerTest, ReferencesThatContradictEachOtherGiveNoBase) {
  request_.reference = ReferenceObject{"wedge", base_from_world_ * truth_.world_from_object[1]};
  KnowCameras({2});
  EXPECT_TRUE(Answer().base_from_scene.has_value());
  request_.reference->base_from_object.t.x() += 0.3;
  const SceneAnswer answer = Answer();
  EXPECT_TRUE(Has(answer, FindingKind::kReferenceConflict));
  EXPECT_FALSE(answer.base_from_scene.has_value());
  for (const AnswerObject& o : answer.objects) EXPECT_FALSE(o.base_from_object.has_value());
}

// Camera poses with their default deviations, 0.01 rad and 5 mm.
TEST_F(FillAnswerTest, GraspsSurviveABaseThatIsKnownBadlyAndItIsTold) {
  ObjectModel part = LBracket();
  Grasp grasp;  // across the thin wall from above
  grasp.name = "wall";
  grasp.object_from_gripper.R.col(0) = Eigen::Vector3d::UnitY();
  grasp.object_from_gripper.R.col(1) = Eigen::Vector3d::UnitX();
  grasp.object_from_gripper.R.col(2) = -Eigen::Vector3d::UnitZ();
  grasp.object_from_gripper.t = {0.06, 0.008, 0.03};
  grasp.jaw_opening_m = 0.03;
  grasp.grip_width_m = 0.016;
  part.grasps = {grasp};
  truth_.objects[0] = PrepareObject(part).value();
  const auto offered = [&](const SceneAnswer& answer) -> const std::vector<SceneGrasp>& {
    return answer.objects[answer.objects[0].object_id == part.id ? 0 : 1].grasps;
  };
  const SceneAnswer without = Answer();
  ASSERT_EQ(offered(without).size(), 1u);
  EXPECT_FALSE(Has(without, FindingKind::kBaseUncertain));
  request_.camera_poses.resize(truth_.cameras.size());
  request_.camera_poses[1] =
      CameraPoseHint{truth_.camera_from_world[1] * base_from_world_.Inverse()};
  const SceneAnswer with = Answer();
  ASSERT_TRUE(with.base_from_scene.has_value());
  ASSERT_EQ(offered(with).size(), 1u);
  EXPECT_NEAR(offered(with)[0].scene_success, offered(without)[0].success, 1e-9);
  EXPECT_LT(offered(with)[0].success, 0.5);
  ASSERT_TRUE(Has(with, FindingKind::kBaseUncertain));
  for (const AnswerFinding& f : with.findings) {
    if (f.kind != FindingKind::kBaseUncertain) continue;
    EXPECT_EQ(f.object_id, part.id);
    EXPECT_GT(f.value, 0.005);
    EXPECT_GE(f.turn_rad, 0.01);
  }
  // By the part itself it is known exactly: nothing is to be told.
  request_.camera_poses.clear();
  request_.reference = ReferenceObject{part.id, base_from_world_ * truth_.world_from_object[0]};
  const SceneAnswer exact = Answer();
  EXPECT_FALSE(Has(exact, FindingKind::kBaseUncertain));
  EXPECT_GT(offered(exact)[0].success, 0.99);
}

TEST_F(FillAnswerTest, AMissingReferenceIsAReasonBesideTheOthers) {
  request_.reference = ReferenceObject{"nothing", {}};
  SceneAnswer answer;
  AddReason(ReasonKind::kAmbiguous, "two", &answer);
  ASSERT_TRUE(FillAnswer(metric_, truth_.objects, request_, {}, &answer).ok());
  ASSERT_EQ(answer.reasons.size(), 2u);
  EXPECT_EQ(answer.reasons[0].kind, ReasonKind::kAmbiguous);
  EXPECT_EQ(answer.reasons[1].kind, ReasonKind::kReferenceNotFound);
  EXPECT_FALSE(answer.base_from_scene.has_value());
}

}  // namespace
}  // namespace horopter
