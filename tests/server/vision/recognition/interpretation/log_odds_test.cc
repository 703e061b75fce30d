#include "server/vision/recognition/interpretation/log_odds.h"

#include <gtest/gtest.h>

#include "server/vision/recognition/learnt_constants.h"

namespace horopter {
namespace {

TEST(StatedProbability, IsWhatAnswersOfThatProbabilityWere) {
  EXPECT_NEAR(StatedProbability(0.5, 1.0), Logistic(kAnsweredLogOdds), 1e-12);
  EXPECT_GT(StatedProbability(0.6, 1.0), 0.9);
  double last = 0.0;
  for (const double p : {0.0, 0.1, 0.6, 0.9, 0.99, 1.0}) {
    const double stated = StatedProbability(p, 1.0);
    EXPECT_GT(stated, last);
    EXPECT_LE(stated, 1.0);
    last = stated;
  }
}

TEST(StatedProbability, HasThePoseInIt) {
  EXPECT_NEAR(StatedProbability(1.0, 0.5), 0.5, 1e-9);
  EXPECT_EQ(StatedProbability(0.9, 0.0), 0.0);
}

TEST(WithUnknownShare, ChangesTheOddsAsThePriorDoes) {
  for (const double p : {0.0, 1e-6, 0.3, 0.7, 1.0 - 1e-9, 1.0})
    EXPECT_NEAR(WithUnknownShare(p, kNominalUnknownShare), p, 1e-12);
  // One to one instead of one to nine: nine times likelier that it is something else.
  EXPECT_NEAR(UnknownOdds(0.5), 9.0, 1e-9);
  EXPECT_NEAR(WithUnknownShare(0.9, 0.5), 0.5, 1e-9);
  EXPECT_GT(WithUnknownShare(0.7, 0.01), 0.95);
  EXPECT_EQ(WithUnknownShare(1.0, 0.999), 1.0);
  EXPECT_EQ(WithUnknownShare(0.0, 0.001), 0.0);
}

}  // namespace
}  // namespace horopter
