// References that leave the robot's base open, and what decides then.
#include "server/pipeline/reference_base.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <numbers>

#include "server/pipeline/answer.h"
#include "server/vision/recognition/object/prepared_object.h"
#include "tests/support/synthetic_metric_scene.h"
#include "tests/support/synthetic_part.h"

namespace horopter {
namespace {

// 80 x 50 x 30 mm, the same after half a turn about each axis through its middle.
ObjectModel Block() {
  ObjectModel m = Prism("block", {{0, 0}, {0.08, 0}, {0.08, 0.05}, {0, 0.05}}, 0.03);
  const Eigen::Vector3d middle(0.04, 0.025, 0.015);
  for (int axis = 0; axis < 3; ++axis) {
    Rigid3 half;
    half.R = RotationFromVector(std::numbers::pi * Eigen::Vector3d::Unit(axis));
    half.t = middle - half.R * middle;
    m.symmetries.push_back(half);
  }
  return m;
}

class ReferenceBaseTest : public testing::Test {
 protected:
  void Show(const std::vector<ObjectModel>& parts) {
    MetricSceneOptions options;
    for (const ObjectModel& part : parts) options.parts.push_back(PrepareObject(part).value());
    truth_ = MakeMetricScene(options);
    metric_ = RefineMetricScene(truth_.Input(), truth_.recognition, {}).value();
    request_.images.resize(truth_.cameras.size());
    base_from_world_.R = RotationFromVector({0.2, -0.1, 1.2});
    base_from_world_.t = {0.5, -0.2, 0.1};
  }
  // As it truly is, of part k.
  ReferenceObject True(int k) const {
    return {truth_.objects[k]->model.id, base_from_world_ * truth_.world_from_object[k]};
  }
  void KnowCamera(int view, double position_sigma_m = 0.001) {
    request_.camera_poses.resize(truth_.cameras.size());
    request_.camera_poses[view] = CameraPoseHint{
        truth_.camera_from_world[view] * base_from_world_.Inverse(), 0.002, position_sigma_m};
  }
  SceneAnswer Answer() {
    SceneAnswer answer;
    EXPECT_TRUE(FillAnswer(metric_, truth_.objects, request_, {}, &answer).ok());
    return answer;
  }
  // How far a pose of the base puts the part from where it is, metres.
  double Off(const Rigid3& base_from_scene, const SceneAnswer& answer, int k) const {
    const std::string& id = truth_.objects[k]->model.id;
    double least = 1e9;
    for (const AnswerObject& o : answer.objects) {
      if (o.object_id != id) continue;
      const Rigid3 expected = base_from_world_ * truth_.world_from_object[k];
      least = std::min(least, (base_from_scene * o.scene_from_object.t - expected.t).norm());
    }
    return least;
  }
  static void ExpectAmbiguous(const SceneAnswer& answer, std::size_t alternatives) {
    EXPECT_FALSE(answer.base_from_scene.has_value());
    EXPECT_TRUE(HasReason(answer, ReasonKind::kReferenceAmbiguous)) << ReasonsText(answer);
    EXPECT_EQ(answer.base_alternatives.size(), alternatives);
    EXPECT_TRUE(answer.base_from_camera_by_reference.empty());
    for (const AnswerObject& o : answer.objects) EXPECT_FALSE(o.base_from_object.has_value());
  }

