#include "server/pipeline/expected_parts.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <Eigen/Geometry>
#include <numbers>
#include <utility>

namespace horopter {
namespace {

using testing::ElementsAre;
using testing::IsEmpty;

Rigid3 At(double x, double y, double turn_rad = 0.0) {
  return {RotationFromVector({0.0, 0.0, turn_rad}), {x, y, 0.0}};
}

ExpectedPart Want(const std::string& id, std::optional<Rigid3> place = std::nullopt) {
  ExpectedPart part;
  part.object_id = id;
  part.frame_from_object = std::move(place);
  return part;
}

FoundPart Found(const std::string& id, const Rigid3& pose, double score = 0.95) {
  FoundPart part;
  part.object_id = id;
  part.score = score;
  part.scene_from_object = pose;
  return part;
}

// Bolts and nuts of 20 mm on a table that two cameras see from above, the base the scene.
class JudgeExpectedTest : public testing::Test {
 protected:
  void SetUp() override {
    for (const char* id : {"bolt", "nut", "tray"}) scene_.shapes[id].radius_m = 0.01;
    scene_.base_from_scene = Rigid3{};
    for (const double x : {-0.1, 0.1}) {
      Rigid3 camera;  // 1 m above, looking down
      camera.R = Eigen::Vector3d(1.0, -1.0, -1.0).asDiagonal();
      camera.t = camera.R * -Eigen::Vector3d(x, 0.0, 1.0);
      scene_.cameras.push_back({CenteredCamera(640, 480, 600.0), camera});
    }
  }
  ExpectedReport Judge(const std::vector<ExpectedPart>& expected) {
    ExpectedReport report = JudgeExpected(expected, scene_);
    double all = 1.0;
    for (const ExpectedOutcome& o : report.outcomes) {
      EXPECT_NEAR(o.present + o.missing + o.displaced + o.wrong_part + o.cannot_tell, 1.0, 1e-12);
      all *= o.present;
    }
    EXPECT_NEAR(report.all_present, all, 1e-12);
    return report;
  }
  ExpectedOutcome JudgeOne(const ExpectedPart& part) { return Judge({part}).outcomes.at(0); }

