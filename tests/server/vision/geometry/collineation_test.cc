#include "server/vision/geometry/collineation.h"

#include <gtest/gtest.h>

#include <Eigen/Dense>

#include "tests/server/vision/geometry/up_to_scale.h"
#include "tests/server/vision/invariants/random_space.h"

namespace horopter {
namespace {

constexpr int kTrials = 100;

TEST(Collineation, JoinsAndMeetsCommuteWithMaps) {
  RandomSpace space(1);
  for (int k = 0; k < kTrials; ++k) {
    const Eigen::Matrix4d H = space.Collineation();
    const Eigen::Vector4d a = space.Point(), b = space.Point(), c = space.Point();
    EXPECT_LT(Apart(MapLine(H, JoinPoints(a, b)), JoinPoints(MapPoint(H, a), MapPoint(H, b))),
              1e-9);
    EXPECT_LT(Apart(MapPlane(H, JoinPoints(a, b, c)),
                    JoinPoints(MapPoint(H, a), MapPoint(H, b), MapPoint(H, c))),
              1e-8);
    const Eigen::Vector4d p = space.Point(), q = space.Point();  // as planes
    EXPECT_LT(Apart(MapLine(H, MeetPlanes(p, q)), MeetPlanes(MapPlane(H, p), MapPlane(H, q))),
              1e-8);
    EXPECT_NEAR(MapPlane(H, p).dot(MapPoint(H, a)), p.dot(a), 1e-8);
  }
}

TEST(Collineation, LineMatrixIsARepresentationOfTheGroup) {
  RandomSpace space(2);
  for (int k = 0; k < kTrials; ++k) {
    const Eigen::Matrix4d G = space.Collineation(), H = space.Collineation();
    const PluckerLine line = JoinPoints(space.Point(), space.Point());
    const Matrix6d of_product = LineCollineation(G * H);
    EXPECT_LT((of_product - LineCollineation(G) * LineCollineation(H)).norm(),
              1e-10 * of_product.norm());
    EXPECT_LT((LineCollineation(H) * line - MapLine(H, line)).norm(), 1e-10 * line.norm() * 100);
    EXPECT_LT(Apart(LineCollineation(H) * line, TransformLine(H, line)), 1e-9);
  }
}

TEST(Collineation, FitsMinimalAndLargerSetsOfPointsAndLines) {
  RandomSpace space(3);
  const std::vector<std::pair<int, int>> sets = {{5, 0}, {3, 2}, {0, 5}, {8, 0}, {6, 6}, {2, 4}};
  for (int k = 0; k < 60; ++k) {
    const auto [points, lines] = sets[k % sets.size()];
    SCOPED_TRACE(testing::Message() << points << " points, " << lines << " lines");
    const Eigen::Matrix4d H = space.Collineation();
    std::vector<PointPair3> p;
    std::vector<LinePair3> l;
    for (int i = 0; i < points; ++i) {
      const Eigen::Vector4d x = space.Point();
      p.push_back({x, space.Scale() * MapPoint(H, x)});
    }
    for (int i = 0; i < lines; ++i) {
      const PluckerLine x = space.Line();
      l.push_back({x, space.Scale() * MapLine(H, x)});
    }
    const auto found = FitCollineation(p, l);
    ASSERT_TRUE(found);
    EXPECT_LT(Apart(*found, H), 1e-5);
  }
}

TEST(Collineation, RefusesTooLittle) {
  RandomSpace space(4);
  std::vector<PointPair3> points;
  for (int i = 0; i < 4; ++i) points.push_back({space.Point(), space.Point()});
  EXPECT_FALSE(FitCollineation(points, {}));
  std::vector<LinePair3> lines;  // four lines leave a one-parameter family
  const Eigen::Matrix4d H = space.Collineation();
  for (int i = 0; i < 4; ++i) {
    const PluckerLine line = space.Line();
    lines.push_back({line, MapLine(H, line)});
  }
  EXPECT_FALSE(FitCollineation({}, lines));
  points.push_back({Eigen::Vector4d::Constant(std::nan("")), space.Point()});
  EXPECT_FALSE(FitCollineation(points, {}));
}

TEST(Collineation, RefinementNeverWorsensAndReachesTheNoise) {
  RandomSpace space(5);
  for (int k = 0; k < 20; ++k) {
    Eigen::Matrix4d H = Eigen::Matrix4d::Identity() + 0.1 * space.Collineation().normalized();
    std::vector<PointPair3> points;
    for (int i = 0; i < 40; ++i) {
      const Eigen::Vector4d x = space.Point();
      Eigen::Vector4d y = MapPoint(H, x);
      y /= y.w();
      y.head<3>() += 1e-3 * space.Noise(3);
      points.push_back({x, y});
    }
    const auto linear = FitCollineation(points, {});
    ASSERT_TRUE(linear);
    const double before = CollineationRms(*linear, points);
    const double after = CollineationRms(RefineCollineation(*linear, points), points);
    EXPECT_LE(after, before);
    EXPECT_LT(after, 1.25 * 1e-3 * std::sqrt(3.0));
  }
}

}  // namespace
}  // namespace horopter
