#include "server/overlay/scene_overlay.h"

#include <gtest/gtest.h>

#include <cmath>
#include <opencv2/core.hpp>
#include <string>

#include "client/cad_import.h"
#include "server/overlay/paint.h"
#include "tests/client/mesh_samples.h"
#include "tests/client/temp_folder.h"

namespace horopter {
namespace {

constexpr int kSide = 200;

ObjectModel BoxModel() {
  const TempFolder folder;
  return ImportCad(folder.Write("b.ply", AsPly(Box(40, 40, 40))))->model;
}

Drawing Blank() {
  return {kSide, kSide, {}, {}};
}

cv::Mat Painted(const Drawing& drawing) {
  cv::Mat image(drawing.height, drawing.width, CV_8UC3, cv::Scalar(0, 0, 0));
  Paint(drawing, &image);
  return image;
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
  const OverlayObject object{&model, camera_from_object, "", ObjectColor(0)};
  Drawing drawing = Blank();
  DrawWireframes(camera, std::span(&object, 1), &drawing);
  const cv::Mat image = Painted(drawing);
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
  const OverlayObject objects[] = {{&model, near, "", ObjectColor(0)},
                                   {&model, far, "", ObjectColor(1)}};
  Drawing alone = Blank(), both = Blank();
  DrawWireframes(camera, std::span(objects, 1), &alone);
  DrawWireframes(camera, std::span(objects, 2), &both);
  EXPECT_EQ(cv::countNonZero(cv::Mat(Painted(alone) != Painted(both)).reshape(1)), 0);
}

TEST(Overlay, ObjectsBehindOrFarOutsideTheCameraDoNoHarm) {
  const ObjectModel model = BoxModel();
  Drawing drawing = Blank();
  for (const double z : {-0.2, 0.0, 0.01, 1e-5}) {
    for (const double x : {0.0, 0.02, 50.0}) {
      Rigid3 pose;
      pose.t = {x, 0, z};
      const OverlayObject object{&model, pose, "part", ObjectColor(0)};
      DrawWireframes(CenteredCamera(kSide, kSide, 300), std::span(&object, 1), &drawing);
      DrawGripper(CenteredCamera(kSide, kSide, 300), pose, 0.04, 0.04, ObjectColor(1), &drawing);
      DrawSuctionCup(CenteredCamera(kSide, kSide, 300), pose, 0.02, 0.04, ObjectColor(1), &drawing);
      DrawGrid(CenteredCamera(kSide, kSide, 300),
               pose,
               {Eigen::Vector3d::UnitZ(), 0.0},
               Eigen::Vector3d::Zero(),
               0.01,
               8,
               &drawing);
    }
  }
  Painted(drawing);
}

TEST(Overlay, ASuctionCupIsItsRimAndItsApproach) {
  const PinholeCamera camera = CenteredCamera(kSide, kSide, 300);
  Rigid3 camera_from_gripper;
  camera_from_gripper.t = {0, 0, 0.3};
  Drawing drawing = Blank();
  DrawSuctionCup(camera, camera_from_gripper, 0.02, 0.04, ObjectColor(0), &drawing);
  ASSERT_EQ(drawing.strokes.size(), 2u);
  const Eigen::Vector2d centre(camera.cx, camera.cy);
  for (const Eigen::Vector2d& p : drawing.strokes[0].points) {
    EXPECT_NEAR((p - centre).norm(), 20.0, 1e-9);
  }
  EXPECT_TRUE(drawing.strokes[0].points.front().isApprox(drawing.strokes[0].points.back()));
  EXPECT_TRUE(drawing.strokes[1].points.front().isApprox(centre));
}

// A part without sharp edges is drawn by its outline.
TEST(Overlay, ABallIsACircle) {
  ObjectModel ball;
  ball.diameter_m = 0.04;
  constexpr int kRings = 24, kSectors = 48;
  for (int i = 0; i <= kRings; ++i) {
    for (int k = 0; k < kSectors; ++k) {
      const double up = M_PI * i / kRings, turn = 2 * M_PI * k / kSectors;
      ball.mesh.vertices.emplace_back(0.02 * std::sin(up) * std::cos(turn),
                                      0.02 * std::sin(up) * std::sin(turn),
                                      0.02 * std::cos(up));
    }
  }
  for (int i = 0; i < kRings; ++i) {
    for (int k = 0; k < kSectors; ++k) {
      const int a = i * kSectors + k, b = i * kSectors + (k + 1) % kSectors;
      ball.mesh.triangles.emplace_back(a, a + kSectors, b);
      ball.mesh.triangles.emplace_back(b, a + kSectors, b + kSectors);
    }
  }
  const PinholeCamera camera = CenteredCamera(kSide, kSide, 300);
  Rigid3 pose;
  pose.t = {0, 0, 0.15};
  const OverlayObject object{&ball, pose, "", ObjectColor(0)};
  Drawing drawing = Blank();
  DrawWireframes(camera, std::span(&object, 1), &drawing);
  ASSERT_GT(drawing.strokes.size(), 20u);
  const double radius = 300 * 0.02 / std::sqrt(0.15 * 0.15 - 0.02 * 0.02);
  for (const Stroke& stroke : drawing.strokes) {
    for (const Eigen::Vector2d& p : stroke.points) {
      EXPECT_NEAR((p - Eigen::Vector2d(camera.cx, camera.cy)).norm(), radius, 0.1 * radius);
    }
  }
}

// Every line of the grid lies on the plane: seen along the plane all are one line.
TEST(Overlay, AGridIsFlat) {
  Rigid3 pose;
  pose.t = {0, 0.0, 0.3};
  Drawing drawing = Blank();
  DrawGrid(CenteredCamera(kSide, kSide, 300),
           pose,
           {Eigen::Vector3d::UnitY(), 0.0},
           {0.01, 0.05, 0.0},
           0.01,
           6,
           &drawing);
  ASSERT_EQ(drawing.strokes.size(), 26u);
  for (const Stroke& stroke : drawing.strokes) {
    for (const Eigen::Vector2d& p : stroke.points) EXPECT_NEAR(p.y(), 0.5 * (kSide - 1), 1e-9);
  }
}

TEST(Overlay, NamesCannotBreakTheSvg) {
  Drawing drawing = Blank();
  drawing.labels.push_back({{10, 20}, "<script>\"&\x01", ObjectColor(0), 12.0});
  const std::string svg = ToSvg(drawing);
  EXPECT_EQ(svg.find("<script"), std::string::npos);
  EXPECT_NE(svg.find("&lt;script&gt;\"&amp; <"), std::string::npos);
}

// The same lines at the same places, whichever way they are shown.
TEST(Overlay, SvgHasThePointsOfTheDrawing) {
  Drawing drawing = Blank();
  drawing.strokes.push_back({{{0, 0}, {10.25, 20}}, {255, 0, 128}, 2.0});
  EXPECT_NE(
      ToSvg(drawing).find("stroke=\"#ff0080\" stroke-width=\"2.0\" points=\"0.5,0.5 10.8,20.5\""),
      std::string::npos)
      << ToSvg(drawing);
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
