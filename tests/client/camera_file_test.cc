#include "client/camera_file.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "tests/client/temp_folder.h"

namespace horopter {
namespace {

using testing::AllOf;
using testing::ElementsAre;
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
  EXPECT_THAT(Read(Replaced(Replaced(kRos, "plumb_bob", "equidistant"),
                            "[-0.1, 0.0, 0.0, 0.0, 0.0]",
                            "[-0.1, 0.0, 0.0]"))
                  .status()
                  .message(),
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
  EXPECT_EQ(ForImages(*oblong, 320, 240)->lens->fy, 350.0);
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
  const auto half = ForImages(camera, 320, 240);
  ASSERT_TRUE(half.ok());
  // The image's left edge, at -0.5 in both, is seen under the same angle.
  EXPECT_NEAR((-0.5 - half->cx) / half->focal_px, (-0.5 - camera.cx) / camera.focal_px, 1e-12);
  EXPECT_NEAR((319.5 - half->cx) / half->focal_px, (639.5 - camera.cx) / camera.focal_px, 1e-12);
  EXPECT_THAT(half->warnings, ElementsAre(HasSubstr("scaled by 0.5")));
  EXPECT_THAT(ForImages(camera, 320, 320).status().message(), HasSubstr("640 x 480"));
  EXPECT_THAT(ForImages(camera, 640, 480)->warnings, IsEmpty());
}

std::string Input(const std::string& name) {
  return std::string(HOROPTER_TEST_DATA "/inputs/cameras/") + name;
}

// The camera that the inputs describe.
void ExpectTheCamera(const absl::StatusOr<CameraFile>& file, const std::string& name) {
  ASSERT_TRUE(file.ok()) << name << ": " << file.status();
  const auto camera = ForImages(*file, 640, 480);
  ASSERT_TRUE(camera.ok()) << name << ": " << camera.status();
  EXPECT_NEAR(camera->focal_px, 979.75, 1e-9) << name;
  EXPECT_NEAR(camera->cx, 313.64, 1e-9) << name;
  EXPECT_NEAR(camera->cy, 237.58, 1e-9) << name;
  EXPECT_THAT(camera->warnings, IsEmpty()) << name;
}

TEST(CameraInputs, OneCameraIsReadFromWhateverDescribesIt) {
  for (const char* name : {"ros_roi_same_aspect.yaml",
                           "ros_binned.yaml",
                           "nested.yaml",
                           "nested_data.yaml",
                           "ros_none_model.yaml",
                           "ros_brown_conrady.yaml",
                           "ros_rational_mild.yaml",
                           "bop_camera.json",
                           "opencv.xml",
                           "kalibr_camchain.yaml#cam0",
                           "colmap_cameras.txt",
                           "stereo.yml#1"}) {
    const auto file = ReadCameraFile(Input(name));
    ExpectTheCamera(file, name);
    EXPECT_TRUE(file.ok() && !file->lens) << name;
  }
  EXPECT_EQ(ReadCameraFile(Input("ros_rational_mild.yaml"))->k1, 0.01);
}

TEST(CameraInputs, WholeLensesAreTaken) {
  const auto rational = ReadCameraFile(Input("ros_rational.yaml"));
  ASSERT_TRUE(rational.ok() && rational->lens) << rational.status();
  EXPECT_THAT(rational->lens->coefficients, ElementsAre(0.31, -0.15, 0.0002, 0.0001, 0.01));
  EXPECT_THAT(rational->lens->denominator, ElementsAre(0.33, -0.16, 0.012));
  EXPECT_TRUE(ForImages(*rational, 640, 480).ok());
  for (const auto& [name, k1] : {std::pair{"opencv_fisheye.yml", 0.05},
                                 {"kalibr_camchain.yaml#cam1", 0.05},
                                 {"ros_equi_5.yaml", 0.01}}) {
    const auto fisheye = ReadCameraFile(Input(name));
    ASSERT_TRUE(fisheye.ok() && fisheye->lens) << name << fisheye.status();
    EXPECT_TRUE(fisheye->lens->fisheye) << name;
    EXPECT_EQ(fisheye->lens->coefficients[0], k1) << name;
    EXPECT_TRUE(ForImages(*fisheye, 640, 480).ok()) << name;
  }
  EXPECT_EQ(ReadCameraFile(Input("stereo.yml#2"))->k1, -0.1);
}

TEST(CameraInputs, WhatIsNoCameraIsRefusedByItsName) {
  EXPECT_THAT(ReadCameraFile(Input("colmajor.yaml")).status().message(),
              AllOf(HasSubstr("camera_matrix"), HasSubstr("transposed")));
  const auto identity = ReadCameraFile(Input("identityK.yaml"));
  EXPECT_THAT(ForImages(*identity, 640, 480).status().message(), HasSubstr("focal length of 1 "));
  EXPECT_FALSE(ForDescribedImages(*identity).ok());
  for (const char* name : {"stereo.yml", "kalibr_camchain.yaml", "stereo.yml#3"})
    EXPECT_THAT(ReadCameraFile(Input(name)).status().message(), HasSubstr("asked for with FILE#"))
        << name;
}

// A camera with these lines beside its matrix.
std::string WithMatrix(const std::string& matrix, const std::string& more = "") {
  return "image_width: 640\nimage_height: 480\n" + matrix + "\n" + more;
}

TEST_F(CameraFileTest, NamesAndShapesOfAMatrix) {
  for (const char* matrix :
       {"mtx: [[979.75, 0, 313.64], [0, 979.75, 237.58], [0, 0, 1]]\ndist: [[0, 0, 0, 0, 0]]",
        "CameraMatrix: [979.75, 0, 313.64, 0, 979.75, 237.58, 0, 0, 1]\ndist_coeff: [0, 0, 0, 0]",
        "camera_matrix: {data: [979.75, 0, 313.64, 0, 979.75, 237.58, 0, 0, 1]}\n"
        "dist_coeffs: [[0], [0], [0], [0], [0]]",
        "\"K\": [[979.75, 0, 313.64], [0, 979.75, 237.58], [0, 0, 1]]\n\"dist\": []",
        "intrinsic_matrix: [979.75, 0, 313.64, 0, 979.75, 237.58, 0, 0, 1]",
        "fx: 979.75\nfy: 979.75\ncx: 313.64\ncy: 237.58",
        "left:\n  camera_matrix: [979.75, 0, 313.64, 0, 979.75, 237.58, 0, 0, 1]",
        "cam_K: [979.75, 0.0, 313.64, 0.0, 979.75, 237.58, 0.0, 0.0, 1.0]"}) {
    ExpectTheCamera(Read(WithMatrix(matrix)), matrix);
  }
  ExpectTheCamera(
      Read("{\"image_size\": [640, 480], \"K\": [[979.75, 0, 313.64], [0, 979.75, 237.58], "
           "[0, 0, 1]], \"dist\": [0, 0, 0, 0, 0]}"),
      "json");
  ExpectTheCamera(Read("\xEF\xBB\xBFimage_width: 640\r\nimage_height: 480\r\n"
                       "K: [979.75, 0, 313.64, 0, 979.75, 237.58, 0, 0, 1]\r\n"),
                  "CR LF");
  for (const char* matrix : {"K: [0, 0, 0, 0, 0, 0, 0, 0, 0]",                // not calibrated
                             "K: [979, 0, 313, 0, 979, 237, 0, 0, 979]",      // scaled
                             "K: [979, 0, 313, 9, 979, 237, 0, 0, 1]",        // zero pattern
                             "K: [979, 0, 313, 0, 979, 237, 0, 0.1, 1]",      // last row
                             "K: [979, 0, 313, 0, 450, 237, 0, 0, 1]",        // fx / fy
                             "K: [-979, 0, 313, 0, -979, 237, 0, 0, 1]",      // mirrored
                             "K: [979, 50, 313, 0, 979, 237, 0, 0, 1]",       // skew
                             "K: [[979, 0, 0], [0, 979, 0], [313, 237, 1]]",  // transposed
                             "K: [979, 0, 313, 0, a, 237, 0, 0, 1]",
                             "K: [979, 0, 313, 0, .inf, 237, 0, 0, 1]",
                             "K: [979, 0, 313]",
                             "K: {}",
                             "fx: 979\ncx: 313",
                             "fx: x\nfy: 1\ncx: 1\ncy: 1"}) {
    const auto file = Read(WithMatrix(matrix));
    EXPECT_EQ(file.status().code(), absl::StatusCode::kInvalidArgument) << matrix;
  }
}

TEST_F(CameraFileTest, WhatFitsNoImageOfThisSizeIsRefused) {
  for (const char* matrix :
       {"K: [100, 0, 313, 0, 100, 237, 0, 0, 1]",
        "K: [30000, 0, 313, 0, 30000, 237, 0, 0, 1]",
        "K: [979, 0, 740, 0, 979, 237, 0, 0, 1]",
        "K: [979, 0, 313, 0, 979, -20, 0, 0, 1]",
        "K: [979, 0, 313, 0, 979, 237, 0, 0, 1]\nD: [-3, 0, 0, 0, 0]",
        "K: [979, 0, 313, 0, 979, 237, 0, 0, 1]\nD: [0, 0, 0, 0, 0, 20, 0, 0]"}) {
    const auto file = Read(WithMatrix(matrix));
    ASSERT_TRUE(file.ok()) << matrix << file.status();
    EXPECT_EQ(ForImages(*file, 640, 480).status().code(), absl::StatusCode::kInvalidArgument)
        << matrix;
  }
  const auto outside = Read(WithMatrix("K: [979, 0, 740, 0, 979, 237, 0, 0, 1]"));
  EXPECT_TRUE(ForImages(*outside, 640, 480, true).ok());
  EXPECT_THAT(ForImages(*outside, 640, 480).status().message(), HasSubstr("--cropped"));
}

TEST_F(CameraFileTest, ModelsOfLenses) {
  const std::string K = "K: [979.75, 0, 313.64, 0, 979.75, 237.58, 0, 0, 1]\n";
  for (const char* model : {"none", "Brown Conrady", "kannala_brandt_6", "thin_prism", "x"})
    ExpectTheCamera(Read(WithMatrix(K + "distortion_model: " + model + "\nD: [0, 0, 0, 0, 0]")),
                    model);
  // An equidistant lens without coefficients is no pinhole.
  const auto bare = Read(WithMatrix(K + "distortion_model: equidistant\nD: [0, 0, 0, 0]"));
  ASSERT_TRUE(bare.ok() && bare->lens) << bare.status();
  EXPECT_TRUE(bare->lens->fisheye);
  EXPECT_THAT(Read(WithMatrix(K + "distortion_model: omni\nD: [0.1, 0, 0, 0]")).status().message(),
              AllOf(HasSubstr("distortion_model"), HasSubstr("equidistant")));
  EXPECT_FALSE(Read("cam0:\n  camera_model: omni\n  intrinsics: [0.8, 900, 900, 320, 240]\n").ok());
  EXPECT_FALSE(Read("cam0:\n  camera_model: ds\n  intrinsics: [900, 900, 320, 240]\n").ok());
  const auto thin = Read(WithMatrix(K + "D: [0.1, 0, 0, 0, 0, 0, 0, 0, 0.05, 0, 0, 0]"));
  EXPECT_THAT(thin.status().message(), HasSubstr("thin prism"));
  const auto thinner = Read(WithMatrix(K + "D: [0.1, 0, 0, 0, 0, 0, 0, 0, 0.0005, 0, 0, 0, 0, 0]"));
  ASSERT_TRUE(thinner.ok()) << thinner.status();
  EXPECT_THAT(thinner->warnings, ElementsAre(HasSubstr("not used")));
}

TEST_F(CameraFileTest, ASizeIsThatOfAllOfTheRegionOrOfThemBinned) {
  const std::string text =
      "width: 2560\nheight: 1920\nk: [1960, 0, 1268, 0, 1960, 956, 0, 0, 1]\n"
      "binning_x: 2\nbinning_y: 2\nroi: {x_offset: 640, y_offset: 480, width: 1200, height: 900}\n";
  const auto file = Read(text);
  ASSERT_TRUE(file.ok()) << file.status();
  const auto expect = [&](int w, int h, double f, double cx) {
    const auto camera = ForImages(*file, w, h);
    ASSERT_TRUE(camera.ok()) << w << camera.status();
    EXPECT_DOUBLE_EQ(camera->focal_px, f);
    EXPECT_DOUBLE_EQ(camera->cx, cx);
    EXPECT_THAT(camera->warnings, IsEmpty());
  };
  expect(600, 450, 980.0, (1268.0 - 640.0 + 0.5) / 2 - 0.5);
  expect(1200, 900, 1960.0, 628.0);
  expect(1280, 960, 980.0, 1268.5 / 2 - 0.5);
  expect(2560, 1920, 1960.0, 1268.0);
  EXPECT_THAT(ForImages(*file, 640, 480).status().message(), HasSubstr("binning of 2 x 2"));
  const auto described = ForDescribedImages(*file);
  ASSERT_TRUE(described.ok());
  EXPECT_EQ(described->width, 600);
  EXPECT_EQ(described->height, 450);
  // All of it binned is as large as the region: which of them nobody knows.
  const auto either = Read(Replaced(Replaced(text, "1200", "1280"), "900", "960"));
  EXPECT_THAT(ForImages(*either, 1280, 960).status().message(), HasSubstr("both"));
  EXPECT_TRUE(ForImages(*either, 640, 480).ok());
  // Another binning along x than along y: pixels are not square.
  const auto oblong = Read(Replaced(text, "binning_x: 2", "binning_x: 1"));
  EXPECT_EQ(ForImages(*oblong, 1200, 450)->lens->fx, 1960.0);
  EXPECT_EQ(ForImages(*oblong, 1200, 450)->lens->fy, 980.0);
  EXPECT_FALSE(Read(Replaced(text, "width: 1200", "width: 2000")).ok());
  EXPECT_FALSE(Read(Replaced(text, "x_offset: 640", "x_offset: -1")).ok());
  // Neither region nor binning: 0 means none.
  const auto none = Read(
      "width: 640\nheight: 480\nk: [980, 0, 320, 0, 980, 240, 0, 0, 1]\nbinning_x: 0\n"
      "binning_y: 0\nroi: {x_offset: 0, y_offset: 0, width: 0, height: 0}\n");
  EXPECT_THAT(ForImages(*none, 320, 240)->warnings, ElementsAre(HasSubstr("scaled")));
}

TEST_F(CameraFileTest, LinesOfColmap) {
  const auto camera = [&](const std::string& line) {
    return Read("# Camera list\n" + line + "\n");
  };
  const auto radial = camera("3 SIMPLE_RADIAL 640 480 979.75 314.14 238.08 -0.1");
  ASSERT_TRUE(radial.ok()) << radial.status();
  EXPECT_EQ(radial->k1, -0.1);
  EXPECT_NEAR(radial->cx, 313.64, 1e-9);
  const auto full = camera(
      "1 FULL_OPENCV 640 480 979.75 979.75 314.14 238.08 0.31 -0.15 0.0002 0.0001 0.01 0.33 -0.16 "
      "0.012");
  ASSERT_TRUE(full.ok() && full->lens) << full.status();
  EXPECT_THAT(full->lens->denominator, ElementsAre(0.33, -0.16, 0.012));
  EXPECT_TRUE(camera("1 OPENCV_FISHEYE 640 480 400 400 320 240 0.1 0 0 0")->lens->fisheye);
  EXPECT_THAT(camera("1 FOV 640 480 400 400 320 240 0.1").status().message(), HasSubstr("FOV"));
  EXPECT_FALSE(camera("1 PINHOLE 640 480 400 320 240").ok());
  EXPECT_FALSE(camera("1 PINHOLE 640 480 400 x 320 240").ok());
  EXPECT_THAT(Read("1 PINHOLE 640 480 400 400 320 240\n2 PINHOLE 640 480 500 500 320 240\n")
                  .status()
                  .message(),
              HasSubstr("1, 2"));
}

TEST_F(CameraFileTest, HostileFilesAreRefused) {
  for (const std::string& text : {std::string(100000, '['),
                                  std::string("<opencv_storage>"),
                                  std::string("<a><b></a></b>"),
                                  std::string("<?xml version=\"1.0\"?>\n<kml></kml>"),
                                  std::string("K: &a [*a, *a]"),
                                  std::string("\0\0\0\0", 4),
                                  std::string("K: !!binary x"),
                                  std::string("PK\x03\x04") + "abc",
                                  std::string("? [1, 2]\n: K\n"),
                                  std::string(1 << 20, '{')}) {
    EXPECT_EQ(Read(text).status().code(), absl::StatusCode::kInvalidArgument) << text.substr(0, 40);
  }
  EXPECT_TRUE(absl::IsNotFound(ReadCameraFile(folder_.path()).status()));
}

}  // namespace
}  // namespace horopter
