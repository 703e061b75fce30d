#include "server/vision/recognition/aspect_scenes/surface_agreement.h"

#include <gtest/gtest.h>

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <numbers>
#include <optional>

namespace horopter {
namespace {

constexpr int kWidth = 320, kHeight = 240;
constexpr double kHalfM = 0.03;  // of a square plate on the plane z = 0, faces up

// Brightness of a place of the plane: no two places near each other have the same surroundings.
double Texture(const Eigen::Vector3d& x) {
  return 128 + 50 * std::sin(900 * x.x() + 3 * std::sin(310 * x.y())) +
         50 * std::cos(740 * x.y() + 2 * std::sin(450 * x.x()));
}

PinholeCamera Camera() {
  return CenteredCamera(kWidth, kHeight, 400.0);
}

// Looks at the origin from 0.35 m, `turn_rad` around the plane's normal.
Rigid3 From(double turn_rad, double tilt_rad = 0.5) {
  const Eigen::Matrix3d R =
      (Eigen::AngleAxisd(std::numbers::pi - tilt_rad, Eigen::Vector3d::UnitX()) *
       Eigen::AngleAxisd(turn_rad, Eigen::Vector3d::UnitZ()))
          .toRotationMatrix();
  return {R, Eigen::Vector3d(0, 0, 0.35)};
}

std::optional<Eigen::Vector3d> OnPlane(const Rigid3& camera_from_scene, int x, int y) {
  const Rigid3 back = camera_from_scene.Inverse();
  const Eigen::Vector3d ray =
      back.R * NormalizedPoint(Camera(), Eigen::Vector2d(x, y)).homogeneous();
  const double depth = -back.t.z() / ray.z();
  if (!(depth > 0)) return std::nullopt;
  return back.t + depth * ray;
}

struct Seen {
  std::vector<AspectImage> images;
  std::vector<std::optional<AspectSceneView>> views;
  std::vector<ObjectLayer> layers;
};

// Images from the true places, views and layers as the stated ones say.
Seen See(const std::vector<double>& turns, const std::vector<double>& stated) {
  Seen out;
  for (std::size_t v = 0; v < turns.size(); ++v) {
    AspectImage& image = out.images.emplace_back();
    image.width = image.image_width = kWidth;
    image.height = image.image_height = kHeight;
    ObjectLayer& layer = out.layers.emplace_back();
    layer.width = kWidth;
    layer.height = kHeight;
    layer.inverse_depth.assign(kWidth * kHeight, 0.0f);
    for (int y = 0; y < kHeight; ++y) {
      for (int x = 0; x < kWidth; ++x) {
        const auto at = OnPlane(From(turns[v]), x, y);
        // Exposure differs between the views.
        const double grey = at ? (0.7 + 0.1 * static_cast<double>(v)) * Texture(*at) : 0.0;
        image.grey.push_back(static_cast<std::uint8_t>(grey));
        const auto told = OnPlane(From(stated[v]), x, y);
        if (told && std::max(std::abs(told->x()), std::abs(told->y())) < kHalfM)
          layer.inverse_depth[layer.Cell(x, y)] =
              static_cast<float>(1.0 / (From(stated[v]) * *told).z());
      }
    }
    image.detail = image.grey;
    out.views.push_back(AspectSceneView{Camera(), From(stated[v])});
  }
  return out;
}

TEST(SurfaceAgreement, RightViewsAgreeOnTheSurface) {
  const Seen seen = See({0.0, 0.4, 0.9}, {0.0, 0.4, 0.9});
  const Correlations surface = SurfaceCorrelations(seen.images, seen.views, seen.layers);
  EXPECT_EQ(surface.pairs, 6);
  EXPECT_GT(surface.mean, 0.9);
}

// A square plate looks the same after a quarter turn; what is on it does not.
TEST(SurfaceAgreement, ATurnThatTheOutlineDoesNotShowIsSeenOnTheSurface) {
  const Seen seen = See({0.0, 0.4, 0.9, 1.2}, {0.0, 0.4, 0.9 + std::numbers::pi / 2, 1.2});
  const Correlations surface = SurfaceCorrelations(seen.images, seen.views, seen.layers);
  const ViewAgreement agreement{surface};
  for (int v = 0; v < 4; ++v) EXPECT_EQ(agreement.IsOdd(v), v == 2) << *surface.views[v];
}

TEST(SurfaceAgreement, APlainSurfaceSaysNothing) {
  Seen seen = See({0.0, 0.4}, {0.0, 0.4});
  for (AspectImage& image : seen.images) image.grey.assign(image.grey.size(), 90);
  const Correlations surface = SurfaceCorrelations(seen.images, seen.views, seen.layers);
  EXPECT_EQ(surface.pairs, 0);
  EXPECT_FALSE((ViewAgreement{surface}.Contradicts(0.4)));
}

TEST(SurfaceAgreement, TheGroundAgreesOnlyWhereThePlaneIsAndForRightCameras) {
  const Seen seen = See({0.0, 0.4, 0.9}, {0.0, 0.4, 0.9});
  const auto ground = [](const Seen& s, double height_m) {
    SupportingPlane plane;
    plane.offset_m = height_m;
    return PlaneCorrelations(s.images, s.views, s.layers, plane).mean;
  };
  EXPECT_GT(ground(seen, 0.0), 0.9);
  EXPECT_LT(ground(seen, -0.02), 0.3);
  EXPECT_LT(ground(See({0.0, 0.4, 0.9}, {0.0, 0.5, 0.8}), 0.0), 0.4);
}

TEST(SurfaceAgreement, TextureIsWhatTheLeastTexturedViewHasAroundThePart) {
  Seen seen = See({0.0, 0.4, 0.9}, {0.0, 0.4, 0.9});
  // Two waves of amplitude 50 in the darkest image: 0.7 * 50 * (1/2 + 1/2)^(1/2).
  EXPECT_NEAR(TextureAround(seen.images, seen.views, seen.layers), 35.0, 8.0);
  seen.images[1].detail.assign(seen.images[1].detail.size(), 128);
  EXPECT_EQ(TextureAround(seen.images, seen.views, seen.layers), 0.0);
  seen.views[1].reset();
  EXPECT_GT(TextureAround(seen.images, seen.views, seen.layers), 25.0);
  seen.views.assign(3, std::nullopt);
  EXPECT_EQ(TextureAround(seen.images, seen.views, seen.layers), 0.0);
}

TEST(SurfaceAgreement, TheFaceAPartRestsOnGivesTheGround) {
  const Seen seen = See({0.0, 0.4, 0.9}, {0.0, 0.4, 0.9});
  const std::vector<RestingFace> faces = {{Eigen::Vector3d::UnitX(), -0.03},
                                          {Eigen::Vector3d::UnitZ(), 0.0}};
  EXPECT_GT(GroundAgreement(seen.images, seen.views, seen.layers, faces, {}), 0.85);
  // Above the cameras.
  const std::vector<RestingFace> below = {{-Eigen::Vector3d::UnitZ(), 0.0}};
  EXPECT_EQ(GroundAgreement(seen.images, seen.views, seen.layers, below, {}), 0.0);
  EXPECT_EQ(GroundAgreement(seen.images, seen.views, seen.layers, {}, {}), 0.0);
}

TEST(SurfaceAgreement, WhatANearerPartHidesIsLeftOut) {
  ObjectLayer layer, nearer, farther;
  for (ObjectLayer* l : {&layer, &nearer, &farther}) l->width = l->height = 4;
  nearer.x0 = nearer.y0 = 2;
  farther.x0 = -2;
  layer.inverse_depth.assign(16, 2.0f);
  nearer.inverse_depth.assign(16, 2.5f);
  farther.inverse_depth.assign(16, 1.5f);
  HideBehind(farther, &layer);
  EXPECT_EQ(std::count(layer.inverse_depth.begin(), layer.inverse_depth.end(), 2.0f), 16);
  HideBehind(nearer, &layer);
  EXPECT_EQ(std::count(layer.inverse_depth.begin(), layer.inverse_depth.end(), 0.0f), 4);
  EXPECT_EQ(layer.inverse_depth[layer.Cell(3, 3)], 0.0f);
  EXPECT_EQ(layer.inverse_depth[layer.Cell(1, 3)], 2.0f);
  HideBehind({}, &layer);  // not shown
  EXPECT_EQ(std::count(layer.inverse_depth.begin(), layer.inverse_depth.end(), 0.0f), 4);
}

TEST(SurfaceAgreement, ViewsWithoutACameraAreLeftOut) {
  Seen seen = See({0.0, 0.4, 0.9}, {0.0, 0.4, 0.9});
  seen.views[1].reset();
  seen.layers[1] = {};
  const Correlations surface = SurfaceCorrelations(seen.images, seen.views, seen.layers);
  EXPECT_EQ(surface.pairs, 2);
  EXPECT_FALSE(surface.views[1].has_value());
  seen.views[2].reset();
  EXPECT_EQ(SurfaceCorrelations(seen.images, seen.views, seen.layers).pairs, 0);
}

}  // namespace
}  // namespace horopter
