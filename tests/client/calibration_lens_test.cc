#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "absl/strings/str_cat.h"
#include "client/camera_file.h"
#include "tests/client/temp_folder.h"

namespace horopter {
namespace {

using testing::ElementsAre;
using testing::HasSubstr;

class CalibrationTest : public testing::Test {
 protected:
  absl::StatusOr<CameraFile> Read(const std::string& text) {
    return ReadCameraFile(folder_.Write("camera.yaml", text));
  }
  TempFolder folder_;
};

constexpr char kMatrix[] = "K: [979.75, 0, 313.64, 0, 979.75, 237.58, 0, 0, 1]\n";

// A camera of 640 x 480 with these lines beside its matrix.
std::string WithSize(const std::string& more) {
  return absl::StrCat("image_width: 640\nimage_height: 480\n", kMatrix, more);
}

void ExpectNoLens(const absl::StatusOr<CameraFile>& file, const std::string& what) {
  ASSERT_TRUE(file.ok()) << what << file.status();
  EXPECT_FALSE(file->lens) << what;
  EXPECT_EQ(file->k1, 0.0) << what;
}

TEST_F(CalibrationTest, NoLensIsLeftOutWhateverItIsCalled) {
  for (const char* lens : {"distortion: {k1: -0.1, k2: 0.5, p1: 0.01, p2: 0, k3: 0}",
                           "dist: \"-0.1 0.5 0.01 0 0\"",
                           "dist: \"[-0.1, 0.5, 0.01, 0, 0]\"",
                           "radial_distortion: [-0.1, 0.5]\ntangential_distortion: [0.01, 0]",
                           "RadialDistortion: [-0.1, 0.5, 0]\nTangentialDistortion: [0.01, 0]",
                           "model: distortion.brown_conrady\ncoeffs: [-0.1, 0.5, 0.01, 0, 0]",
                           "distortion: Brown Conrady\nk1: -0.1\nk2: 0.5\np1: 0.01\np2: 0",
                           "k1: -0.1\nk2: 0.5\np1: 0.01"}) {
    const auto file = Read(WithSize(lens));
    ASSERT_TRUE(file.ok() && file->lens) << lens << file.status();
    EXPECT_THAT(file->lens->coefficients, ElementsAre(-0.1, 0.5, 0.01, 0.0, 0.0)) << lens;
  }
  const auto beside =
      Read("intrinsics: {fx: 979.75, fy: 979.75, cx: 313.64, cy: 237.58}\nk1: -0.1\nk2: 0.5\n");
  ASSERT_TRUE(beside.ok() && beside->lens) << beside.status();
  for (const char* lens : {"distorsion: [-0.1, 0.5, 0, 0, 0]",
                           "lens_distortion_values: {k1: -0.1}",
                           "distortion: {a: 1, b: 2}",
                           "dist: some words",
                           "model: inverse_brown_conrady\ncoeffs: [-0.1, 0.5, 0.01, 0, 0]",
                           "radial_distortion: [1, 2, 3, 4, 5, 6, 7]",
                           "tangential_distortion: [1, 2, 3]",
                           "dist: .nan"}) {
    const auto file = Read(WithSize(lens));
    EXPECT_EQ(file.status().code(), absl::StatusCode::kInvalidArgument) << lens;
    EXPECT_THAT(std::string(file.status().message()), testing::ContainsRegex("dist|model")) << lens;
  }
  for (const char* lens : {"dist: none", "dist: 0", "distortion: {}", "my_dist: [0, 0]"})
    ExpectNoLens(Read(WithSize(lens)), lens);
}

TEST_F(CalibrationTest, ASizeIsReadHoweverItIsWritten) {
  for (const char* size : {"image_size: [1280, 960]",
                           "image_size: {width: 1280, height: 960}",
                           "resolution: 1280x960",
                           "image_width: 1280.0\nimage_height: 960.0",
                           "w: 1280\nh: 960",
                           "img_width: 1280\nimg_height: 960"}) {
    const auto file = Read(std::string(kMatrix) + size + "\n");
    ASSERT_TRUE(file.ok()) << size << file.status();
    EXPECT_EQ(file->width, 1280) << size;
    EXPECT_EQ(file->height, 960) << size;
  }
  for (const char* size : {"image_size: [1280]",
                           "image_size: big",
                           "image_width: 640.5\nimage_height: 480",
                           "image_width: -1\nimage_height: 480",
                           "image_width: 1e30\nimage_height: 480",
                           "image_size: [.inf, 1]"}) {
    EXPECT_EQ(Read(std::string(kMatrix) + size + "\n").status().code(),
              absl::StatusCode::kInvalidArgument)
        << size;
  }
  EXPECT_THAT(Read(WithSize("roi: [10, 10, 320, 240]")).status().message(), HasSubstr("x_offset"));
}

TEST_F(CalibrationTest, HostileFilesAreRefusedAtOnce) {
  std::string deep = "<?xml version=\"1.0\"?><opencv_storage>";
  for (int i = 0; i < 200'000; ++i) deep += "<a>";
  EXPECT_THAT(Read(deep).status().message(), HasSubstr("Kalibr"));
  EXPECT_FALSE(Read(std::string(100'000, '[')).ok());
  EXPECT_FALSE(Read(std::string(100'000, '{')).ok());
  // Ten to the twelfth numbers by aliases.
  std::string aliases = "a0: &a0 [" + std::string(2'000, ' ');
  for (int i = 0; i < 1000; ++i) aliases += "0,";
  aliases += "0]\n";
  for (int level = 1; level < 4; ++level) {
    aliases += absl::StrCat("a", level, ": &a", level, " [");
    for (int i = 0; i < 1000; ++i) aliases += absl::StrCat("*a", level - 1, ",");
    aliases += "0]\n";
  }
  EXPECT_FALSE(Read(aliases + "K: *a3\n").ok());
  for (const std::string& text :
       {std::string("\0\0K", 3), std::string("a: [1, 2"), std::string("<a></b>")})
    EXPECT_THAT(Read(text).status().message(), HasSubstr("camera_info")) << text;
}

}  // namespace
}  // namespace horopter
