#include "server/vision/recognition/invariant_matching/mean_shift.h"

#include <gtest/gtest.h>

#include <limits>

#include "tests/support/random.h"

namespace horopter {
namespace {

struct Mixture {
  Eigen::MatrixXd votes;
  std::vector<int> component;  // -1: scattered
  Eigen::MatrixXd centres;
};

// `k` normal components of deviation 0.05 at least 1 apart, and scattered votes over the box.
Mixture MakeMixture(unsigned seed, int dimensions, int k, int of_each, int scattered) {
  Random random(seed);
  Mixture out;
  out.centres.resize(dimensions, k);
  for (int c = 0; c < k; ++c) {
    bool apart = false;
    while (!apart) {
      for (int d = 0; d < dimensions; ++d) out.centres(d, c) = random.Uniform(-2.0, 2.0);
      apart = true;
      for (int b = 0; b < c; ++b) apart &= (out.centres.col(b) - out.centres.col(c)).norm() > 1.0;
    }
  }
  out.votes.resize(dimensions, k * of_each + scattered);
  for (Eigen::Index i = 0; i < out.votes.cols(); ++i) {
    const int c = i < k * of_each ? static_cast<int>(i) / of_each : -1;
    out.component.push_back(c);
    for (int d = 0; d < dimensions; ++d) {
      out.votes(d, i) =
          c < 0 ? random.Uniform(-2.5, 2.5) : out.centres(d, c) + 0.05 * random.Normal();
    }
  }
  return out;
}

TEST(MeanShift, ModesAreThoseOfAMixture) {
  for (unsigned seed = 1; seed <= 20; ++seed) {
    SCOPED_TRACE(testing::Message() << "seed " << seed);
    for (const int dimensions : {1, 3}) {
      const int k = 2 + static_cast<int>(seed % 2);
      const Mixture m = MakeMixture(seed, dimensions, k, 30, 0);
      ClusterOptions options;
      options.min_bandwidth = 0.08;
      options.max_bandwidth = 0.15;
      const auto modes = FindModes(m.votes, Eigen::VectorXd::Ones(m.votes.cols()), options);
      ASSERT_TRUE(modes.ok());
      ASSERT_EQ(modes->size(), static_cast<std::size_t>(k)) << dimensions << " dimensions";
      for (const DensityMode& mode : *modes) {
        EXPECT_EQ(mode.members.size(), 30u);
        const int c = m.component[mode.members[0]];
        for (const int i : mode.members) EXPECT_EQ(m.component[i], c);
        EXPECT_LT((mode.position - m.centres.col(c)).norm(), 0.1);
        EXPECT_NEAR(mode.weight, 30.0, 1e-9);
      }
    }
  }
}

TEST(MeanShift, FindsATightModeAmongScatteredVotesInFifteenDimensions) {
  for (unsigned seed = 1; seed <= 10; ++seed) {
    SCOPED_TRACE(testing::Message() << "seed " << seed);
    const Mixture m = MakeMixture(seed, 15, 1, 5, 200);
    ClusterOptions options;
    options.min_bandwidth = 0.1;
    options.max_bandwidth = 0.3;
    const auto modes = FindModes(m.votes, Eigen::VectorXd::Ones(m.votes.cols()), options);
    ASSERT_TRUE(modes.ok());
    EXPECT_EQ((*modes)[0].members.size(), 5u);
    EXPECT_LT(((*modes)[0].position - m.centres.col(0)).norm(), 0.3);
  }
}

TEST(MeanShift, EveryVoteIsAMemberOnceAndCoincidentOnesAreOneMode) {
  Eigen::MatrixXd votes = Eigen::MatrixXd::Constant(2, 9, 3.0);
  votes(0, 8) = votes(1, 8) = 0.0;
  const auto modes = FindModes(votes, Eigen::VectorXd::Ones(9), {});
  ASSERT_TRUE(modes.ok());
  std::vector<int> times(9, 0);
  for (const DensityMode& mode : *modes) {
    for (const int i : mode.members) ++times[i];
  }
  EXPECT_EQ(times, std::vector<int>(9, 1));
}

TEST(MeanShift, SaysWhatIsWrongWithItsInput) {
  const auto code = [](const Eigen::MatrixXd& votes,
                       const Eigen::VectorXd& weights,
                       const ClusterOptions& options = {}) {
    return FindModes(votes, weights, options).status().code();
  };
  Eigen::MatrixXd votes = Eigen::MatrixXd::Zero(2, 3);
  EXPECT_EQ(code(votes, Eigen::VectorXd::Ones(2)), absl::StatusCode::kInvalidArgument);
  EXPECT_EQ(code(votes, -Eigen::VectorXd::Ones(3)), absl::StatusCode::kInvalidArgument);
  ClusterOptions options;
  options.join = 0.0;
  EXPECT_EQ(code(votes, Eigen::VectorXd::Ones(3), options), absl::StatusCode::kInvalidArgument);
  votes(1, 1) = std::numeric_limits<double>::quiet_NaN();
  EXPECT_EQ(code(votes, Eigen::VectorXd::Ones(3)), absl::StatusCode::kInvalidArgument);
  const auto none = FindModes(Eigen::MatrixXd(2, 0), Eigen::VectorXd(0), {});
  ASSERT_TRUE(none.ok());
  EXPECT_TRUE(none->empty());
}

}  // namespace
}  // namespace horopter
