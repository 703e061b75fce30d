#include "server/vision/matching/three_views.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <Eigen/Dense>

#include "tests/support/random.h"
#include "tests/support/synthetic_scene.h"

namespace horopter {
namespace {

struct Case {
  std::vector<ImageFeatures> features;
  std::vector<PairGeometry> pairs;

  int Refuse(const std::vector<char>& suspect) {
    std::vector<const ImageFeatures*> of_views;
    for (const ImageFeatures& f : features) of_views.push_back(&f);
    return RefuseInconsistentPairs(of_views, suspect, {}, &pairs);
  }
};

Case MakeCase(unsigned seed, int views, double wrong_matches) {
  SyntheticSceneOptions options;
  options.seed = seed;
  options.views = views;
  SyntheticNoise noise;
  noise.seed = seed;
  noise.sigma_px = 0.5;
  noise.outlier_share = wrong_matches;
  const SyntheticMatches synthetic = MatchSyntheticScene(MakeSyntheticScene(options), noise);
  return {synthetic.features, synthetic.matching.pairs};
}

// F of the pair from another scene, with the matches that lie along its lines: what a matcher makes
// of a wrong F.
void Corrupt(unsigned seed, PairGeometry* pair, const Case& truth) {
  SyntheticSceneOptions other;
  other.seed = seed + 1000;
  other.views = 2;
  const Eigen::Matrix3d F = MakeSyntheticScene(other).FundamentalOf(0, 1);
  pair->F = F;
  pair->matches.clear();
  const auto& ja = truth.features[pair->view_a].junctions;
  const auto& jb = truth.features[pair->view_b].junctions;
  std::vector<char> used(jb.size(), 0);
  for (size_t i = 0; i < ja.size(); ++i) {
    const Eigen::Vector3d l = F * ja[i].point.homogeneous();
    for (size_t j = 0; j < jb.size(); ++j) {
      if (used[j] || std::abs(l.dot(jb[j].point.homogeneous())) > 2.0 * l.head<2>().norm())
        continue;
      used[j] = 1;
      pair->matches.push_back({static_cast<int>(i), static_cast<int>(j), 4.0});
      break;
    }
  }
}

TEST(RefuseInconsistentPairs, RightOnesStay) {
  for (unsigned seed = 1; seed <= 20; ++seed) {
    Case c = MakeCase(seed, 5, 0.1);
    EXPECT_EQ(c.Refuse(std::vector<char>(c.pairs.size(), 1)), 0) << "seed " << seed;
    for (const PairGeometry& pair : c.pairs) EXPECT_TRUE(pair.F) << "seed " << seed;
  }
}

TEST(RefuseInconsistentPairs, OneWrongAmongConsistentOnesIsRefusedWithItsReason) {
  for (unsigned seed = 1; seed <= 20; ++seed) {
    for (const int views : {3, 4, 6}) {
      Case c = MakeCase(seed, views, 0.05);
      const size_t wrong = seed % c.pairs.size();
      Corrupt(seed, &c.pairs[wrong], c);
      SCOPED_TRACE(testing::Message() << "seed " << seed << " views " << views);
      EXPECT_EQ(c.Refuse(std::vector<char>(c.pairs.size(), 1)), 1);
      for (size_t k = 0; k < c.pairs.size(); ++k) EXPECT_EQ(c.pairs[k].F.has_value(), k != wrong);
      EXPECT_THAT(c.pairs[wrong].refusal, testing::HasSubstr("third view"));
    }
  }
}

TEST(RefuseInconsistentPairs, OnlySuspectsAreRefused) {
  Case c = MakeCase(3, 4, 0.0);
  Corrupt(3, &c.pairs[2], c);
  std::vector<char> suspect(c.pairs.size(), 0);
  EXPECT_EQ(c.Refuse(suspect), 0);
  suspect[2] = 1;
  EXPECT_EQ(c.Refuse(suspect), 1);
  EXPECT_FALSE(c.pairs[2].F);
}

TEST(RefuseInconsistentPairs, TwoViewsAndFewPointsSayNothing) {
  Case two = MakeCase(1, 2, 0.0);
  Corrupt(1, &two.pairs[0], two);
  EXPECT_EQ(two.Refuse({1}), 0);
  Case few = MakeCase(1, 3, 0.0);
  for (PairGeometry& pair : few.pairs) pair.matches.resize(3);
  few.pairs[1].F = few.pairs[0].F;
  EXPECT_EQ(few.Refuse({1, 1, 1}), 0);
  Case none;
  EXPECT_EQ(none.Refuse({}), 0);
}

}  // namespace
}  // namespace horopter
