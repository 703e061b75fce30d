#include "server/vision/matching/plane_parallax.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <Eigen/Dense>
#include <random>
#include <set>

#include "server/vision/matching/homography.h"
#include "tests/support/synthetic_scene.h"

namespace horopter {
namespace {

struct Pair {
  SyntheticScene scene;
  std::vector<MatchCandidate> candidates;
};

// Candidates of views 0 and 1: the true ones with noise and, per junction, `wrong` arbitrary
// partners as similar.
Pair MakePair(unsigned seed, double sigma_px, int wrong, bool pure_rotation = false) {
  SyntheticSceneOptions options;
  options.seed = seed;
  options.views = 2;
  options.arc_rad = 0.35;
  options.off_plane_points = 25;
  options.pure_rotation = pure_rotation;
  Pair pair{MakeSyntheticScene(options), {}};
  const SyntheticMatches matches = MatchSyntheticScene(pair.scene, {seed, sigma_px, 0.0});
  const auto& a = matches.features[0].junctions;
  const auto& b = matches.features[1].junctions;
  const Eigen::Matrix3d H_inverse = pair.scene.PlaneHomographyOf(0, 1).inverse();
  std::mt19937 rng(seed);
  for (int i = 0; i < static_cast<int>(a.size()); ++i) {
    for (int w = 0; w <= wrong; ++w) {
      const int k = w == 0 ? i : static_cast<int>(rng() % b.size());
      const double similarity = 0.5 + 0.4 * (static_cast<double>(rng()) / 4294967296.0);
      pair.candidates.push_back({i,
                                 k,
                                 a[i].point,
                                 b[k].point,
                                 similarity,
                                 (Transfer(H_inverse, b[k].point) - a[i].point).norm()});
    }
  }
  return pair;
}

double WorstEpipolar(const SyntheticScene& scene, const Eigen::Matrix3d& F) {
  double worst = 0.0;
  for (const Eigen::Vector3d& x : scene.off_plane_points) {
    const Eigen::Vector2d a = Project(scene.cameras[0], scene.camera_from_world[0] * x);
    const Eigen::Vector2d b = Project(scene.cameras[1], scene.camera_from_world[1] * x);
    const Eigen::Vector3d l = F * a.homogeneous();
    worst = std::max(worst, std::abs(l.dot(b.homogeneous())) / l.head<2>().norm());
  }
  return worst;
}

TEST(PlaneParallax, FindsTheEpipoleAmongWrongCandidates) {
  for (unsigned seed = 1; seed <= 10; ++seed) {
    const Pair pair = MakePair(seed, 0.3, 1);
    const ParallaxResult r =
        EstimatePlaneParallax(pair.scene.PlaneHomographyOf(0, 1), pair.candidates, {});
    ASSERT_TRUE(r.F) << "seed " << seed << ": " << r.refusal;
    EXPECT_LT(WorstEpipolar(pair.scene, *r.F), 1.5) << "seed " << seed;
    EXPECT_NEAR(r.F->norm(), 1.0, 1e-12);
    EXPECT_GE(r.off_plane, 15) << "seed " << seed;
  }
}

TEST(PlaneParallax, MatchesAreOneToOne) {
  const Pair pair = MakePair(2, 0.3, 3);
  const ParallaxResult r =
      EstimatePlaneParallax(pair.scene.PlaneHomographyOf(0, 1), pair.candidates, {});
  std::set<int> a, b;
  for (const MatchCandidate& m : r.matches) {
    EXPECT_TRUE(a.insert(m.index_a).second);
    EXPECT_TRUE(b.insert(m.index_b).second);
  }
}

TEST(PlaneParallax, PureRotationHasNoParallax) {
  for (unsigned seed = 1; seed <= 5; ++seed) {
    const Pair pair = MakePair(seed, 0.3, 0, /*pure_rotation=*/true);
    const ParallaxResult r =
        EstimatePlaneParallax(pair.scene.PlaneHomographyOf(0, 1), pair.candidates, {});
    EXPECT_FALSE(r.F) << "seed " << seed;
    EXPECT_THAT(r.refusal, testing::HasSubstr("no parallax"));
  }
}

TEST(PlaneParallax, ArbitraryMatchesAreRefused) {
  int accepted = 0;
  for (unsigned seed = 1; seed <= 20; ++seed) {
    Pair pair = MakePair(seed, 0.3, 1);
    std::erase_if(pair.candidates, [](const MatchCandidate& c) { return c.index_a == c.index_b; });
    const ParallaxResult r =
        EstimatePlaneParallax(pair.scene.PlaneHomographyOf(0, 1), pair.candidates, {});
    accepted += r.F.has_value();
    if (!r.F) {
      EXPECT_FALSE(r.refusal.empty());
    }
  }
  EXPECT_LE(accepted, 2);
}

TEST(PlaneParallax, HostileInputIsARefusal) {
  const Pair pair = MakePair(1, 0.3, 0);
  EXPECT_FALSE(EstimatePlaneParallax(Eigen::Matrix3d::Zero(), pair.candidates, {}).F);
  EXPECT_FALSE(EstimatePlaneParallax(Eigen::Matrix3d::Identity(), {}, {}).F);
  std::vector<MatchCandidate> same(20, pair.candidates.front());
  for (int i = 0; i < 20; ++i) same[i].index_a = same[i].index_b = i;
  EXPECT_FALSE(EstimatePlaneParallax(Eigen::Matrix3d::Identity(), same, {}).F);
}

}  // namespace
}  // namespace horopter
