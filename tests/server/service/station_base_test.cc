// The base frame of a station: learnt, given, forgotten.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>
#include <optional>
#include <string>

#include "tests/server/service/station_service_fixture.h"

namespace horopter {
namespace {

// A station of two cameras whose places are known, and in the base by a reference.
class BaseOfAStationTest : public StationServiceTest {
 protected:
  void SetUp() override {
    ASSERT_TRUE(Make("cell").ok());
    for (int i = 0; i < 6; ++i) ASSERT_TRUE(Recognize(request_).ok());
    scene_.RefersTo({BaseFrom(0), BaseFrom(1)}, 0.004);
    ASSERT_TRUE(Recognize(request_).ok());
    ASSERT_EQ(Get("cell").cameras(0).base_source(), v1::StationCamera::BASE_SOURCE_LEARNT);
  }
  Rigid3 BaseFrom(int camera, double x_m = 0.0) {
    Rigid3 base = scene_.rig.poses[camera].Inverse();
    base.t.x() += x_m;
    return base;
  }
  grpc::Status Reset(const std::string& name, bool keep_base) {
    grpc::ClientContext context;
    v1::ResetStationRequest reset;
    reset.set_name(name);
    reset.set_keep_base(keep_base);
    return stations_->ResetStation(&context, reset, &station_);
  }
  void Give(const std::string& camera, std::optional<double> sigma_m) {
    v1::UpdateStationRequest update;
    update.mutable_station()->set_name("stations/cell");
    v1::StationCamera* out = update.mutable_station()->add_cameras();
    out->set_name("stations/cell/cameras/" + camera);
    out->mutable_base_from_camera()->mutable_rotation()->set_w(1.0);
    if (sigma_m) out->set_base_position_sigma_m(*sigma_m);
    given_ = Update(update);
  }

  const v1::RecognizeSceneRequest request_ = Request("cell", {"left", "right"});
  grpc::Status given_;
};

TEST_F(BaseOfAStationTest, ResetForgetsTheLearntBaseUnlessItIsKept) {
  ASSERT_TRUE(Reset("stations/cell", true).ok());
  EXPECT_EQ(station_.request_count(), 0);
  EXPECT_TRUE(station_.cameras(0).has_base_from_camera());
  ASSERT_TRUE(Reset("stations/cell", false).ok());
  EXPECT_FALSE(station_.cameras(0).has_base_from_camera());
  EXPECT_FALSE(station_.cameras(1).has_base_from_camera());
}

TEST_F(BaseOfAStationTest, ResetOfOneCameraForgetsItsBaseAlone) {
  ASSERT_TRUE(Reset("stations/cell/cameras/left", false).ok());
  EXPECT_FALSE(station_.cameras(0).has_base_from_camera());
  EXPECT_TRUE(station_.cameras(1).has_base_from_camera());
}

TEST_F(BaseOfAStationTest, ResetKeepsWhatWasGiven) {
  Give("left", 0.001);
  ASSERT_TRUE(given_.ok()) << given_.error_message();
  EXPECT_EQ(station_.cameras(0).base_source(), v1::StationCamera::BASE_SOURCE_GIVEN);
  EXPECT_EQ(station_.cameras(0).base_position_sigma_m(), 0.001);
  EXPECT_EQ(station_.cameras(0).base_rotation_sigma_rad(), 0.01);
  ASSERT_TRUE(Reset("stations/cell", false).ok());
  EXPECT_TRUE(station_.cameras(0).has_base_from_camera());
  EXPECT_FALSE(station_.cameras(1).has_base_from_camera());
}

TEST_F(BaseOfAStationTest, DeviationsThatAreNoneAreRefused) {
  for (const double sigma : {0.0, -1.0, 10.5, std::nan("")}) {
    Give("left", sigma);
    EXPECT_EQ(given_.error_code(), grpc::StatusCode::INVALID_ARGUMENT) << sigma;
    EXPECT_EQ(field_, "station.cameras[0].base_position_sigma_m");
  }
  v1::UpdateStationRequest update;
  update.mutable_station()->set_name("stations/cell");
  v1::StationCamera* camera = update.mutable_station()->add_cameras();
  camera->set_name("stations/cell/cameras/left");
  camera->set_base_rotation_sigma_rad(0.1);
  EXPECT_EQ(Update(update).error_code(), grpc::StatusCode::INVALID_ARGUMENT);
  EXPECT_EQ(field_, "station.cameras[0].base_from_camera");
}

TEST_F(BaseOfAStationTest, ABetterReferenceCorrectsIt) {
  const auto before = Get("cell").cameras(0);
  scene_.RefersTo({BaseFrom(0, 0.003), BaseFrom(1, 0.003)}, 0.0005);
  ASSERT_TRUE(Recognize(request_).ok());
  EXPECT_EQ(answer_.station().findings_size(), 0);
  const auto after = Get("cell").cameras(0);
  EXPECT_NEAR(
      after.base_from_camera().translation_m().x() - before.base_from_camera().translation_m().x(),
      0.003,
      0.0003);
  EXPECT_LT(after.base_position_sigma_m(), 0.15 * before.base_position_sigma_m());
  EXPECT_EQ(after.base_request_count(), 2);
}

TEST_F(BaseOfAStationTest, ABaseThatMovedIsAFindingAndIsLearntAnew) {
  scene_.RefersTo({BaseFrom(0, 0.15), BaseFrom(1, 0.15)}, 0.001);
  ASSERT_TRUE(Recognize(request_).ok());
  ASSERT_EQ(answer_.station().findings_size(), 1);
  const v1::StationFinding& finding = answer_.station().findings(0);
  EXPECT_EQ(finding.kind(), v1::StationFinding::KIND_BASE_MOVED);
  EXPECT_EQ(finding.cameras_size(), 2);
  EXPECT_NEAR(finding.translation_m(), 0.15, 1e-6);
  v1::Station station = Get("cell");
  EXPECT_EQ(station.events(0).kind(), v1::StationEvent::KIND_BASE_MOVED);
  // Nobody is told a base that may be wrong.
  EXPECT_FALSE(station.cameras(0).has_base_from_camera());
  EXPECT_FALSE(station.cameras(1).has_base_from_camera());
  ASSERT_TRUE(Recognize(request_).ok());
  EXPECT_EQ(answer_.station().findings_size(), 0);
  EXPECT_NEAR(
      Get("cell").cameras(0).base_from_camera().translation_m().x(), BaseFrom(0, 0.15).t.x(), 1e-9);
}

TEST_F(BaseOfAStationTest, WhatWasGivenIsContradictedAndStays) {
  Give("left", 0.001);
  scene_.RefersTo({BaseFrom(0, 0.15), std::nullopt}, 0.001);
  for (int i = 0; i < 2; ++i) {
    ASSERT_TRUE(Recognize(request_).ok());
    ASSERT_EQ(answer_.station().findings_size(), 1);
    EXPECT_EQ(answer_.station().findings(0).kind(), v1::StationFinding::KIND_BASE_MOVED);
    EXPECT_EQ(Get("cell").cameras(0).base_from_camera().translation_m().x(), 0.0);
  }
}

}  // namespace
}  // namespace horopter
