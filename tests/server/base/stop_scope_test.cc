#include "server/base/stop_scope.h"

#include <gtest/gtest.h>

#include <atomic>

#include "server/base/parallel_for.h"

namespace horopter {
namespace {

bool Leaves() {
  try {
    LeaveIfStopped();
    return false;
  } catch (const WorkStopped&) {
    return true;
  }
}

TEST(StopScope, TheInnermostScopeOfTheThreadCounts) {
  const StopRequested yes = [] { return true; }, never;
  EXPECT_FALSE(Leaves());
  {
    const StopScope stopped(yes);
    EXPECT_TRUE(Leaves());
    EXPECT_TRUE(IsWorkStopped());
    {
      const StopScope shield(never);
      EXPECT_FALSE(Leaves());
    }
    EXPECT_TRUE(Leaves());
  }
  EXPECT_FALSE(Leaves());
}

// Of a loop on `threads` threads that is stopped at its look number `at`: items that ran.
int ItemsUntilStop(int threads, int at) {
  std::atomic<int> looks{0}, items{0};
  const StopRequested stop = [&] { return ++looks >= at; };
  const StopScope scope(stop);
  bool left = false;
  try {
    ParallelFor(1000, threads, [&](int) { ++items; });
  } catch (const WorkStopped&) {
    left = true;
  }
  EXPECT_TRUE(left);
  return items;
}

TEST(StopScope, ALoopLeavesBeforeItsNextItemOnEveryThread) {
  for (const int threads : {1, 2, 4}) {
    for (const int at : {1, 2, 17, 500}) {
      EXPECT_LT(ItemsUntilStop(threads, at), at + threads) << threads << " threads, look " << at;
    }
  }
}

TEST(StopScope, ALoopWithinALoopLeavesToo) {
  std::atomic<bool> stop{false};
  std::atomic<int> items{0};
  const StopRequested asked = [&] { return stop.load(); };
  const StopScope scope(asked);
  EXPECT_THROW(ParallelFor(4,
                           2,
                           [&](int) {
                             ParallelFor(1000, 2, [&](int) {
                               if (++items == 100) stop = true;
                             });
                           }),
               WorkStopped);
  EXPECT_LT(items, 110);
}

}  // namespace
}  // namespace horopter
