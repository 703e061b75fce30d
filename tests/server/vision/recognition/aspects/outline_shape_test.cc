#include "server/vision/recognition/aspects/outline_shape.h"

#include <gtest/gtest.h>

#include <Eigen/Geometry>
#include <cmath>
#include <numbers>
#include <random>

namespace horopter {
namespace {

std::vector<Eigen::Vector2f> Points(unsigned seed, int count = 40) {
  std::mt19937 random(seed);
  std::normal_distribution<float> x(0.0f, 3.0f), y(0.0f, 1.5f);
  std::vector<Eigen::Vector2f> out;
  for (int i = 0; i < count; ++i) out.emplace_back(x(random) + 2.0f * (i % 3 == 0), y(random));
  return out;
}

std::vector<Eigen::Vector2f> Moved(const std::vector<Eigen::Vector2f>& points,
                                   float size,
                                   float turn,
                                   const Eigen::Vector2f& by) {
  std::vector<Eigen::Vector2f> out;
  const Eigen::Rotation2Df R(turn);
  for (const Eigen::Vector2f& p : points) out.push_back(size * (R * p) + by);
  return out;
}

std::vector<Eigen::Vector2f> EllipsePoints(float a, float b, int count = 60) {
  std::vector<Eigen::Vector2f> out;
  for (int i = 0; i < count; ++i) {
    const float t = 2.0f * std::numbers::pi_v<float> * static_cast<float>(i) / count;
    out.emplace_back(a * std::cos(t), b * std::sin(t));
  }
  return out;
}

TEST(OutlineShape, SimilaritiesKeepTheKeyAndAreFoundAgain) {
  for (unsigned seed = 1; seed <= 20; ++seed) {
    SCOPED_TRACE(testing::Message() << "seed " << seed);
    const auto points = Points(seed);
    const float size = 0.5f + 0.1f * static_cast<float>(seed),
                turn = 0.31f * static_cast<float>(seed);
    const Eigen::Vector2f by(40.0f, -25.0f);
    const auto model = ShapeOf(points), image = ShapeOf(Moved(points, size, turn, by));
    ASSERT_TRUE(model && image);
    // The support function is sampled: corners of the hull lie between the directions.
    for (int i = 0; i < kOutlineOrders; ++i)
      EXPECT_NEAR(model->Key()[i], image->Key()[i], 4e-3) << i;
    EXPECT_NEAR(image->width / model->width, size, 2e-3 * size);
    const Eigen::Vector2f center = size * (Eigen::Rotation2Df(turn) * model->center) + by;
    EXPECT_LT((image->center - center).norm(), 5e-3f * image->width);
    const auto turns = TurnsBetween(*model, *image, 3);
    ASSERT_FALSE(turns.empty());
    EXPECT_NEAR(std::remainder(turns.front().turn_rad - turn, 2 * std::numbers::pi), 0.0, 0.02);
    EXPECT_LT(turns.front().apart, 0.02f);
  }
}

TEST(OutlineShape, AnEllipseHasTwoTurnsAndACircleAnyOfThem) {
  const auto flat = ShapeOf(EllipsePoints(3.0f, 1.5f));
  const auto turned = ShapeOf(Moved(EllipsePoints(3.0f, 1.5f), 1.0f, 0.7f, {0, 0}));
  ASSERT_TRUE(flat && turned);
  const auto turns = TurnsBetween(*flat, *turned, 4);
  ASSERT_EQ(turns.size(), 2u);
  for (const OutlineTurn& t : turns)
    EXPECT_NEAR(std::remainder(t.turn_rad - 0.7, std::numbers::pi), 0.0, 0.02);
  const auto circle = ShapeOf(EllipsePoints(2.0f, 2.0f));
  ASSERT_TRUE(circle);
  EXPECT_EQ(TurnsBetween(*circle, *circle, 4).size(), 4u);
  for (const double v : circle->Key()) EXPECT_LT(v, 0.01);
}

TEST(OutlineShape, OtherShapesAreApart) {
  const auto square = ShapeOf(std::vector<Eigen::Vector2f>{{1, 1}, {-1, 1}, {-1, -1}, {1, -1}});
  const auto bar = ShapeOf(std::vector<Eigen::Vector2f>{{3, 1}, {-3, 1}, {-3, -1}, {3, -1}});
  const auto triangle = ShapeOf(std::vector<Eigen::Vector2f>{{2, 0}, {-1, 1.7f}, {-1, -1.7f}});
  ASSERT_TRUE(square && bar && triangle);
  EXPECT_GT(TurnsBetween(*square, *bar, 1).front().apart, 0.15f);
  EXPECT_GT(TurnsBetween(*square, *triangle, 1).front().apart, 0.10f);
  EXPECT_GT(TurnsBetween(*bar, *triangle, 1).front().apart, 0.15f);
}

TEST(OutlineShape, PointsInOnePlaceHaveNone) {
  EXPECT_FALSE(ShapeOf(std::vector<Eigen::Vector2f>{{1, 1}, {2, 2}}));
  EXPECT_FALSE(ShapeOf({}));
  EXPECT_FALSE(ShapeOf(std::vector<Eigen::Vector2f>(5, Eigen::Vector2f(0, 0))));
  const float nan = std::nanf("");
  EXPECT_FALSE(ShapeOf(std::vector<Eigen::Vector2f>(5, Eigen::Vector2f(nan, nan))));
}

}  // namespace
}  // namespace horopter
