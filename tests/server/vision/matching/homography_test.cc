#include "server/vision/matching/homography.h"

#include <gtest/gtest.h>

#include <Eigen/Dense>
#include <cmath>
#include <limits>
#include <random>
#include <vector>

#include "server/vision/matching/plane_chain.h"

namespace horopter {
namespace {

double Uniform(std::mt19937* rng, double low, double high) {
  return low + (high - low) * (static_cast<double>((*rng)()) / 4294967296.0);
}

// A homography two cameras could see: identity plus moderate affinity and perspective, pixels of a
// 640x480 image.
Eigen::Matrix3d RandomHomography(std::mt19937* rng) {
  Eigen::Matrix3d H;
  const double angle = Uniform(rng, -0.6, 0.6), s = Uniform(rng, 0.7, 1.4);
  H << s * std::cos(angle), -s * std::sin(angle) + Uniform(rng, -0.2, 0.2), Uniform(rng, -60, 60),
      s * std::sin(angle), s * std::cos(angle), Uniform(rng, -60, 60), Uniform(rng, -3e-4, 3e-4),
      Uniform(rng, -3e-4, 3e-4), 1.0;
  return H;
}

std::vector<PointPair> PairsOf(const Eigen::Matrix3d& H, int n, double noise, std::mt19937* rng) {
  std::vector<PointPair> pairs;
  for (int i = 0; i < n; ++i) {
    const double x = Uniform(rng, 0, 640);
    const Eigen::Vector2d a(x, Uniform(rng, 0, 480));
    const double dx = noise * Uniform(rng, -1.7, 1.7);
    pairs.push_back({a, Transfer(H, a) + Eigen::Vector2d(dx, noise * Uniform(rng, -1.7, 1.7))});
  }
  return pairs;
}

double WorstTransfer(const Eigen::Matrix3d& H, const Eigen::Matrix3d& truth) {
  double worst = 0.0;
  for (double x : {100.0, 320.0, 540.0}) {
    for (double y : {100.0, 240.0, 380.0}) {
      worst = std::max(worst, (Transfer(H, {x, y}) - Transfer(truth, {x, y})).norm());
    }
  }
  return worst;
}

TEST(FitHomography, RecoversExactPairs) {
  std::mt19937 rng(7);
  for (int trial = 0; trial < 50; ++trial) {
    const Eigen::Matrix3d truth = RandomHomography(&rng);
    const auto H = FitHomography(PairsOf(truth, 8, 0.0, &rng));
    ASSERT_TRUE(H) << "trial " << trial;
    EXPECT_LT(WorstTransfer(*H, truth), 1e-5) << "trial " << trial;
  }
}

TEST(RefineHomography, NeverRaisesTheErrorAndReachesTheNoiseFloor) {
  std::mt19937 rng(8);
  for (int trial = 0; trial < 50; ++trial) {
    const Eigen::Matrix3d truth = RandomHomography(&rng);
    const std::vector<PointPair> pairs = PairsOf(truth, 60, 0.5, &rng);
    const auto cost = [&](const Eigen::Matrix3d& H) {
      double sum = 0.0;
      for (const PointPair& p : pairs) sum += (p.b - Transfer(H, p.a)).squaredNorm();
      return sum;
    };
    Eigen::Matrix3d start = truth;
    start(0, 2) += 2.0;
    const Eigen::Matrix3d H = RefineHomography(start, pairs);
    EXPECT_LE(cost(H), cost(start));
    EXPECT_LE(cost(H), cost(truth));
    EXPECT_LT(WorstTransfer(H, truth), 1.0) << "trial " << trial;
  }
}

TEST(FitHomography, DegenerateSetsGiveNothing) {
  std::mt19937 rng(9);
  std::vector<PointPair> pairs;
  EXPECT_FALSE(FitHomography(pairs));
  for (int i = 0; i < 10; ++i)
    pairs.push_back({{10.0 * i, 5.0 * i}, {3.0 * i, 20.0 * i}});  // collinear
  EXPECT_FALSE(FitHomography(pairs));
  for (PointPair& p : pairs) p = {{1, 1}, {2, 2}};
  EXPECT_FALSE(FitHomography(pairs));
  pairs[3].a.x() = std::numeric_limits<double>::quiet_NaN();
  EXPECT_FALSE(FitHomography(pairs));
}

TEST(ImplausibleHomography, RefusesMirrorsCollapsesAndLines) {
  std::mt19937 rng(10);
  const Eigen::Matrix3d good = RandomHomography(&rng);
  EXPECT_EQ(ImplausibleHomography(good, PairsOf(good, 30, 0.3, &rng)), "");
  Eigen::Matrix3d mirror = Eigen::Matrix3d::Identity();
  mirror(0, 0) = -1.0;
  mirror(0, 2) = 640.0;
  EXPECT_NE(ImplausibleHomography(mirror, PairsOf(mirror, 30, 0.3, &rng)), "");
  Eigen::Matrix3d shrink = Eigen::Matrix3d::Identity();
  shrink(0, 0) = shrink(1, 1) = 0.1;
  EXPECT_NE(ImplausibleHomography(shrink, PairsOf(shrink, 30, 0.0, &rng)), "");
  EXPECT_NE(ImplausibleHomography(Eigen::Matrix3d::Zero(), PairsOf(good, 30, 0.0, &rng)), "");
  std::vector<PointPair> line;
  for (int i = 0; i < 30; ++i)
    line.push_back({{20.0 * i, 100.0 + i % 2}, {20.0 * i, 100.0 + i % 2}});
  EXPECT_NE(ImplausibleHomography(Eigen::Matrix3d::Identity(), line), "");
}

PlaneHomography Link(int a, int b, const Eigen::Matrix3d& H, int n, std::mt19937* rng) {
  PlaneHomography plane;
  plane.view_a = a;
  plane.view_b = b;
  plane.b_from_a = H;
  for (const PointPair& p : PairsOf(H, n, 0.3, rng)) {
    plane.inliers_a.push_back(p.a);
    plane.inliers_b.push_back(p.b);
  }
  return plane;
}

TEST(ChainPlanes, FindsTheWrongLinkOfALoop) {
  for (unsigned seed = 1; seed <= 10; ++seed) {
    std::mt19937 rng(seed);
    std::vector<Eigen::Matrix3d> maps = {Eigen::Matrix3d::Identity()};
    for (int v = 1; v < 5; ++v) maps.push_back(RandomHomography(&rng));
    std::vector<PlaneHomography> planes;
    for (int a = 0; a < 5; ++a) {
      for (int b = a + 1; b < 5; ++b)
        planes.push_back(Link(a, b, maps[b] * maps[a].inverse(), 40, &rng));
    }
    planes[4] = Link(
        planes[4].view_a, planes[4].view_b, RandomHomography(&rng), 90, &rng);  // many, but wrong
    const PlaneChain chain = ChainPlanes(planes, 5, 4.0);
    EXPECT_EQ(chain.contradicted, 1) << "seed " << seed;
    EXPECT_FALSE(chain.consistent[4]) << "seed " << seed;
    for (int v = 0; v < 5; ++v) {
      EXPECT_EQ(chain.component[v], 0);
      EXPECT_LT(WorstTransfer(chain.view_from_plane[v], maps[v]), 0.8)
          << "seed " << seed << " view " << v;
    }
    EXPECT_TRUE(chain.view_from_plane[0].isIdentity());
  }
}

TEST(ChainPlanes, SeparatePartsAreSeparateComponents) {
  std::mt19937 rng(3);
  const std::vector<PlaneHomography> planes = {Link(0, 2, RandomHomography(&rng), 30, &rng),
                                               Link(3, 4, RandomHomography(&rng), 30, &rng)};
  const PlaneChain chain = ChainPlanes(planes, 6, 4.0);
  EXPECT_EQ(chain.component, (std::vector<int>{0, -1, 0, 1, 1, -1}));
  EXPECT_TRUE(chain.view_from_plane[1].isIdentity());
  EXPECT_EQ(ChainPlanes({}, 2, 4.0).component, (std::vector<int>{-1, -1}));
}

}  // namespace
}  // namespace horopter
