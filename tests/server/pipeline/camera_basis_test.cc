#include "server/pipeline/camera_basis.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "server/pipeline/scene.h"

namespace horopter {
namespace {

using ::testing::HasSubstr;

// Three images: the first two share texture, parts are seen in the second.
struct Answered {
  SceneRequest request;
  SceneTrace trace;
  SceneAnswer answer;

  Answered() {
    request.images.resize(3);
    trace.reconstruction.view_matches = {
        {MatchSource::kTexture, 120, 0.8}, {MatchSource::kFeatures, 40, 1.5}, {}};
    trace.metric.emplace();
    trace.metric->view_fits = {{}, {310, 1.1}, {}};
    answer.cameras.resize(3);
    answer.cameras[0].emplace();
    answer.cameras[1].emplace();
  }
};

TEST(TellCameraBases, SaysWhatEachCameraRestsOn) {
  Answered a;
  TellCameraBases(a.request, a.trace, false, &a.answer);
  ASSERT_EQ(a.answer.camera_bases.size(), 3u);
  ASSERT_EQ(a.answer.camera_bases[0].size(), 1u);
  EXPECT_EQ(a.answer.camera_bases[0][0].source, BasisSource::kTexture);
  EXPECT_EQ(a.answer.camera_bases[0][0].matches, 120);
  ASSERT_EQ(a.answer.camera_bases[1].size(), 2u);
  EXPECT_EQ(a.answer.camera_bases[1][0].source, BasisSource::kFeatures);
  EXPECT_EQ(a.answer.camera_bases[1][1].source, BasisSource::kParts);
  EXPECT_EQ(a.answer.camera_bases[1][1].matches, 310);
  EXPECT_DOUBLE_EQ(a.answer.camera_bases[1][1].rms_px, 1.1);
  EXPECT_TRUE(a.answer.camera_bases[2].empty());
}

TEST(TellCameraBases, NamesTheImageThatDoesNotBelongToTheOthers) {
  Answered a;
  TellCameraBases(a.request, a.trace, false, &a.answer);
  EXPECT_EQ(a.answer.unrelated_images, std::vector<bool>({false, false, true}));
  ASSERT_EQ(a.answer.reasons.size(), 1u);
  EXPECT_EQ(a.answer.reasons[0].kind, ReasonKind::kUnrelatedImages);
  EXPECT_THAT(a.answer.reasons[0].detail, HasSubstr("3"));
}

TEST(TellCameraBases, WhereNothingIsLinkedNoImageIsUnrelated) {
  Answered a;
  a.trace.reconstruction.view_matches = {{MatchSource::kTexture, 120, 0.8}, {}, {}};
  a.answer.cameras = {std::nullopt, std::nullopt, std::nullopt};
  TellCameraBases(a.request, a.trace, false, &a.answer);
  EXPECT_EQ(a.answer.unrelated_images, std::vector<bool>(3, false));
  EXPECT_TRUE(a.answer.reasons.empty());
  a.trace.reconstruction.view_matches.clear();  // nothing was reconstructed
  TellCameraBases(a.request, a.trace, false, &a.answer);
  EXPECT_TRUE(a.answer.reasons.empty());
}

TEST(TellCameraBases, WhatWasKnownBeforeIsNamed) {
  Answered a;
  a.request.hints.resize(3);
  a.request.hints[0].focal_px = 800.0;
  a.request.hints[1].focal_px = 800.0;
  a.request.hints[1].presumed = true;  // of the image's file
  TellCameraBases(a.request, a.trace, true, &a.answer);
  ASSERT_EQ(a.answer.camera_bases[0].size(), 3u);
  EXPECT_EQ(a.answer.camera_bases[0][1].source, BasisSource::kStation);
  EXPECT_EQ(a.answer.camera_bases[0][2].source, BasisSource::kGiven);
  EXPECT_EQ(a.answer.camera_bases[1].back().source, BasisSource::kStation);
}

}  // namespace
}  // namespace horopter