  MetricSceneTruth truth_;
  MetricScene metric_;
  SceneRequest request_;
  Rigid3 base_from_world_;
};

TEST_F(ReferenceBaseTest, ASymmetricReferenceGivesEveryBaseThatAgreesAndNone) {
  Show({Block(), Wedge()});
  request_.reference = True(0);
  const SceneAnswer answer = Answer();
  ExpectAmbiguous(answer, 4);
  // One of them is true, the others put the wedge elsewhere.
  const auto right = std::count_if(
      answer.base_alternatives.begin(), answer.base_alternatives.end(), [&](const AnswerBase& b) {
        EXPECT_EQ(b.object_id, "block");
        return Off(b.base_from_scene, answer, 1) < 0.003;
      });
  EXPECT_EQ(right, 1);
  const auto warned =
      std::find_if(answer.findings.begin(), answer.findings.end(), [](const AnswerFinding& f) {
        return f.kind == FindingKind::kReferenceSymmetric;
      });
  ASSERT_NE(warned, answer.findings.end());
  EXPECT_EQ(warned->object_id, "block");
  EXPECT_EQ(warned->value, 4.0);
}

TEST_F(ReferenceBaseTest, ACameraInTheBaseDecidesWhichWayASymmetricReferenceLies) {
  Show({Block(), Wedge()});
  // The caller and recognition need not mean the same of four equal poses.
  for (int s = 0; s <= 3; ++s) {
    request_.reference = True(0);
    if (s > 0) {
      request_.reference->base_from_object =
          request_.reference->base_from_object * truth_.objects[0]->model.symmetries[s - 1];
    }
    KnowCamera(1);
    const SceneAnswer answer = Answer();
    ASSERT_TRUE(answer.base_from_scene.has_value()) << ReasonsText(answer);
    EXPECT_LT(Off(*answer.base_from_scene, answer, 1), 0.003) << s;
    EXPECT_FALSE(HasReason(answer, ReasonKind::kReferenceAmbiguous));
    EXPECT_EQ(answer.base_from_camera_by_reference.size(), truth_.cameras.size());
  }
}

TEST_F(ReferenceBaseTest, AnotherReferenceDecides) {
  Show({Block(), Wedge()});
  request_.reference = True(0);
  request_.further_references = {True(1)};
  const SceneAnswer answer = Answer();
  ASSERT_TRUE(answer.base_from_scene.has_value()) << ReasonsText(answer);
  EXPECT_LT(Off(*answer.base_from_scene, answer, 1), 0.003);
  EXPECT_TRUE(answer.base_alternatives.empty());
}

TEST_F(ReferenceBaseTest, ReferencesThatCannotBothBeTrueAreAConflict) {
  Show({Block(), Wedge()});
  request_.reference = True(0);
  request_.further_references = {True(1)};
  request_.further_references[0].base_from_object.t.x() += 0.05;
  const SceneAnswer answer = Answer();
  EXPECT_FALSE(answer.base_from_scene.has_value());
  EXPECT_TRUE(HasReason(answer, ReasonKind::kReferenceConflict));
  EXPECT_FALSE(HasReason(answer, ReasonKind::kReferenceAmbiguous));
}

TEST_F(ReferenceBaseTest, TwoInstancesOfAReferenceLeaveTheBaseOpen) {
  Show({Wedge(), Wedge(), LBracket()});
  request_.reference = True(0);
  ExpectAmbiguous(Answer(), 2);
  // Which of them it is says a part whose place is known,
  request_.further_references = {True(2)};
  const SceneAnswer decided = Answer();
  ASSERT_TRUE(decided.base_from_scene.has_value()) << ReasonsText(decided);
  EXPECT_LT(Off(*decided.base_from_scene, decided, 2), 0.003);
  // or a camera.
  request_.further_references.clear();
  KnowCamera(2);
  const SceneAnswer posed = Answer();
  ASSERT_TRUE(posed.base_from_scene.has_value()) << ReasonsText(posed);
  EXPECT_LT(Off(*posed.base_from_scene, posed, 2), 0.003);
}

// Two fixtures of one kind, one of them out of sight.
TEST_F(ReferenceBaseTest, OneOfTwoEqualReferencesIsEither) {
  Show({Wedge(), LBracket()});
  request_.reference = True(0);
  request_.further_references = {True(0)};
  request_.further_references[0].base_from_object.t.x() += 0.4;
  ExpectAmbiguous(Answer(), 2);
}

TEST_F(ReferenceBaseTest, AReferenceFreeToTurnLeavesTheBaseToTheCameras) {
  Show({Cylinder(0.02, 0.05), Wedge()});
  request_.reference = True(0);
  const SceneAnswer open = Answer();
  EXPECT_FALSE(open.base_from_scene.has_value());
  EXPECT_TRUE(HasReason(open, ReasonKind::kReferenceAmbiguous)) << ReasonsText(open);
  KnowCamera(0);
  const SceneAnswer posed = Answer();
  ASSERT_TRUE(posed.base_from_scene.has_value()) << ReasonsText(posed);
  // As well as a camera of 2 mrad says it.
  EXPECT_LT(Off(*posed.base_from_scene, posed, 1), 0.015);
}

TEST_F(ReferenceBaseTest, TheDeviationsOfAReferenceReachEveryPart) {
  Show({LBracket(), Wedge()});
  request_.reference = True(0);
  const double exact = Answer().objects[0].base_from_object->covariance.trace() +
                       Answer().objects[1].base_from_object->covariance.trace();
  request_.reference->rotation_sigma_rad = 0.01;
  request_.reference->position_sigma_m = 0.004;
  const SceneAnswer answer = Answer();
  for (const AnswerObject& o : answer.objects) {
    EXPECT_GT(o.base_from_object->covariance(3, 3), 0.9 * 0.004 * 0.004) << o.object_id;
    EXPECT_GT(o.base_from_object->covariance(0, 0), 0.9 * 0.01 * 0.01) << o.object_id;
  }
  EXPECT_LT(exact, 1e-4);
}

}  // namespace
}  // namespace horopter
