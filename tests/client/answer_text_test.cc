#include "client/answer_text.h"

#include <gtest/gtest.h>

namespace horopter {
namespace {

TEST(CameraText, SaysFocalLengthItsDeviationAndWhatTheCameraRestsOn) {
  v1::Camera camera;
  camera.set_recovered(true);
  camera.set_focal_px(632.4);
  camera.set_focal_log_sigma(0.0123);
  EXPECT_EQ(CameraText(camera), "focal length 632 px (+- 1.2 %)");
  v1::CameraBasis* const texture = camera.add_bases();
  texture->set_source(v1::CameraBasis::SOURCE_TEXTURE);
  texture->set_matches(124);
  texture->set_rms_px(0.82);
  camera.add_bases()->set_source(v1::CameraBasis::SOURCE_GIVEN);
  EXPECT_EQ(CameraText(camera),
            "focal length 632 px (+- 1.2 %); camera by texture 124 (0.8 px), given");
}

TEST(CameraText, NamesAnImageOfSomethingElse) {
  v1::Camera camera;
  EXPECT_EQ(CameraText(camera), "camera not recovered");
  camera.set_unrelated(true);
  EXPECT_EQ(CameraText(camera),
            "camera not recovered; shows nothing of what the other images show");
}

TEST(OpenCamerasText, SaysThatTwoSolutionsAreLeft) {
  v1::RecognizeSceneResponse response;
  EXPECT_EQ(OpenCamerasText(response), "");
  (*response.add_stages()->mutable_counts())["texture_points_in_space"] = 120.0;
  EXPECT_EQ(OpenCamerasText(response), "");
  (*response.add_stages()->mutable_counts())["texture_solutions"] = 2.0;
  EXPECT_EQ(OpenCamerasText(response),
            "cameras: texture alone leaves 2 solutions open; the one whose parts more images show "
            "was taken");
}

}  // namespace
}  // namespace horopter
