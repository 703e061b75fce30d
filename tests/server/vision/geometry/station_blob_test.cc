#include "server/vision/geometry/station_blob.h"

#include <gtest/gtest.h>

namespace horopter {
namespace {

StationState TwoCameras() {
  StationState state;
  state.requests = 7;
  for (const char* id : {"left", "right-2"}) {
    StationCamera c;
    c.id = id;
    c.camera = {1280, 960, 1800.5, 639.25, 479.75, -0.01};
    c.posed = true;
    c.camera_from_rig.t = {0.1, 0.2, 0.3};
    c.requests = 5;
    state.cameras.push_back(c);
  }
  state.cameras[1].moving = true;
  state.cameras[1].posed = false;
  state.covariance = Eigen::MatrixXd::Zero(20, 20);
  for (int i = 0; i < 20; ++i) {
    for (int j = 0; j < 20; ++j) state.covariance(i, j) = 1.0 / (1.0 + i + j);
  }
  return state;
}

TEST(StationBlob, GivesBackBitByBitWhatItWasGiven) {
  const StationState state = TwoCameras();
  const auto back = DecodeStationState(EncodeStationState(state));
  ASSERT_TRUE(back.ok()) << back.status();
  EXPECT_EQ(back->requests, 7);
  EXPECT_EQ(back->covariance, state.covariance);
  ASSERT_EQ(back->cameras.size(), 2u);
  EXPECT_EQ(back->cameras[1].id, "right-2");
  EXPECT_TRUE(back->cameras[1].moving);
  EXPECT_FALSE(back->cameras[1].posed);
  EXPECT_EQ(back->cameras[0].camera.k1, -0.01);
  EXPECT_EQ(back->cameras[0].camera_from_rig.t, state.cameras[0].camera_from_rig.t);
  EXPECT_EQ(EncodeStationState(*back), EncodeStationState(state));
  EXPECT_TRUE(DecodeStationState(EncodeStationState({})).ok());
}

TEST(StationBlob, WhateverIsDamagedIsRefused) {
  const std::string bytes = EncodeStationState(TwoCameras());
  for (std::size_t size = 0; size < bytes.size(); ++size)
    EXPECT_FALSE(DecodeStationState(bytes.substr(0, size)).ok()) << size;
  for (std::size_t i = 0; i < bytes.size(); ++i) {
    std::string damaged = bytes;
    damaged[i] = static_cast<char>(damaged[i] ^ 0x40);
    // Bytes of the header that say nothing (fingerprint, padding) may be anything.
    if (i >= 6 && i < 16) continue;
    EXPECT_FALSE(DecodeStationState(damaged).ok()) << i;
  }
  EXPECT_FALSE(DecodeStationState(bytes + "x").ok());
}

TEST(StationBlob, NumbersThatNoStateHasAreRefused) {
  for (int what = 0; what < 7; ++what) {
    StationState state = TwoCameras();
    if (what == 0) state.cameras[0].camera.focal_px = 0.0;
    if (what == 1) state.cameras[0].id = "Left";
    if (what == 2) state.cameras[0].camera.width = 0;
    if (what == 3) state.cameras[0].camera_from_rig.R(0, 0) = 2.0;
    if (what == 4) state.covariance(6, 6) = 0.0;
    if (what == 5) state.covariance(1, 0) = state.covariance(0, 1) = NAN;
    if (what == 6) state.requests = -1;
    EXPECT_EQ(DecodeStationState(EncodeStationState(state)).status().code(),
              absl::StatusCode::kDataLoss)
        << what;
  }
}

TEST(StationId, IsAsObjectsHaveThem) {
  EXPECT_TRUE(IsStationId("cell_1-a"));
  EXPECT_FALSE(IsStationId(""));
  EXPECT_FALSE(IsStationId("Cell"));
  EXPECT_FALSE(IsStationId("a/b"));
  EXPECT_FALSE(IsStationId(std::string(64, 'a')));
}

}  // namespace
}  // namespace horopter