  ExpectedScene scene_;
};

TEST_F(JudgeExpectedTest, APartInItsPlaceIsPresentWithItsScore) {
  scene_.parts = {Found("bolt", At(0.1, 0.05))};
  const ExpectedOutcome o = JudgeOne(Want("bolt", At(0.101, 0.05, 0.02)));
  EXPECT_EQ(o.state, ExpectedState::kPresent);
  EXPECT_DOUBLE_EQ(o.present, 0.95);
  EXPECT_NEAR(o.cannot_tell, 0.05, 1e-12);
  EXPECT_EQ(o.found, 0);
  EXPECT_NEAR(*o.distance_m, 0.001, 1e-12);
  EXPECT_NEAR(*o.rotation_rad, 0.02, 1e-9);
}

TEST_F(JudgeExpectedTest, OutOfEitherToleranceItIsDisplaced) {
  scene_.parts = {Found("bolt", At(0.0, 0.0))};
  ExpectedPart part = Want("bolt", At(0.02, 0.0));
  EXPECT_EQ(JudgeOne(part).state, ExpectedState::kDisplaced);
  part.position_tolerance_m = 0.03;
  EXPECT_EQ(JudgeOne(part).state, ExpectedState::kPresent);
  part.frame_from_object = At(0.0, 0.0, 0.3);
  EXPECT_EQ(JudgeOne(part).state, ExpectedState::kDisplaced);
  EXPECT_NEAR(*JudgeOne(part).rotation_rad, 0.3, 1e-9);
  part.rotation_tolerance_rad = 0.4;
  EXPECT_EQ(JudgeOne(part).state, ExpectedState::kPresent);
}

TEST_F(JudgeExpectedTest, SymmetricRotationsAreTheSamePose) {
  scene_.parts = {Found("bolt", At(0.0, 0.0, std::numbers::pi))};
  const ExpectedPart part = Want("bolt", At(0.0, 0.0));
  EXPECT_EQ(JudgeOne(part).state, ExpectedState::kDisplaced);
  scene_.shapes["bolt"].symmetries = {At(0.0, 0.0, std::numbers::pi)};
  EXPECT_EQ(JudgeOne(part).state, ExpectedState::kPresent);
}

TEST_F(JudgeExpectedTest, TheCovarianceSharesPresentAndDisplaced) {
  scene_.parts = {Found("bolt", At(0.005, 0.0), 1.0)};  // at the very tolerance
  scene_.joint_covariance = 1e-6 * Eigen::MatrixXd::Identity(6, 6);
  const ExpectedOutcome o = JudgeOne(Want("bolt", At(0.0, 0.0)));
  EXPECT_NEAR(o.present, 0.5, 0.01);
  EXPECT_NEAR(o.displaced, 0.5, 0.01);
  // The base's deviation counts for a place in the base.
  scene_.parts = {Found("bolt", At(0.0, 0.0), 1.0)};
  EXPECT_GT(JudgeOne(Want("bolt", At(0.0, 0.0))).present, 0.99);
  scene_.covariances_in_base = {1e-4 * Matrix6d::Identity()};
  EXPECT_LT(JudgeOne(Want("bolt", At(0.0, 0.0))).present, 0.5);
}

TEST_F(JudgeExpectedTest, InATraysFrameWhatBothErrByInCommonDoesNotCount) {
  scene_.base_from_scene.reset();
  scene_.parts = {Found("tray", At(0.1, 0.1, 0.7), 1.0),
                  Found("bolt", At(0.1, 0.1, 0.7) * At(0.05, 0.0), 1.0)};
  ExpectedPart part = Want("bolt", At(0.05, 0.0));
  part.frame_object = "tray";
  // A shift and a turn of the whole scene by a centimetre and a degree.
  Eigen::MatrixXd A = Eigen::MatrixXd::Zero(12, 6);
  for (int k = 0; k < 2; ++k) {
    A.block<6, 6>(6 * k, 0).setIdentity();
    const Eigen::Vector3d r = scene_.parts[k].scene_from_object.t;
    for (int axis = 0; axis < 3; ++axis)
      A.block<3, 1>(6 * k + 3, axis) = Eigen::Vector3d::Unit(axis).cross(r);
  }
  Vector6d sigmas;
  sigmas << 0.017, 0.017, 0.017, 0.01, 0.01, 0.01;
  scene_.joint_covariance = A * Matrix6d(sigmas.cwiseAbs2().asDiagonal()) * A.transpose();
  const ExpectedReport together = Judge({part});
  EXPECT_GT(together.outcomes[0].present, 0.999);
  EXPECT_THAT(together.unexpected, IsEmpty());  // the tray is the frame
  // Each on its own they are not known well enough.
  scene_.joint_covariance.topRightCorner<6, 6>().setZero();
  scene_.joint_covariance.bottomLeftCorner<6, 6>().setZero();
  EXPECT_LT(JudgeOne(part).present, 0.5);
}

TEST_F(JudgeExpectedTest, WhatImagesShowAndIsNotFoundIsMissing) {
  const ExpectedOutcome o = JudgeOne(Want("bolt", At(0.1, 0.05)));
  EXPECT_EQ(o.state, ExpectedState::kMissing);
  EXPECT_NEAR(o.missing, 1.0 / 1.1, 1e-12);
  EXPECT_EQ(o.found, -1);
  EXPECT_FALSE(o.distance_m.has_value());
  scene_.cameras.pop_back();  // of one image it is less sure
  EXPECT_LT(JudgeOne(Want("bolt", At(0.1, 0.05))).missing, o.missing);
  EXPECT_EQ(JudgeOne(Want("bolt")).state, ExpectedState::kMissing);  // anywhere
}

TEST_F(JudgeExpectedTest, WhatNoImageShowsCannotBeTold) {
  const ExpectedPart aside = Want("bolt", At(3.0, 0.0));
  EXPECT_EQ(JudgeOne(aside).cannot_tell, 1.0);
  // Behind a nut as high as a house.
  scene_.parts = {Found("nut", {Eigen::Matrix3d::Identity(), {0.0, 0.0, 0.5}})};
  scene_.shapes["nut"].radius_m = 0.4;
  EXPECT_EQ(JudgeOne(Want("bolt", At(0.0, 0.0))).state, ExpectedState::kCannotTell);
  scene_.parts.clear();
  EXPECT_EQ(JudgeOne(Want("bolt", At(0.0, 0.0))).state, ExpectedState::kMissing);
  scene_.searched = false;
  EXPECT_EQ(JudgeOne(Want("bolt", At(0.0, 0.0))).cannot_tell, 1.0);
  scene_.searched = true;
  scene_.base_from_scene.reset();
  EXPECT_EQ(JudgeOne(Want("bolt", At(0.0, 0.0))).cannot_tell, 1.0);
  ExpectedPart in_tray = Want("bolt", At(0.0, 0.0));
  in_tray.frame_object = "tray";
  EXPECT_EQ(JudgeOne(in_tray).cannot_tell, 1.0);
}

// An answer without anything says nothing of what is not in it.
TEST_F(JudgeExpectedTest, WithoutCamerasNothingIsMissing) {
  EXPECT_EQ(JudgeOne(Want("bolt")).state, ExpectedState::kMissing);
  scene_.cameras.clear();
  EXPECT_EQ(JudgeOne(Want("bolt")).cannot_tell, 1.0);
}

TEST_F(JudgeExpectedTest, AnotherPartInThePlaceIsWrong) {
  scene_.parts = {Found("nut", At(0.1, 0.05))};
  const ExpectedReport report = Judge({Want("bolt", At(0.1, 0.05))});
  EXPECT_EQ(report.outcomes[0].state, ExpectedState::kWrongPart);
  EXPECT_DOUBLE_EQ(report.outcomes[0].wrong_part, 0.95);
  EXPECT_EQ(report.outcomes[0].found, 0);
  EXPECT_THAT(report.unexpected, ElementsAre(0));
  // What the images hardly tell is no verdict.
  scene_.parts[0].score = 0.4;
  EXPECT_EQ(JudgeOne(Want("bolt", At(0.1, 0.05))).state, ExpectedState::kCannotTell);
}

TEST_F(JudgeExpectedTest, SwappedPartsAreWrongInBothPlaces) {
  scene_.parts = {Found("nut", At(0.0, 0.0)), Found("bolt", At(0.1, 0.0))};
  const ExpectedReport report =
      Judge({Want("bolt", At(0.0, 0.0)), Want("nut", At(0.1, 0.0)), Want("nut")});
  EXPECT_EQ(report.outcomes[0].state, ExpectedState::kWrongPart);
  EXPECT_EQ(report.outcomes[1].state, ExpectedState::kWrongPart);
  EXPECT_EQ(report.outcomes[2].state, ExpectedState::kPresent);  // it may be anywhere
  EXPECT_THAT(report.unexpected, ElementsAre(1));
}

TEST_F(JudgeExpectedTest, CountsAreMatchedOneToOne) {
  scene_.parts = {Found("bolt", At(0.0, 0.0), 0.9),
                  Found("bolt", At(0.1, 0.0), 0.8),
                  Found("nut", At(0.2, 0.0)),
                  Found("bolt", At(0.0, 0.2), 0.7)};
  ExpectedPart two = Want("bolt");
  two.count = 2;
  ExpectedReport report = Judge({two});
  ASSERT_EQ(report.outcomes.size(), 2u);
  EXPECT_EQ(report.outcomes[0].found, 0);  // the surest
  EXPECT_EQ(report.outcomes[1].found, 1);
  EXPECT_THAT(report.unexpected, ElementsAre(2, 3));
  two.count = 4;
  report = Judge({two});
  EXPECT_EQ(report.outcomes[3].state, ExpectedState::kMissing);
  EXPECT_EQ(report.all_present, 0.0);
  // Places take those that are in them, whatever the order.
  report = Judge({Want("bolt", At(0.1, 0.0)), Want("bolt", At(0.0, 0.2)), Want("bolt")});
  EXPECT_EQ(report.outcomes[0].found, 1);
  EXPECT_EQ(report.outcomes[1].found, 3);
  EXPECT_EQ(report.outcomes[2].found, 0);
}

TEST_F(JudgeExpectedTest, ReferencesAreNeitherUnexpectedNorInAnyonesWay) {
  scene_.parts = {Found("tray", At(0.0, 0.0))};
  scene_.parts[0].is_reference = true;
  const ExpectedReport report = Judge({Want("bolt", At(0.0, 0.0))});
  EXPECT_EQ(report.outcomes[0].found, -1);
  EXPECT_THAT(report.unexpected, IsEmpty());
}

TEST_F(JudgeExpectedTest, NothingExpectedAndNothingThereIsAllWell) {
  const ExpectedReport report = Judge({});
  EXPECT_THAT(report.outcomes, IsEmpty());
  EXPECT_EQ(report.all_present, 1.0);
}

}  // namespace
}  // namespace horopter
