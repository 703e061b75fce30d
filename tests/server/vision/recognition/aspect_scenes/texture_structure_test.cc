#include "server/vision/recognition/aspect_scenes/texture_structure.h"

#include <gtest/gtest.h>

#include <Eigen/Geometry>
#include <algorithm>
#include <numbers>

namespace horopter {
namespace {

constexpr int kWidth = 320, kHeight = 240;
constexpr double kHalfM = 0.05;  // of a square plate on the plane z = 0, the part

PinholeCamera Camera() {
  return CenteredCamera(kWidth, kHeight, 400.0);
}

// Looks at the origin from 0.35 m, `turn_rad` around the plane's normal.
Rigid3 From(double turn_rad) {
  const Eigen::Matrix3d R = (Eigen::AngleAxisd(std::numbers::pi - 0.5, Eigen::Vector3d::UnitX()) *
                             Eigen::AngleAxisd(turn_rad, Eigen::Vector3d::UnitZ()))
                                .toRotationMatrix();
  return {R, Eigen::Vector3d(0, 0, 0.35)};
}

class TextureStructure : public testing::Test {
 protected:
  TextureStructure() {
    for (const double turn : {0.0, 0.5, 1.0}) {
      AspectImage& image = images_.emplace_back();
      image.width = image.image_width = kWidth;
      image.height = image.image_height = kHeight;
      views_.emplace_back(AspectSceneView{Camera(), From(turn)});
      layers_.push_back(Plate(From(turn)));
    }
  }

  static ObjectLayer Plate(const Rigid3& camera_from_scene) {
    ObjectLayer layer;
    layer.width = kWidth;
    layer.height = kHeight;
    layer.inverse_depth.assign(kWidth * kHeight, 0.0f);
    const Rigid3 back = camera_from_scene.Inverse();
    for (int y = 0; y < kHeight; ++y) {
      for (int x = 0; x < kWidth; ++x) {
        const Eigen::Vector3d ray =
            back.R * NormalizedPoint(Camera(), Eigen::Vector2d(x, y)).homogeneous();
        const double depth = -back.t.z() / ray.z();
        const Eigen::Vector3d at = back.t + depth * ray;
        if (std::max(std::abs(at.x()), std::abs(at.y())) < kHalfM)
          layer.inverse_depth[layer.Cell(x, y)] = static_cast<float>(1.0 / depth);
      }
    }
    return layer;
  }

  // Points over a square at a height, seen by all views.
  void AddPoints(double height_m, double half_m) {
    for (int k = 0; k < 36; ++k) {
      const Eigen::Vector3d x(half_m * (k % 6 - 2.5) / 2.5, half_m * (k / 6 - 2.5) / 2.5, height_m);
      ReconstructedPoint& point = points_.emplace_back();
      for (int v = 0; v < 3; ++v) {
        point.observations.emplace_back(v, -1);
        point.pixels.push_back(Project(Camera(), views_[v]->camera_from_scene * x));
      }
    }
  }

  TextureOnPart Compare() const { return CompareTexture(images_, views_, layers_, points_); }

