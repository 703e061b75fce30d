#include "server/vision/geometry/nearest_point.h"

#include <gtest/gtest.h>

#include <Eigen/Geometry>
#include <random>
#include <vector>

namespace horopter {
namespace {

TEST(NearestToLines, IsWhereTheyMeetAndElseTheLeastSumOfSquares) {
  std::mt19937 random(1);
  std::normal_distribution<double> normal(0.0, 1.0);
  const auto draw = [&] { return Eigen::Vector3d(normal(random), normal(random), normal(random)); };
  const Eigen::Vector3d meet = draw();
  std::vector<SpaceLine> lines;
  for (int i = 0; i < 4; ++i) {
    const Eigen::Vector3d d = draw().normalized();
    lines.push_back({meet - 3.0 * d, d});
  }
  EXPECT_LT((*NearestToLines(lines) - meet).norm(), 1e-9);

  for (SpaceLine& line : lines) line.origin += 0.1 * draw();
  const auto sum = [&](const Eigen::Vector3d& x) {
    double out = 0.0;
    for (const SpaceLine& line : lines)
      out += (x - line.origin).cross(line.direction).squaredNorm();
    return out;
  };
  const Eigen::Vector3d nearest = *NearestToLines(lines);
  for (int i = 0; i < 20; ++i) EXPECT_GT(sum(nearest + 0.01 * draw()), sum(nearest));
}

TEST(NearestToLines, OfParallelLinesThereIsNone) {
  const std::vector<SpaceLine> lines = {{{0, 0, 0}, {0, 0, 1}}, {{1, 0, 0}, {0, 0, -1}}};
  EXPECT_FALSE(NearestToLines(lines));
  EXPECT_FALSE(NearestToLines(std::span(lines).first(1)));
  EXPECT_FALSE(NearestToLines({}));
  const std::vector<SpaceLine> nearly = {{{0, 0, 0}, {0, 0, 1}}, {{1, 0, 0}, {0.01, 0, 0.99995}}};
  EXPECT_TRUE(NearestToLines(nearly));
  EXPECT_FALSE(NearestToLines(nearly, 0.02));
}

}  // namespace
}  // namespace horopter
