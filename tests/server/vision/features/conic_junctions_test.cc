#include "server/vision/features/conic_junctions.h"

#include <gtest/gtest.h>

#include <cmath>
#include <random>

#include "server/vision/features/co_conic.h"

namespace horopter {
namespace {

EllipseArc Circle(double x, double y, double r, double start = 0.0, double sweep = 2.0 * M_PI) {
  EllipseArc arc;
  arc.center = {x, y};
  arc.semi_major_px = arc.semi_minor_px = r;
  arc.start_rad = start;
  arc.sweep_rad = sweep;
  arc.rms_px = 0.2;
  return arc;
}

Segment Piece(double x0, double y0, double x1, double y1) {
  Segment s;
  s.start = {x0, y0};
  s.end = {x1, y1};
  s.offset_sigma_px = 0.05;
  s.angle_sigma_rad = 0.001;
  return s;
}

TEST(FindConicJunctions, SpokeEndsOnTheRim) {
  const auto junctions =
      FindConicJunctions({Piece(20, 100, 67, 100)}, {Circle(100, 100, 30)}, ConicJunctionOptions());
  ASSERT_EQ(junctions.size(), 1u);
  EXPECT_LT((junctions[0].point - Eigen::Vector2d(70, 100)).norm(), 1e-9);
  EXPECT_FALSE(junctions[0].at_start);
  EXPECT_FALSE(junctions[0].tangent);
  EXPECT_FALSE(junctions[0].at_arc_end);
}

TEST(FindConicJunctions, StadiumRunsOnSmoothly) {
  // Two straight sides and two half circles.
  const std::vector<Segment> sides = {Piece(100, 70, 200, 70), Piece(100, 130, 200, 130)};
  const std::vector<EllipseArc> caps = {Circle(100, 100, 30, 0.5 * M_PI, M_PI),
                                        Circle(200, 100, 30, -0.5 * M_PI, M_PI)};
  const auto junctions = FindConicJunctions(sides, caps, ConicJunctionOptions());
  ASSERT_EQ(junctions.size(), 4u);
  for (const ConicJunction& junction : junctions) {
    EXPECT_TRUE(junction.tangent);
    EXPECT_TRUE(junction.at_arc_end);
    const Segment& side = sides[junction.segment];
    EXPECT_LT((junction.point - (junction.at_start ? side.start : side.end)).norm(), 1e-6);
  }
}

TEST(FindConicJunctions, FarEndsMissingArcsAndOwnChordsDoNotMeet) {
  const ConicJunctionOptions options;
  EXPECT_TRUE(
      FindConicJunctions({Piece(0, 100, 50, 100)}, {Circle(100, 100, 30)}, options).empty());
  // The half of the rim that was not seen.
  EXPECT_TRUE(
      FindConicJunctions({Piece(0, 100, 68, 100)}, {Circle(100, 100, 30, -1.0, 2.0)}, options)
          .empty());
  Segment chord = Piece(95, 70.5, 105, 70.5);
  chord.arc = 0;
  EXPECT_TRUE(FindConicJunctions({chord}, {Circle(100, 100, 30)}, options).empty());
  EXPECT_TRUE(FindConicJunctions({}, {}, options).empty());
}

TEST(FindConicJunctions, CovarianceHoldsTheScatterOfTheIntersection) {
  std::mt19937 rng(29);
  std::normal_distribution<double> normal(0.0, 1.0);
  const Segment truth = Piece(0, 80, 75, 90);
  EllipseArc rim = Circle(100, 100, 30);
  rim.rms_px = 0.0;
  int inside = 0;
  constexpr int kTrials = 1000;
  const auto exact = FindConicJunctions({truth}, {rim}, ConicJunctionOptions());
  ASSERT_EQ(exact.size(), 1u);
  const Eigen::Vector2d along = (truth.end - truth.start).normalized();
  const Eigen::Vector2d normal_of(-along.y(), along.x());
  for (int trial = 0; trial < kTrials; ++trial) {
    Segment noisy = truth;
    const double offset = truth.offset_sigma_px * normal(rng);
    const double turn = truth.angle_sigma_rad * normal(rng) * 0.5 * truth.Length();
    noisy.start += (offset - turn) * normal_of;
    noisy.end += (offset + turn) * normal_of;
    const auto found = FindConicJunctions({noisy}, {rim}, ConicJunctionOptions());
    ASSERT_EQ(found.size(), 1u);
    // The ellipse is exact, so the error lies along it: one degree of freedom.
    const double error = (found[0].point - exact[0].point).norm();
    inside += error <= 1.96 * std::sqrt(exact[0].covariance.trace()) ? 1 : 0;
  }
  EXPECT_GT(inside, 0.93 * kTrials);
  EXPECT_LT(inside, 0.97 * kTrials);
}

TEST(ReconcileArcs, ChordsAreNamedAndArcsOfStraightEdgesDropped) {
  // Chords of 20 degrees on a rim, and a square around another circle that only touches it.
  std::vector<Segment> segments;
  for (int k = 0; k < 18; ++k) {
    const double a = k * M_PI / 9.0, b = (k + 1) * M_PI / 9.0;
    segments.push_back(Piece(100 + 30 * std::cos(a),
                             100 + 30 * std::sin(a),
                             100 + 30 * std::cos(b),
                             100 + 30 * std::sin(b)));
  }
  const size_t chords = segments.size();
  segments.push_back(Piece(260, 60, 340, 60));
  segments.push_back(Piece(340, 60, 340, 140));
  segments.push_back(Piece(340, 140, 260, 140));
  segments.push_back(Piece(260, 140, 260, 60));
  CoConicOptions options;
  // A circle touches its square on about a fifth of its length.
  options.max_straight_share = 0.15;
  std::vector<EllipseArc> arcs = {Circle(300, 100, 40), Circle(100, 100, 30)};
  EXPECT_EQ(ReconcileArcs(options, &arcs, &segments), 1);
  ASSERT_EQ(arcs.size(), 1u);
  EXPECT_EQ(arcs[0].center.x(), 100.0);
  for (size_t i = 0; i < segments.size(); ++i) {
    EXPECT_EQ(segments[i].arc, i < chords ? 0 : -1) << i;
  }
}

}  // namespace
}  // namespace horopter
