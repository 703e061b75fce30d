#include "server/service/exif.h"

#include <gtest/gtest.h>

#include <cmath>
#include <opencv2/core.hpp>
#include <opencv2/imgcodecs.hpp>
#include <random>
#include <string>
#include <vector>

#include "horopter/v1/recognition.pb.h"
#include "server/service/convert.h"
#include "server/service/exif_camera.h"
#include "tests/support/exif_file.h"

namespace horopter {
namespace {

// What a telephone writes: 4032 x 3024, 26 mm equivalent.
std::vector<ExifEntry> Telephone() {
  return {{0x0112, 3, 6, 1, false},
          {0x920a, 5, 425, 100, true},
          {0xa002, 4, 4032, 1, true},
          {0xa003, 4, 3024, 1, true},
          {0xa405, 3, 26, 1, true}};
}

ExifCamera CameraOf(const std::vector<ExifEntry>& entries, int width, int height) {
  return CameraFromExif(ReadExif(JpegWith(ExifBlock(entries, true))), width, height, false);
}

TEST(ReadExif, SaysWhatTheCameraWroteInEveryContainerAndByteOrder) {
  for (const bool little : {true, false}) {
    const std::string block = ExifBlock(Telephone(), little);
    for (const std::string& file : {JpegWith(block), PngWith(block), WebpWith(block), block}) {
      const Exif exif = ReadExif(file);
      EXPECT_EQ(exif.orientation, 6);
      EXPECT_EQ(exif.width_px, 4032);
      EXPECT_EQ(exif.height_px, 3024);
      EXPECT_EQ(exif.focal_35mm, 26.0);
      EXPECT_EQ(exif.focal_mm, 4.25);
      EXPECT_FALSE(exif.pixels_per_mm);
    }
  }
}

TEST(ReadExif, LeavesOutWhatCannotBeMeant) {
  const Exif exif = ReadExif(JpegWith(ExifBlock({{0x0112, 3, 77, 1, false},
                                                 {0x920a, 5, 425, 0, true},
                                                 {0xa002, 4, 4'000'000'000u, 1, true},
                                                 {0xa003, 4, 0, 1, true},
                                                 {0xa20e, 5, 0, 1, true},
                                                 {0xa404, 5, 0, 1, true},
                                                 {0xa405, 3, 0, 1, true}},
                                                true)));
  EXPECT_EQ(exif.orientation, 1);
  EXPECT_EQ(exif.width_px, 0);
  EXPECT_FALSE(exif.focal_mm || exif.focal_35mm || exif.pixels_per_mm || exif.digital_zoom);
}

// A directory that names itself, or one behind the file's end, ends the reading.
TEST(ReadExif, FollowsNothingTwice) {
  std::string block = ExifBlock(Telephone(), true);
  for (const char low : {'\x08', '\xff'}) {
    for (size_t i = 0; i + 12 <= block.size(); ++i) {
      if (block.substr(i, 4) != std::string("\x69\x87\x04\x00", 4)) continue;
      block[i + 8] = low;
      block[i + 11] = low == '\xff' ? '\xff' : '\0';
    }
    EXPECT_EQ(ReadExif(JpegWith(block)).orientation, 6);
    EXPECT_FALSE(ReadExif(JpegWith(block)).focal_35mm);
  }
}

// Any bytes are read to an end, within their borders: run under the address sanitizer.
TEST(ReadExif, TakesAnyBytes) {
  const std::string block = ExifBlock(Telephone(), true);
  std::mt19937 rng(7);
  for (const std::string& file : {JpegWith(block), PngWith(block), WebpWith(block), block}) {
    for (size_t size = 0; size <= file.size(); ++size) ReadExif(std::string(file, 0, size));
    for (int k = 0; k < 20'000; ++k) {
      std::string changed = file;
      for (int i = 0; i < 1 + k % 4; ++i)
        changed[rng() % changed.size()] = static_cast<char>(rng());
      const Exif exif = ReadExif(changed);
      EXPECT_TRUE(exif.orientation >= 1 && exif.orientation <= 8);
      const ExifCamera camera = CameraFromExif(exif, 640, 480, k % 2 == 0);
      if (!camera.focal_px) continue;
      EXPECT_TRUE(*camera.focal_px > 10.0 && *camera.focal_px < 1e6) << *camera.focal_px;
      EXPECT_TRUE(camera.focal_log_sigma >= 0.05 && camera.focal_log_sigma <= 0.2);
    }
  }
}

TEST(CameraFromExif, HoldsBothConventionsOfTheEquivalent) {
  const ExifCamera camera = CameraOf(Telephone(), 4032, 3024);
  ASSERT_TRUE(camera.focal_px);
  const double by_width = 26.0 / 36.0 * 4032.0, by_diagonal = 26.0 / 43.2666 * 5040.0;
  for (const double f : {by_width, by_diagonal})
    EXPECT_LT(std::abs(std::log(f / *camera.focal_px)), camera.focal_log_sigma);
  EXPECT_LT(camera.focal_log_sigma, 0.07);
  EXPECT_FALSE(camera.center_sigma_px);
  // A portrait says the same.
  EXPECT_NEAR(*CameraOf(Telephone(), 3024, 4032).focal_px, *camera.focal_px, 1e-9);
}

TEST(CameraFromExif, OfAScaledImageScales) {
  const ExifCamera whole = CameraOf(Telephone(), 4032, 3024),
                   small = CameraOf(Telephone(), 640, 480);
  EXPECT_NEAR(*small.focal_px / *whole.focal_px, 640.0 / 4032.0, 1e-9);
  EXPECT_NEAR(small.focal_log_sigma, whole.focal_log_sigma, 1e-12);
  EXPECT_FALSE(small.center_sigma_px);
}

TEST(CameraFromExif, ACutOutHasAWidePrincipalPointAndBothScales) {
  const ExifCamera whole = CameraOf(Telephone(), 4032, 3024),
                   cut = CameraOf(Telephone(), 3400, 2000);
  ASSERT_TRUE(cut.focal_px && cut.center_sigma_px);
  EXPECT_GT(*cut.center_sigma_px,
            250.0);  // a window of 3400 x 2000 in 4032 x 3024: up to 512 px off
  // Cut out as it was, or scaled first.
  EXPECT_LT(std::abs(std::log(*cut.focal_px / *whole.focal_px)), 2.0 * cut.focal_log_sigma);
  EXPECT_LT(std::abs(std::log(*cut.focal_px / (*whole.focal_px * 3400 / 4032))),
            2.0 * cut.focal_log_sigma);
  // Of a small cut-out nothing is left but that it is one.
  const ExifCamera small = CameraOf(Telephone(), 900, 500);
  EXPECT_FALSE(small.focal_px);
  EXPECT_TRUE(small.center_sigma_px);
  // One of the same shape looks as if it were scaled; who says that it is a cut-out is believed.
  const Exif exif = ReadExif(JpegWith(ExifBlock(Telephone(), true)));
  EXPECT_FALSE(CameraFromExif(exif, 1600, 1200, true).focal_px);
  EXPECT_TRUE(CameraFromExif(exif, 1600, 1200, false).focal_px);
}

TEST(CameraFromExif, TagsThatContradictEachOtherSayNothing) {
  auto entries = Telephone();
  // 4.25 mm at 1000 pixels a mm would be 4250 px, 26 mm equivalent are 2970.
  entries.push_back({0xa20e, 5, 1000, 1, true});
  entries.push_back({0xa210, 3, 4, 1, true});
  EXPECT_FALSE(CameraOf(entries, 4032, 3024).focal_px);
  entries[entries.size() - 2].value = 700;
  EXPECT_NEAR(*CameraOf(entries, 4032, 3024).focal_px, 4.25 * 700, 1e-6);
  // What nobody's lens has is as good as nothing said.
  entries[entries.size() - 2].value = 72;
  EXPECT_NEAR(
      *CameraOf(entries, 4032, 3024).focal_px, *CameraOf(Telephone(), 4032, 3024).focal_px, 1);
}

TEST(CameraFromExif, ADigitalZoomMakesItLessSure) {
  auto entries = Telephone();
  entries.push_back({0xa404, 5, 13, 10, true});
  const ExifCamera zoomed = CameraOf(entries, 4032, 3024),
                   whole = CameraOf(Telephone(), 4032, 3024);
  ASSERT_TRUE(zoomed.focal_px);
  EXPECT_GT(zoomed.focal_log_sigma, whole.focal_log_sigma);
  entries.back().value = 40;
  EXPECT_FALSE(CameraOf(entries, 4032, 3024).focal_px);
}

TEST(QuarterTurnsToUpright, AreThoseOfTheOrientationTag) {
  const auto turns = [](unsigned orientation) {
    return QuarterTurnsToUpright(
        ReadExif(JpegWith(ExifBlock({{0x0112, 3, orientation, 1, false}}, false))));
  };
  EXPECT_EQ(turns(1), 0);
  EXPECT_EQ(turns(6), 1);
  EXPECT_EQ(turns(3), 2);
  EXPECT_EQ(turns(8), 3);
  EXPECT_EQ(turns(7), 0);  // mirrored
}

// A request with one photograph of 640 x 480 that a telephone took larger.
v1::RecognizeSceneRequest Photograph() {
  std::vector<unsigned char> jpeg;
  cv::imencode(".jpg", cv::Mat(480, 640, CV_8UC1, cv::Scalar(90)), jpeg);
  std::string file(jpeg.begin(), jpeg.end());
  file.insert(2, ExifSegment(ExifBlock(Telephone(), true)));
  v1::RecognizeSceneRequest request;
  request.add_images()->set_content(file);
  return request;
}

std::vector<CameraHint> HintsOf(const v1::RecognizeSceneRequest& request) {
  const auto scene = SceneRequestFromProto(request, {}, 1, {});
  EXPECT_TRUE(scene.ok()) << scene.status();
  return scene.ok() ? scene->hints : std::vector<CameraHint>();
}

TEST(SceneRequestFromProto, PresumesWhatTheFileSaysWhereNobodySaysBetter) {
  v1::RecognizeSceneRequest request = Photograph();
  auto hints = HintsOf(request);
  ASSERT_EQ(hints.size(), 1u);
  EXPECT_TRUE(hints[0].presumed);
  EXPECT_NEAR(*hints[0].focal_px, 640 * 26.0 / 36.0 * 1.02, 10.0);

  request.mutable_images(0)->mutable_camera_hint()->set_k1(-0.05);
  EXPECT_TRUE(HintsOf(request)[0].presumed);
  EXPECT_EQ(HintsOf(request)[0].k1, -0.05);

  request.mutable_images(0)->mutable_camera_hint()->set_focal_px(900.0);
  hints = HintsOf(request);
  EXPECT_FALSE(hints[0].presumed);
  EXPECT_EQ(hints[0].focal_px, 900.0);
  EXPECT_FALSE(hints[0].focal_log_sigma);
}

TEST(SceneRequestFromProto, DoesNotReadExifWhenToldNotTo) {
  v1::RecognizeSceneRequest request = Photograph();
  request.set_ignore_exif(true);
  EXPECT_TRUE(HintsOf(request).empty());
  request = Photograph();
  request.set_station("stations/cell");
  EXPECT_TRUE(HintsOf(request).empty());
}

TEST(SceneRequestFromProto, ACutOutHasAWidePrincipalPointUnlessItIsGiven) {
  v1::RecognizeSceneRequest request = Photograph();
  request.mutable_images(0)->set_cropped(true);
  auto hints = HintsOf(request);
  ASSERT_EQ(hints.size(), 1u);
  EXPECT_FALSE(hints[0].focal_px);  // 640 of 4032 pixels: it may be of any part of them
  ASSERT_TRUE(hints[0].principal_point_sigma_px);
  EXPECT_GT(*hints[0].principal_point_sigma_px, 60.0);
  request.mutable_images(0)->mutable_camera_hint()->set_principal_point_x_px(300.0);
  request.mutable_images(0)->mutable_camera_hint()->set_principal_point_y_px(250.0);
  hints = HintsOf(request);
  EXPECT_FALSE(hints[0].principal_point_sigma_px);
  EXPECT_EQ(*hints[0].principal_point, Eigen::Vector2d(300.0, 250.0));
}

}  // namespace
}  // namespace horopter
