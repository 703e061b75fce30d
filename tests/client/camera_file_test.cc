#include "client/camera_file.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "tests/client/temp_folder.h"

namespace horopter {
namespace {

using testing::HasSubstr;
using testing::IsEmpty;

// As camera_calibration writes it.
constexpr char kRos[] = R"(image_width: 640
image_height: 480
camera_name: left
camera_matrix:
  rows: 3
  cols: 3
  data: [600.0, 0.0, 320.5, 0.0, 601.0, 239.5, 0.0, 0.0, 1.0]
distortion_model: plumb_bob
distortion_coefficients:
  rows: 1
  cols: 5
  data: [-0.1, 0.0, 0.0, 0.0, 0.0]
)";

// As `ros2 topic echo` prints a message.
constexpr char kMessage[] = R"(header:
  frame_id: camera
height: 480
width: 640
distortion_model: plumb_bob
d:
- -0.1
- 0.0
- 0.0
- 0.0
- 0.0
k:
- 600.0
- 0.0
- 320.5
- 0.0
- 601.0
- 239.5
- 0.0
- 0.0
- 1.0
---
)";

// As OpenCV's calibration sample writes it.
constexpr char kOpenCv[] = R"(%YAML:1.0
---
calibration_time: "now"
image_width: 640
image_height: 480
camera_matrix: !!opencv-matrix
   rows: 3
   cols: 3
   dt: d
   data: [ 6.0000000000000000e+02, 0., 3.2050000000000000e+02, 0.,
       6.0100000000000000e+02, 2.3950000000000000e+02, 0., 0., 1. ]
distortion_coefficients: !!opencv-matrix
   rows: 5
   cols: 1
   dt: d
   data: [ -1.0000000000000001e-01, 0., 0., 0., 0. ]
)";

class CameraFileTest : public testing::Test {
 protected:
  absl::StatusOr<CameraFile> Read(const std::string& text) {
    return ReadCameraFile(folder_.Write("camera.yaml", text));
  }
  static std::string Replaced(std::string text, const std::string& from, const std::string& to) {
    return text.replace(text.find(from), from.size(), to);
  }
  TempFolder folder_;
};

TEST_F(CameraFileTest, TheSameCameraIsReadFromEveryForm) {
  for (const char* text : {kRos, kMessage, kOpenCv}) {
    const auto camera = Read(text);
    ASSERT_TRUE(camera.ok()) << camera.status();
    EXPECT_NEAR(camera->focal_px, 600.5, 1e-3);
    EXPECT_EQ(camera->cx, 320.5);
    EXPECT_EQ(camera->cy, 239.5);
    EXPECT_EQ(camera->k1, -0.1);
    EXPECT_EQ(camera->width, 640);
    EXPECT_EQ(camera->height, 480);
    EXPECT_THAT(camera->warnings, IsEmpty());
  }
}

TEST_F(CameraFileTest, WhatTheServerCannotTakeIsRefusedOrSaid) {
  EXPECT_THAT(Read(Replaced(kRos, "plumb_bob", "equidistant")).status().message(),
              HasSubstr("4 coefficients"));
  EXPECT_THAT(Read(Replaced(kRos, "plumb_bob", "thin_prism")).status().message(),
              HasSubstr("thin_prism"));
  EXPECT_THAT(Read(Replaced(kRos, "601.0", ".nan")).status().message(), HasSubstr("finite"));
  EXPECT_THAT(Read(Replaced(kRos, "601.0, ", "")).status().message(), HasSubstr("9 numbers"));
  EXPECT_THAT(Read("image_width: 640\n").status().message(), HasSubstr("camera_matrix"));
  EXPECT_THAT(Read("- 1\n- 2\n").status().message(), HasSubstr("camera_info"));
  EXPECT_FALSE(Read("a: [1, 2").ok());
  EXPECT_FALSE(Read("").ok());
  EXPECT_TRUE(absl::IsNotFound(ReadCameraFile("/no/such/file").status()));
}

TEST_F(CameraFileTest, ALensIsTakenWholeWhereOneCoefficientIsNotEnough) {
  EXPECT_FALSE(Read(kRos)->lens);
  const auto wavy = Read(Replaced(kRos, "[-0.1, 0.0, 0.0", "[-0.1, 0.5, 0.01"));
  ASSERT_TRUE(wavy.ok() && wavy->lens);
  EXPECT_THAT(wavy->lens->coefficients, testing::ElementsAre(-0.1, 0.5, 0.01, 0.0, 0.0));
  const auto oblong = Read(Replaced(kRos, "601.0", "700.0"));
  ASSERT_TRUE(oblong.ok() && oblong->lens);
  EXPECT_EQ(oblong->lens->fy, 700.0);
  EXPECT_EQ(ScaledTo(*oblong, 320, 240)->lens->fy, 350.0);
  const auto fisheye = Read(Replaced(Replaced(kRos, "plumb_bob", "equidistant"),
                                     "[-0.1, 0.0, 0.0, 0.0, 0.0]",
                                     "[0.1, 0.02, 0.0, 0.0]"));
  ASSERT_TRUE(fisheye.ok() && fisheye->lens) << fisheye.status();
  EXPECT_TRUE(fisheye->lens->fisheye);
  EXPECT_EQ(fisheye->lens->coefficients[1], 0.02);
  EXPECT_EQ(fisheye->k1, 0.0);
}

TEST_F(CameraFileTest, ASmallerImageOfTheSameCameraHasTheSameRays) {
  const CameraFile camera = *Read(kRos);
  const auto half = ScaledTo(camera, 320, 240);
  ASSERT_TRUE(half.ok());
  // The image's left edge, at -0.5 in both, is seen under the same angle.
  EXPECT_NEAR((-0.5 - half->cx) / half->focal_px, (-0.5 - camera.cx) / camera.focal_px, 1e-12);
  EXPECT_NEAR((319.5 - half->cx) / half->focal_px, (639.5 - camera.cx) / camera.focal_px, 1e-12);
  EXPECT_THAT(ScaledTo(camera, 320, 320).status().message(), HasSubstr("640 x 480"));
}

}  // namespace
}  // namespace horopter
