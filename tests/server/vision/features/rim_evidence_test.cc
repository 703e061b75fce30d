#include "server/vision/features/rim_evidence.h"

#include <gtest/gtest.h>

#include <cmath>

#include "server/vision/features/arcs.h"
#include "tests/server/vision/features/rendered_shapes.h"

namespace horopter {
namespace {

EllipseArc Ellipse(double x, double y, double a, double b, double angle) {
  EllipseArc arc;
  arc.center = {x, y};
  arc.semi_major_px = a;
  arc.semi_minor_px = b;
  arc.angle_rad = angle;
  arc.sweep_rad = 2.0 * M_PI;
  return arc;
}

std::vector<GradientField> FieldOf(const cv::Mat& image) {
  GradientOptions options;
  options.colour = ColourGradient::kStrongestChannel;
  return MakeGradientFields(image, options);
}

double ParameterError(const EllipseArc& a, const EllipseArc& b) {
  return std::max({(a.center - b.center).norm(),
                   std::abs(a.semi_major_px - b.semi_major_px),
                   std::abs(a.semi_minor_px - b.semi_minor_px)});
}

TEST(FitRim, PullsARoughGuessOntoTheEdge) {
  for (double noise : {0.0, 4.0, 8.0}) {
    SCOPED_TRACE(noise);
    std::mt19937 rng(31);
    ShapeRenderOptions render;
    render.noise_sigma = noise;
    const EllipseArc truth = Ellipse(160.3, 118.6, 40.0, 24.0, 0.4);
    const auto fields =
        FieldOf(RenderPolygon(EllipsePolygon(truth.center, 40.0, 24.0, 0.4), render, &rng));
    const auto rim = FitRim(Ellipse(161.5, 117.5, 41.5, 23.0, 0.43), fields, RimOptions());
    ASSERT_TRUE(rim.has_value());
    EXPECT_LT(ParameterError(rim->arc, truth), 0.3);
    EXPECT_GT(rim->seen_share, 0.95);
    EXPECT_NEAR(rim->arc.sweep_rad, 2.0 * M_PI, 0.01);
  }
}

// Half of the rim is bright, half is hardly seen: what one chain gives is half an ellipse.
TEST(FitRim, FollowsTheFaintHalfOfARim) {
  std::mt19937 rng(32);
  ShapeRenderOptions render;
  const EllipseArc truth = Ellipse(160.0, 120.0, 36.0, 22.0, 0.3);
  render.noise_sigma = 0.0;
  const cv::Mat strong = RenderPolygon(EllipsePolygon(truth.center, 36, 22, 0.3), render, &rng);
  render.foreground = cv::Scalar(52, 52, 52);  // 8 grey levels darker than the face
  const cv::Mat weak = RenderPolygon(EllipsePolygon(truth.center, 36, 22, 0.3), render, &rng);
  cv::Mat image = strong.clone();
  weak(cv::Rect(160, 0, 160, 240)).copyTo(image(cv::Rect(160, 0, 160, 240)));
  const auto rim = FitRim(Ellipse(160.8, 120.5, 37, 22.5, 0.28), FieldOf(image), RimOptions());
  ASSERT_TRUE(rim.has_value());
  EXPECT_LT(ParameterError(rim->arc, truth), 0.5);
  EXPECT_GT(rim->arc.sweep_rad * rim->seen_share, 0.85 * 2.0 * M_PI);
}

TEST(FitRim, NothingToSeeGivesNothing) {
  const cv::Mat plain(240, 320, CV_8UC3, cv::Scalar(90, 90, 90));
  EXPECT_FALSE(FitRim(Ellipse(160, 120, 40, 24, 0.4), FieldOf(plain), RimOptions()).has_value());
  // Outside of the image.
  EXPECT_FALSE(FitRim(Ellipse(900, 900, 40, 24, 0.4), FieldOf(plain), RimOptions()).has_value());
}

TEST(MeasureRim, AnEdgeThatCrossesTheCurveIsNoneOfItsOwn) {
  std::mt19937 rng(33);
  // A vertical step through the middle of the circle.
  const cv::Mat image =
      RenderPolygon({{-50, -50}, {160, -50}, {160, 300}, {-50, 300}}, ShapeRenderOptions(), &rng);
  int seen = 0;
  const auto rim = MeasureRim(Ellipse(160, 120, 50, 50, 0.0), FieldOf(image), 2.0);
  for (const RimPoint& place : rim) seen += place.strength > 0.5 ? 1 : 0;
  EXPECT_EQ(seen, 0);
}

// Light and shade of a bore's wall meet in a line through the hole, and every chain leaves the rim
// there.
TEST(FindArcs, BoreOfTwoTonesIsOneEllipse) {
  int found = 0;
  constexpr int kTrials = 20;
  std::mt19937 rng(34);
  std::uniform_real_distribution<double> u(0.0, 1.0);
  for (int trial = 0; trial < kTrials; ++trial) {
    const double a = 16.0 + 20.0 * u(rng), b = a * (0.5 + 0.4 * u(rng)), angle = M_PI * u(rng);
    const Eigen::Vector2d center(150 + 20 * u(rng), 110 + 20 * u(rng));
    ShapeRenderOptions render;
    render.background = cv::Scalar(100, 110, 120);
    render.foreground = cv::Scalar(40, 45, 50);
    render.noise_sigma = 2.0;
    const cv::Mat dark = RenderPolygon(EllipsePolygon(center, a, b, angle), render, &rng);
    render.foreground = cv::Scalar(150, 165, 180);
    const cv::Mat light = RenderPolygon(EllipsePolygon(center, a, b, angle), render, &rng);
    cv::Mat image = dark.clone();
    const cv::Rect right(static_cast<int>(center.x()), 0, 320 - static_cast<int>(center.x()), 240);
    light(right).copyTo(image(right));
    const auto features = DetectFeatures(image, FeatureOptions());
    ASSERT_TRUE(features.ok());
    const EllipseArc truth = Ellipse(center.x(), center.y(), a, b, angle);
    for (const EllipseArc& arc : features->arcs) {
      if (ParameterError(arc, truth) < 1.0 && arc.sweep_rad > 5.0) {
        ++found;
        break;
      }
    }
  }
  EXPECT_GE(found, 0.85 * kTrials);
}

TEST(FindArcs, PolygonsHaveNone) {
  std::mt19937 rng(35);
  std::uniform_real_distribution<double> u(0.0, 1.0);
  int arcs = 0;
  for (int trial = 0; trial < 20; ++trial) {
    std::vector<Eigen::Vector2d> polygon;
    for (int k = 0; k < 5; ++k) {
      const double angle = 2.0 * M_PI * (k + 0.5 * u(rng)) / 5.0;
      polygon.emplace_back(160 + 90 * std::cos(angle), 120 + 90 * std::sin(angle));
    }
    ShapeRenderOptions render;
    render.noise_sigma = 3.0;
    const auto features = DetectFeatures(RenderPolygon(polygon, render, &rng), FeatureOptions());
    ASSERT_TRUE(features.ok());
    arcs += static_cast<int>(features->arcs.size());
  }
  EXPECT_LE(arcs, 1);
}

}  // namespace
}  // namespace horopter
