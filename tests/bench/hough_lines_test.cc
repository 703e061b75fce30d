#include "tests/bench/hough_lines.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <limits>

#include "server/vision/features/edge_gradient.h"
#include "server/vision/features/edge_linking.h"
#include "tests/server/vision/features/rendered_shapes.h"
#include "tests/server/vision/features/synthetic_chains.h"

namespace horopter {
namespace {

EdgeChain WithGradients(const SyntheticChain& chain, double noise, std::mt19937* rng) {
  EdgeChain out;
  out.points = chain.Noisy(noise, rng);
  for (const Eigen::Vector2d& n : chain.normals) out.gradients.push_back(10.0f * n.cast<float>());
  return out;
}

HoughFeatures Detect(const std::vector<EdgeChain>& chains, const HoughOptions& options = {}) {
  const auto features = DetectHoughLines(chains, 320, 240, options);
  EXPECT_TRUE(features.ok()) << features.status();
  return features.value_or(HoughFeatures());
}

double NearestCorner(const Eigen::Vector2d& p, const std::vector<Eigen::Vector2d>& corners) {
  double nearest = 1e9;
  for (const Eigen::Vector2d& c : corners) nearest = std::min(nearest, (c - p).norm());
  return nearest;
}

TEST(DetectHoughLines, OneLineIsOneSegmentInEveryDirection) {
  std::mt19937 rng(61);
  for (int k = 0; k < 48; ++k) {
    SCOPED_TRACE(k);
    const double heading = 2 * M_PI * k / 48 + 0.01;
    const Eigen::Vector2d d(std::cos(heading), std::sin(heading));
    const Eigen::Vector2d start = Eigen::Vector2d(160, 120) - 50 * d;
    const auto features =
        Detect({WithGradients(ChainWalk(start, heading).Line(100).chain(), 0.1, &rng)});
    ASSERT_EQ(features.segments.size(), 1u);
    const Segment& s = features.segments[0];
    EXPECT_NEAR(s.Length(), 99.0, 1.0);
    EXPECT_GT((s.end - s.start).normalized().dot(d), 0.9999);  // bright side on the right
    EXPECT_LT(std::abs(d.x() * (s.start - start).y() - d.y() * (s.start - start).x()), 0.2);
    EXPECT_NEAR(s.contrast, 10.0, 1e-3);
    EXPECT_TRUE(features.vertices.empty());
  }
}

TEST(DetectHoughLines, GapsCutAndOppositeEdgesStayApart) {
  std::mt19937 rng(62);
  const auto a = WithGradients(ChainWalk({40, 100}, 0.0).Line(80).chain(), 0.05, &rng);
  const auto b = WithGradients(ChainWalk({140, 100}, 0.0).Line(80).chain(), 0.05, &rng);
  EXPECT_EQ(Detect({a, b}).segments.size(), 2u);
  const auto back = WithGradients(ChainWalk({120, 102}, M_PI).Line(80).chain(), 0.05, &rng);
  const auto bar = Detect({a, back});
  ASSERT_EQ(bar.segments.size(), 2u);
  EXPECT_NEAR(std::abs(bar.segments[0].start.y() - bar.segments[1].start.y()), 2.0, 0.1);
  EXPECT_TRUE(bar.vertices.empty());
}

class HoughNoise : public testing::TestWithParam<double> {};

TEST_P(HoughNoise, FindsSidesAndCornersOfRenderedTriangles) {
  std::mt19937 rng(63);
  std::uniform_real_distribution<double> u(0.0, 1.0);
  int corners = 0, found = 0, spurious = 0;
  double square = 0.0;
  for (int trial = 0; trial < 20; ++trial) {
    std::vector<Eigen::Vector2d> triangle;
    const double turn = 2 * M_PI * u(rng);
    for (int k = 0; k < 3; ++k) {
      const double angle = turn + 2 * M_PI * (k + 0.3 * u(rng)) / 3;
      triangle.push_back(Eigen::Vector2d(160, 120) +
                         (60 + 40 * u(rng)) * Eigen::Vector2d(std::cos(angle), std::sin(angle)));
    }
    ShapeRenderOptions render;
    render.noise_sigma = GetParam();
    GradientOptions gradient;
    gradient.colour = ColourGradient::kIntensity;
    const auto features = Detect(
        LinkEdges(MakeGradientFields(RenderPolygon(triangle, render, &rng), gradient)[0], {}));
    for (const Eigen::Vector2d& corner : triangle) {
      ++corners;
      double nearest = 1e9;
      for (const HoughVertex& v : features.vertices) {
        nearest = std::min(nearest, (v.point - corner).norm());
      }
      if (nearest < 3.0) {
        ++found;
        square += nearest * nearest;
      }
    }
    for (const HoughVertex& v : features.vertices) {
      EXPECT_GE(v.segments.size(), 2u);
      spurious += NearestCorner(v.point, triangle) >= 3.0;
    }
  }
  std::printf("noise %.0f: corners %d of %d, rms %.3f px, spurious %d\n",
              GetParam(),
              found,
              corners,
              std::sqrt(square / found),
              spurious);
  EXPECT_GE(found, 0.95 * corners);
  EXPECT_LE(spurious, 0.1 * corners);
  EXPECT_LT(std::sqrt(square / found), 0.5);
}

INSTANTIATE_TEST_SUITE_P(Sigma, HoughNoise, testing::Values(0.0, 2.0, 4.0));

TEST(DetectHoughLines, NothingAndNoiseGiveNothingOrBoundedLists) {
  EXPECT_TRUE(Detect({}).segments.empty());
  EXPECT_TRUE(Detect({EdgeChain()}).segments.empty());
  std::mt19937 rng(64);
  std::uniform_real_distribution<float> u(0.0f, 1.0f);
  EdgeChain noise;
  for (int i = 0; i < 20000; ++i) {
    noise.points.emplace_back(320 * u(rng), 240 * u(rng));
    noise.gradients.emplace_back(u(rng) - 0.5f, u(rng) - 0.5f);
  }
  HoughOptions options;
  options.max_lines = 50;
  Detect({noise}, options);
  // Points outside the image vote at its border but are no error.
  EdgeChain outside;
  outside.points.assign(30, Eigen::Vector2f(1e30f, -1e30f));
  outside.gradients.assign(30, Eigen::Vector2f(0, 0));
  EXPECT_TRUE(Detect({outside}).segments.empty());
  outside.gradients.assign(30, Eigen::Vector2f(1, 2));
  EXPECT_TRUE(Detect({outside}).segments.empty());
}

TEST(DetectHoughLines, RefusesBadInput) {
  constexpr auto kBad = absl::StatusCode::kInvalidArgument;
  EXPECT_EQ(DetectHoughLines({}, 0, 10, {}).status().code(), kBad);
  EXPECT_EQ(DetectHoughLines({}, 10, 30000, {}).status().code(), kBad);
  HoughOptions options;
  options.angle_step_rad = std::numeric_limits<double>::quiet_NaN();
  EXPECT_EQ(DetectHoughLines({}, 10, 10, options).status().code(), kBad);
  options = {};
  options.offset_step_px = 1e-9;
  EXPECT_EQ(DetectHoughLines({}, 10, 10, options).status().code(), kBad);
  std::vector<EdgeChain> chains(1);
  chains[0].points.emplace_back(1, 1);
  EXPECT_EQ(DetectHoughLines(chains, 10, 10, {}).status().code(), kBad);
  chains[0].gradients.emplace_back(std::numeric_limits<float>::infinity(), 1);
  EXPECT_EQ(DetectHoughLines(chains, 10, 10, {}).status().code(), kBad);
}

}  // namespace
}  // namespace horopter
