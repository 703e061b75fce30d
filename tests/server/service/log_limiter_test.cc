#include "server/service/log_limiter.h"

#include <gtest/gtest.h>

namespace horopter {
namespace {

using std::chrono::seconds;
const LogLimiter::Clock::time_point kStart{};

TEST(LogLimiter, KeepsSoManyOfAKindAndCountsTheOthersWhenTheirWhileIsOver) {
  LogLimiter limiter(3, seconds(10));
  int written = 0;
  for (int i = 0; i < 1000; ++i) written += limiter.Ask("reset", kStart).write ? 1 : 0;
  EXPECT_EQ(written, 3);
  EXPECT_TRUE(limiter.Ask("other", kStart + seconds(9)).left_out.empty());
  const auto later = limiter.Ask("other", kStart + seconds(10));
  ASSERT_EQ(later.left_out.size(), 1u);
  EXPECT_EQ(later.left_out[0].first, "reset");
  EXPECT_EQ(later.left_out[0].second, 997);
  EXPECT_TRUE(limiter.Ask("reset", kStart + seconds(11)).write);
}

TEST(LogLimiter, KindsWithoutEndAreOneKind) {
  LogLimiter limiter(1, seconds(10));
  int written = 0;
  for (int i = 0; i < 100000; ++i) {
    written += limiter.Ask("peer " + std::to_string(i), kStart).write ? 1 : 0;
  }
  EXPECT_LT(written, 1000);
  int64_t left_out = 0;
  for (const auto& [kind, lines] : limiter.Ask("late", kStart + seconds(10)).left_out) {
    left_out += lines;
  }
  EXPECT_EQ(written + left_out, 100000);
}

}  // namespace
}  // namespace horopter
