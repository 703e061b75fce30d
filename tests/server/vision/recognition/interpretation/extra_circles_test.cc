// Circles painted on a plate's faces, seen in three views.
#include "server/vision/recognition/interpretation/extra_circles.h"

#include <gtest/gtest.h>

#include <cmath>
#include <numbers>
#include <opencv2/imgproc.hpp>

#include "tests/support/shaded_photo.h"
#include "tests/support/solid_meshes.h"
#include "tests/support/synthetic_part.h"

namespace horopter {
namespace {

constexpr double kTop = 0.01;

struct Disc {
  Eigen::Vector3d center;
  double radius = 0.0;
};

class ExtraCircles : public testing::Test {
 protected:
  ExtraCircles() : body_(BoxMesh({0.05, 0.03, kTop})) { mesh_ = MakeRenderMesh(body_).value(); }

  // Three views; the discs are painted in the first `painted` of them.
  std::vector<ExtraCircle> See(const std::vector<Disc>& discs, int painted = 3) {
    std::vector<AspectImage> images;
    std::vector<std::optional<CalibratedCamera>> views;
    for (int v = 0; v < 3; ++v) {
      const double a = 0.4 + 0.6 * v;
      const PinholeCamera camera = CenteredCamera(640, 480, 800);
      const Rigid3 camera_from_scene =
          LookAt({0.22 * std::sin(a), -0.22 * std::cos(a), 0.25}, {0.0, 0.0, 0.0});
      cv::Mat photo = ShadedPhoto({{&body_, camera_from_scene}}, camera);
      for (const Disc& disc : discs) {
        if (v < painted) Paint(disc, camera, camera_from_scene, &photo);
      }
      images.push_back(MakeAspectImage(photo));
      views.push_back(CalibratedCamera{camera, camera_from_scene});
    }
    const std::vector<VisibleEdges> edges = EdgesInViews(images, views, mesh_, Rigid3());
    return FindExtraCircles(images, views, {mesh_, pose_, edges}, hidden_);
  }

  TriangleMesh body_;
  RenderMesh mesh_;
  const Rigid3 pose_;
  std::vector<DepthBuffer> hidden_;

 private:
  static void Paint(const Disc& disc,
                    const PinholeCamera& camera,
                    const Rigid3& pose,
                    cv::Mat* photo) {
    constexpr int kBits = 6;
    std::vector<cv::Point> outline;
    for (int i = 0; i < 90; ++i) {
      const double a = 2.0 * std::numbers::pi * i / 90;
      const Eigen::Vector2d p = Project(
          camera,
          pose * Eigen::Vector3d(disc.center +
                                 disc.radius * Eigen::Vector3d(std::cos(a), std::sin(a), 0.0)));
      outline.emplace_back(static_cast<int>(std::lround(p.x() * (1 << kBits))),
                           static_cast<int>(std::lround(p.y() * (1 << kBits))));
    }
    cv::fillPoly(*photo,
                 std::vector<std::vector<cv::Point>>{outline},
                 cv::Scalar(40, 40, 40),
                 cv::LINE_AA,
                 kBits);
  }
};

TEST_F(ExtraCircles, AreFoundWhereTheyAreWithTheirSize) {
  for (const double radius : {0.005, 0.01, 0.015}) {
    SCOPED_TRACE(radius);
    const Eigen::Vector3d center(0.02, -0.004, kTop);
    const std::vector<ExtraCircle> found = See({{center, radius}});
    ASSERT_EQ(found.size(), 1u);
    EXPECT_EQ(found[0].views, 3);
    EXPECT_LT((found[0].place - center).norm(), 0.001);
    EXPECT_NEAR(found[0].radius_m, radius, 0.1 * radius);
  }
}

TEST_F(ExtraCircles, TwoViewsAreEnoughAndOneIsNot) {
  const std::vector<Disc> discs = {{{0.0, 0.0, kTop}, 0.01}};
  const auto found = See(discs, 2);
  ASSERT_EQ(found.size(), 1u);
  EXPECT_EQ(found[0].views, 2);
  EXPECT_TRUE(See(discs, 1).empty());
}

TEST_F(ExtraCircles, SeveralAreToldApart) {
  EXPECT_EQ(See({{{0.025, 0.0, kTop}, 0.01}, {{-0.025, 0.005, kTop}, 0.007}}).size(), 2u);
}

TEST_F(ExtraCircles, NoneOfAPlainPart) {
  EXPECT_TRUE(See({}).empty());
}

TEST_F(ExtraCircles, WhatIsNotOnAFaceIsNone) {
  EXPECT_TRUE(See({{{0.08, 0.05, -kTop}, 0.01}}).empty());      // on the table
  EXPECT_TRUE(See({{{0.05, 0.0, kTop}, 0.012}}).empty());       // half over the border
  EXPECT_TRUE(See({{{0.0, 0.0, kTop + 0.03}, 0.01}}).empty());  // above: elsewhere in each view
}

TEST_F(ExtraCircles, WhatThePartItselfHasIsNone) {
  Append(CylinderMesh(0.01, 0.004, 64), {0.0, 0.0, kTop + 0.004}, &body_);
  mesh_ = MakeRenderMesh(body_).value();
  EXPECT_TRUE(See({}).empty());
}

TEST_F(ExtraCircles, WhatStandsBehindSomethingElseIsNone) {
  const std::vector<Disc> discs = {{{0.0, 0.0, kTop}, 0.01}};
  for (int v = 0; v < 3; ++v) {
    hidden_.push_back(MakeDepthBuffer(640, 480));
    std::fill(hidden_.back().depth.begin(), hidden_.back().depth.end(), 0.05f);
  }
  EXPECT_TRUE(See(discs).empty());
}

}  // namespace
}  // namespace horopter