  std::vector<AspectImage> images_;
  std::vector<std::optional<AspectSceneView>> views_;
  std::vector<ObjectLayer> layers_;
  std::vector<ReconstructedPoint> points_;
};

TEST_F(TextureStructure, PointsOnItsFacesSpeakForAPart) {
  AddPoints(0.0, 0.03);
  const TextureOnPart t = Compare();
  EXPECT_EQ(t.on_faces, 36);
  EXPECT_EQ(t.behind, 0);
  EXPECT_FALSE(t.Contradicts());
}

TEST_F(TextureStructure, PointsBehindItsFacesContradictIt) {
  AddPoints(-0.03, 0.02);
  const TextureOnPart t = Compare();
  EXPECT_EQ(t.on_faces, 0);
  EXPECT_EQ(t.behind, 36);
  EXPECT_TRUE(t.Contradicts());
  // What is on it as well weighs against them.
  AddPoints(0.0, 0.03);
  EXPECT_FALSE(Compare().Contradicts());
}

TEST_F(TextureStructure, WhatLiesBeforeThePartOrBesideItSaysNothing) {
  AddPoints(0.03, 0.02);
  AddPoints(0.0, 0.2);
  points_.erase(std::remove_if(points_.begin() + 36,
                               points_.end(),
                               [](const ReconstructedPoint& p) {
                                 return (p.pixels[0] - Eigen::Vector2d(160, 120)).norm() < 90;
                               }),
                points_.end());
  const TextureOnPart t = Compare();
  EXPECT_EQ(t.on_faces, 0);
  EXPECT_EQ(t.behind, 0);
}

TEST_F(TextureStructure, WrongMatchesAndViewsWithoutParallaxSayNothing) {
  AddPoints(-0.03, 0.02);
  const std::vector<ReconstructedPoint> right = points_;
  // Off their epipolar lines, which are nearly level.
  for (ReconstructedPoint& point : points_) point.pixels[1].y() += 20.0;
  for (ReconstructedPoint& point : points_) point.pixels[2].y() -= 20.0;
  EXPECT_EQ(Compare().behind, 0);
  points_ = right;
  const auto apart = views_;
  for (auto& view : views_) view->camera_from_scene = From(0.0);
  EXPECT_EQ(Compare().behind, 0);
  views_ = {apart[0], std::nullopt, std::nullopt};
  EXPECT_EQ(Compare().behind, 0);
}

TEST_F(TextureStructure, ThePlaneOfTextureIsThatOfItsPoints) {
  AddPoints(-0.02, 0.06);
  EXPECT_TRUE(PlanesOfTexture(views_, points_).empty());  // none is said to be on the plane
  for (ReconstructedPoint& point : points_) point.on_plane = true;
  for (int k = 0; k < 36; k += 12) points_[k].pixels[0] += Eigen::Vector2d(6.0, 4.0);
  const auto planes = PlanesOfTexture(views_, points_);
  ASSERT_EQ(planes.size(), 1u);
  EXPECT_LT((planes[0].normal - Eigen::Vector3d::UnitZ()).norm(), 1e-3);
  EXPECT_NEAR(planes[0].offset_m, -0.02, 1e-4);
  points_.resize(19);
  EXPECT_TRUE(PlanesOfTexture(views_, points_).empty());
}

TEST_F(TextureStructure, ABoardOnThePlaneIsAPlaneToLieOnAsWell) {
  AddPoints(-0.02, 0.06);
  for (ReconstructedPoint& point : points_) point.on_plane = true;
  AddPoints(0.03, 0.02);
  const auto planes = PlanesOfTexture(views_, points_);
  ASSERT_EQ(planes.size(), 2u);
  EXPECT_NEAR(planes[0].offset_m, -0.02, 1e-4);
  EXPECT_GT(planes[1].normal.z(), 0.999);
  EXPECT_NEAR(planes[1].offset_m, 0.03, 1e-3);
}

TEST_F(TextureStructure, AWallIsNoPlaneToLieOn) {
  AddPoints(-0.02, 0.06);
  for (ReconstructedPoint& point : points_) point.on_plane = true;
  for (int k = 0; k < 36; ++k) {  // upright, behind
    const Eigen::Vector3d x(0.02 * (k % 6 - 2.5), 0.07, 0.01 * (k / 6));
    ReconstructedPoint& point = points_.emplace_back();
    for (int v = 0; v < 3; ++v) {
      point.observations.emplace_back(v, -1);
      point.pixels.push_back(Project(Camera(), views_[v]->camera_from_scene * x));
    }
  }
  EXPECT_EQ(PlanesOfTexture(views_, points_).size(), 1u);
}

TEST_F(TextureStructure, APlaneBetweenTheCamerasIsNone) {
  AddPoints(0.0, 0.06);
  for (ReconstructedPoint& point : points_) point.on_plane = true;
  ASSERT_EQ(PlanesOfTexture(views_, points_).size(), 1u);
  // A fourth camera, which sees none of it, is on the other side.
  views_.emplace_back(AspectSceneView{Camera(), {Eigen::Matrix3d::Identity(), {0, 0, 0.35}}});
  EXPECT_TRUE(PlanesOfTexture(views_, points_).empty());
}

// A cube of 40 mm on the table z = 0, turned about an upright axis, or lowered into the table.
TEST_F(TextureStructure, APartIsNotInTheTableThatSurroundsIt) {
  RenderMesh cube;
  cube.diameter_m = 0.04 * std::sqrt(3.0);
  for (int i = 0; i < 8; ++i) {
    cube.vertices.emplace_back(
        i & 1 ? 0.02f : -0.02f, i & 2 ? 0.02f : -0.02f, i & 4 ? 0.04f : 0.0f);
  }
  cube.center = {0.0f, 0.0f, 0.02f};
  AddPoints(0.0, 0.06);
  for (ReconstructedPoint& point : points_) point.on_plane = true;
  const auto is_under = [&](double height_m) {
    Rigid3 pose{Eigen::AngleAxisd(0.4, Eigen::Vector3d::UnitZ()).toRotationMatrix(),
                {0.0, 0.0, height_m}};
    const auto texture = FirstPlaneOfTexture(views_, points_);
    return texture && IsUnderTexture(*texture, cube, pose);
  };
  for (const double height_m : {0.05, 0.0, -0.005}) EXPECT_FALSE(is_under(height_m)) << height_m;
  for (const double height_m : {-0.01, -0.03, -0.1}) EXPECT_TRUE(is_under(height_m)) << height_m;
  points_.resize(19);
  EXPECT_FALSE(is_under(-0.03));
  // At the edge of a table, wherever that runs.
  for (int turn = 0; turn < 8; ++turn) {
    points_.clear();
    for (const double half_m : {0.06, 0.05, 0.035}) AddPoints(0.0, half_m);
    const double angle = turn * std::numbers::pi / 8;
    std::erase_if(points_, [&](const ReconstructedPoint& point) {
      const Eigen::Vector3d ray = views_[0]->camera_from_scene.R.transpose() *
                                  NormalizedPoint(Camera(), point.pixels[0]).homogeneous();
      const Eigen::Vector3d eye = views_[0]->camera_from_scene.Inverse().t;
      const Eigen::Vector3d x = eye - eye.z() / ray.z() * ray;
      return std::cos(angle) * x.x() + std::sin(angle) * x.y() > 0.002;
    });
    for (ReconstructedPoint& point : points_) point.on_plane = true;
    ASSERT_GE(points_.size(), 20u);
    EXPECT_FALSE(is_under(-0.03)) << angle;
  }
  points_.clear();
  EXPECT_FALSE(is_under(-0.03));
}

}  // namespace
}  // namespace horopter
