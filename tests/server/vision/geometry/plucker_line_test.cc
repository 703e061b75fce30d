#include "server/vision/geometry/plucker_line.h"

#include <gtest/gtest.h>

#include <Eigen/Dense>
#include <cmath>

#include "tests/server/vision/invariants/random_space.h"

namespace horopter {
namespace {

constexpr int kTrials = 200;

// Homogeneous vectors are equal when they are parallel.
template <typename A, typename B>
double Apart(const A& a, const B& b) {
  const auto x = a.normalized().eval();
  const auto y = b.normalized().eval();
  return std::min((x - y).norm(), (x + y).norm());
}

TEST(PluckerLine, MatrixIsThatOfTwoPointsAndRoundTrips) {
  RandomSpace space(1);
  for (int k = 0; k < kTrials; ++k) {
    const Eigen::Vector4d a = space.Scale() * space.Point(), b = space.Scale() * space.Point();
    const PluckerLine line = JoinPoints(a, b);
    EXPECT_LT((PluckerMatrix(line) - (a * b.transpose() - b * a.transpose())).norm(),
              1e-12 * line.norm());
    EXPECT_EQ(LineOfMatrix(PluckerMatrix(line)), line);
    EXPECT_NEAR(line.head<3>().dot(line.tail<3>()), 0.0, 1e-12 * line.squaredNorm());
    EXPECT_LT((line - LineThrough(a, b)).norm(), 1e-12 * line.norm());  // of the invariants
  }
}

TEST(PluckerLine, FinitePointsGiveDirectionAndMoment) {
  const Eigen::Vector4d a(1, 2, 3, 1), b(4, 4, 4, 1);
  PluckerLine expected;
  expected << Eigen::Vector3d(3, 2, 1), a.head<3>().cross(b.head<3>());
  EXPECT_EQ(JoinPoints(a, b), expected);
}

TEST(PluckerLine, JoinsAndMeetsAreIncident) {
  RandomSpace space(2);
  for (int k = 0; k < kTrials; ++k) {
    const Eigen::Vector4d a = space.Point(), b = space.Point(), c = space.Point();
    const PluckerLine line = JoinPoints(a, b);
    const Eigen::Vector4d plane = JoinPoints(a, b, c);
    for (const Eigen::Vector4d& x : {a, b, c}) EXPECT_NEAR(plane.normalized().dot(x), 0.0, 1e-9);
    EXPECT_LT((DualPluckerMatrix(line) * a).norm(), 1e-10);  // X on L
    EXPECT_LT((PluckerMatrix(line) * plane).norm(), 1e-9);   // L in the plane
    EXPECT_LT(Apart(JoinLinePoint(line, c), plane), 1e-9);
    const Eigen::Vector4d other(space.Normal(), space.Normal(), space.Normal(), space.Normal());
    const Eigen::Vector4d meet = MeetLinePlane(line, other);
    EXPECT_NEAR(other.dot(meet.normalized()), 0.0, 1e-9);
    EXPECT_LT((DualPluckerMatrix(line) * meet.normalized()).norm(), 1e-9);
  }
}

TEST(PluckerLine, MeetIsTheDualOfJoin) {
  RandomSpace space(3);
  for (int k = 0; k < kTrials; ++k) {
    const Eigen::Vector4d a = space.Point(), b = space.Point(), c = space.Point(),
                          d = space.Point();
    // The line through a and b is where the planes abc and abd meet.
    const Eigen::Vector4d abc = JoinPoints(a, b, c), abd = JoinPoints(a, b, d);
    EXPECT_LT(Apart(MeetPlanes(abc, abd), JoinPoints(a, b)), 1e-6);
    EXPECT_LT(Apart(MeetPlanes(abc, abd, JoinPoints(a, c, d)), a), 1e-6);
    EXPECT_EQ(DualLine(DualLine(JoinPoints(a, b))), JoinPoints(a, b));
  }
}

TEST(PluckerLine, IncidenceProductIsTheDeterminantOfFourPoints) {
  RandomSpace space(4);
  for (int k = 0; k < kTrials; ++k) {
    Eigen::Matrix4d X;
    for (int i = 0; i < 4; ++i) X.col(i) = space.Point();
    const PluckerLine l1 = JoinPoints(X.col(0), X.col(1)), l2 = JoinPoints(X.col(2), X.col(3));
    EXPECT_NEAR(IncidenceProduct(l1, l2), -X.determinant(), 1e-9);
    EXPECT_NEAR(IncidenceProduct(l1, JoinPoints(X.col(0), X.col(3))), 0.0, 1e-9);
  }
}

TEST(PluckerLine, NearestLineKeepsLinesAndBeatsAllNeighbours) {
  RandomSpace space(5);
  for (int k = 0; k < kTrials; ++k) {
    const PluckerLine line = JoinPoints(space.Point(), space.Point());
    EXPECT_LT((NearestLine(line) - line).norm(), 1e-10 * line.norm());
    const PluckerLine six = line + std::pow(10.0, -k % 4) * space.Noise(6);
    const PluckerLine near = NearestLine(six);
    EXPECT_NEAR(near.head<3>().dot(near.tail<3>()), 0.0, 1e-10 * near.squaredNorm());
    const double distance = (near - six).norm();
    // Any other line near it is farther from the six-vector, whatever its length.
    for (int j = 0; j < 20; ++j) {
      const OrthonormalLine moved =
          Plus(ToOrthonormal(near), 0.01 * Eigen::Vector4d(space.Noise(4)));
      const PluckerLine unit = FromOrthonormal(moved);
      EXPECT_GE((unit * unit.dot(six) - six).norm(), distance - 1e-10);
    }
  }
}

TEST(PluckerLine, DistanceIsThatOfTheCommonPerpendicular) {
  RandomSpace space(6);
  for (int k = 0; k < kTrials; ++k) {
    const Eigen::Vector3d a = space.Noise(3), d1 = space.Noise(3), d2 = space.Noise(3);
    const double gap = std::abs(space.Normal());
    const Eigen::Vector3d b = a + gap * d1.cross(d2).normalized();
    const PluckerLine l1 = space.Scale() * JoinPoints((a + d1).eval().homogeneous(),
                                                      (a - 2 * d1).eval().homogeneous());
    const PluckerLine l2 =
        space.Scale() * JoinPoints((b + d2).eval().homogeneous(), (b - d2).eval().homogeneous());
    EXPECT_NEAR(LineLineDistance(l1, l2), gap, 1e-6);
    EXPECT_NEAR(PointLineDistance(b.homogeneous(), l1), gap, 1e-9);
    // Parallel line through b.
    const PluckerLine l3 =
        space.Scale() * JoinPoints(b.homogeneous(), (b + 3 * d1).eval().homogeneous());
    EXPECT_NEAR(LineLineDistance(l1, l3), gap, 1e-6);
    // The plane through l1 perpendicular to the common perpendicular.
    Eigen::Vector4d plane;
    plane << d1.cross(d2), -d1.cross(d2).dot(a);
    EXPECT_NEAR(PointPlaneDistance(2.0 * Eigen::Vector4d(b.homogeneous()), plane), gap, 1e-9);
  }
}

TEST(PluckerLine, OrthonormalFormRoundTripsAlsoAtInfinityAndThroughTheOrigin) {
  RandomSpace space(7);
  for (int k = 0; k < kTrials; ++k) {
    Eigen::Vector4d a = space.Point(), b = space.Point();
    if (k % 3 == 1) a.w() = b.w() = 0.0;           // at infinity
    if (k % 3 == 2) a = Eigen::Vector4d::Unit(3);  // through the origin
    const PluckerLine line = JoinPoints(a, b);
    const OrthonormalLine form = ToOrthonormal(line);
    EXPECT_NEAR((form.U.transpose() * form.U - Eigen::Matrix3d::Identity()).norm(), 0.0, 1e-12);
    EXPECT_NEAR(form.U.determinant(), 1.0, 1e-12);
    EXPECT_LT(Apart(FromOrthonormal(form), line), 1e-12);
    const auto points = PointsOnLine(form);
    EXPECT_LT((JoinPoints(points[0], points[1]) - FromOrthonormal(form)).norm(), 1e-12);
    EXPECT_NEAR(points[0].dot(points[1]), 0.0, 1e-12);
    const PluckerLine moved = FromOrthonormal(Plus(form, space.Noise(4)));
    EXPECT_NEAR(moved.head<3>().dot(moved.tail<3>()), 0.0, 1e-12);
  }
}

}  // namespace
}  // namespace horopter
