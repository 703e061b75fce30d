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

}  // namespace
}  // namespace horopter
