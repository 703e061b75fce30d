// A process of one core: its own program, since the pool is sized once.
#include <gtest/gtest.h>

#include <set>
#include <stdexcept>
#include <thread>

#include "server/base/parallel_for.h"

namespace horopter {
namespace {

TEST(EmptyPool, TheCallerDoesAllAndTheSizeIsFixedByTheFirstLoop) {
  EXPECT_TRUE(SetPoolThreads(3));
  EXPECT_TRUE(SetPoolThreads(0));
  std::set<std::thread::id> threads;
  int sum = 0;
  ParallelFor(100, 4, [&](int i) {
    threads.insert(std::this_thread::get_id());
    ParallelFor(2, 4, [&](int k) { sum += i + k; });
  });
  EXPECT_EQ(sum, 2 * 4950 + 100);
  EXPECT_EQ(threads, std::set{std::this_thread::get_id()});
  EXPECT_THROW(ParallelFor(2, 4, [](int) { throw std::runtime_error("no"); }), std::runtime_error);
  EXPECT_FALSE(SetPoolThreads(3));
}

}  // namespace
}  // namespace horopter
