#include "client/overlay.h"

#include <gtest/gtest.h>

#include <opencv2/core.hpp>

#include "client/cad_import.h"
#include "tests/client/mesh_samples.h"
#include "tests/client/temp_folder.h"

namespace horopter {
namespace {

constexpr int kSide = 200;

ObjectModel BoxModel() {
  const TempFolder folder;
  return ImportCad(folder.Write("b.ply", AsPly(Box(40, 40, 40))))->model;
}

bool Drawn(const cv::Mat& image, double x, double y) {
  for (int v = static_cast<int>(y) - 1; v <= static_cast<int>(y) + 2; ++v) {
    for (int u = static_cast<int>(x) - 1; u <= static_cast<int>(x) + 2; ++u) {
      if (image.at<cv::Vec3b>(v, u) != cv::Vec3b(0, 0, 0)) return true;
    }
  }
  return false;
}

// The box is seen along its axis: its near face is drawn, its far face is hidden behind it.
TEST(Overlay, HiddenEdgesAreNotDrawn) {
  const ObjectModel model = BoxModel();
  const PinholeCamera camera = CenteredCamera(kSide, kSide, 300);
  Rigid3 camera_from_object;
  camera_from_object.t = {0, 0, 0.15};
  cv::Mat image(kSide, kSide, CV_8UC3, cv::Scalar(0, 0, 0));
  const OverlayObject object{&model, camera_from_object, "", 0};
  DrawOverlay(camera, std::span(&object, 1), &image);
  const double near = 300 * 0.02 / 0.15, far = 300 * 0.02 / 0.19;
  const double c = camera.cx;
  EXPECT_TRUE(Drawn(image, c + near, c + 10));
  EXPECT_TRUE(Drawn(image, c - 10, c - near));
  EXPECT_FALSE(Drawn(image, c + far, c + 10));
  EXPECT_FALSE(Drawn(image, c - 10, c - far));
}

TEST(Overlay, ANearerObjectHidesAFartherOne) {
  const ObjectModel model = BoxModel();
  const PinholeCamera camera = CenteredCamera(kSide, kSide, 300);
  Rigid3 near, far;
  near.t = {0, 0, 0.15};
  far.t = {0.01, 0, 0.40};
  cv::Mat alone(kSide, kSide, CV_8UC3, cv::Scalar(0, 0, 0)), both = alone.clone();
  const OverlayObject objects[] = {{&model, near, "", 0}, {&model, far, "", 1}};
  DrawOverlay(camera, std::span(objects, 1), &alone);
  DrawOverlay(camera, std::span(objects, 2), &both);
  EXPECT_EQ(cv::countNonZero(cv::Mat(alone != both).reshape(1)), 0);
}

TEST(Overlay, ObjectsBehindOrFarOutsideTheCameraDoNoHarm) {
  const ObjectModel model = BoxModel();
  cv::Mat image(kSide, kSide, CV_8UC3, cv::Scalar(0, 0, 0));
  for (const double z : {-0.2, 0.0, 0.01, 1e-5}) {
    for (const double x : {0.0, 0.02, 50.0}) {
      Rigid3 pose;
      pose.t = {x, 0, z};
      const OverlayObject object{&model, pose, "", 0};
      DrawOverlay(CenteredCamera(kSide, kSide, 300), std::span(&object, 1), &image);
    }
  }
}

TEST(Overlay, TilesKeepEveryImage) {
  for (int n = 1; n <= 7; ++n) {
    std::vector<cv::Mat> images;
    for (int i = 0; i < n; ++i) images.emplace_back(50, 80, CV_8UC3, cv::Scalar(0, 0, 100 + i));
    const cv::Mat tiled = Tile(images, 40);
    for (int i = 0; i < n; ++i) {
      cv::Mat mask;
      EXPECT_EQ(cv::countNonZero(cv::Mat(tiled == cv::Scalar(0, 0, 100 + i)).reshape(1)) > 0, true);
    }
  }
  EXPECT_TRUE(Tile({}, 40).empty());
}

}  // namespace
}  // namespace horopter
