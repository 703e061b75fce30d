#include "server/vision/features/arc_refit.h"

#include <gtest/gtest.h>

#include <cmath>
#include <random>

#include "server/vision/features/ellipse_frame.h"

namespace horopter {
namespace {

EllipseArc Arc(double cx, double cy, double a, double b, double angle, double start, double sweep) {
  EllipseArc arc;
  arc.center = {cx, cy};
  arc.semi_major_px = a;
  arc.semi_minor_px = b;
  arc.angle_rad = angle;
  arc.start_rad = start;
  arc.sweep_rad = sweep;
  return arc;
}

// Points every half pixel along it, with noise.
EdgeChain ChainAlong(const EllipseArc& arc, double noise_px, unsigned seed) {
  std::mt19937 rng(seed);
  std::normal_distribution<double> n(0.0, noise_px);
  const EllipseFrame frame(arc);
  EdgeChain chain;
  const int steps = static_cast<int>(2.0 * arc.sweep_rad * arc.semi_major_px);
  for (int k = 0; k <= steps; ++k) {
    const Eigen::Vector2d unit = UnitAt(arc.start_rad + arc.sweep_rad * k / steps);
    const Eigen::Vector2d p = frame.PointAt(unit) + n(rng) * frame.NormalAt(unit);
    chain.points.push_back(p.cast<float>());
  }
  return chain;
}

TEST(RefitArcs, BringsADisplacedArcBackToItsEdge) {
  const EllipseArc truth = Arc(200, 150, 60, 40, 0.4, 0.3, 4.5);
  ImageFeatures features;
  features.width = 400;
  features.height = 300;
  features.chains.push_back(ChainAlong(truth, 0.1, 5));
  features.arcs.push_back(Arc(200.6, 149.5, 60.5, 39.6, 0.41, 0.3, 4.5));
  RefitArcs(&features);
  EXPECT_EQ(features.counts["arcs_refitted"], 1.0);
  const EllipseArc& arc = features.arcs[0];
  EXPECT_LT((arc.center - truth.center).norm(), 0.1);
  EXPECT_NEAR(arc.semi_major_px, 60.0, 0.15);
  EXPECT_NEAR(arc.semi_minor_px, 40.0, 0.15);
  EXPECT_NEAR(arc.sweep_rad, truth.sweep_rad, 0.1);
}

TEST(RefitArcs, LeavesAnArcWithoutPointsAlone) {
  ImageFeatures features;
  features.width = 400;
  features.height = 300;
  features.chains.push_back(ChainAlong(Arc(200, 150, 60, 40, 0.4, 0.3, 0.05), 0.1, 6));
  features.arcs.push_back(Arc(200, 150, 60, 40, 0.4, 0.3, 4.5));
  features.arcs.push_back(Arc(320, 60, 20, 15, 0.0, 0.0, 6.0));
  RefitArcs(&features);
  EXPECT_EQ(features.counts["arcs_refitted"], 0.0);
  EXPECT_EQ(features.arcs[0].center, Eigen::Vector2d(200, 150));
  EXPECT_EQ(features.arcs[1].semi_major_px, 20.0);
}

}  // namespace
}  // namespace horopter
