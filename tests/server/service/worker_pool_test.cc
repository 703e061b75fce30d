#include "server/service/worker_pool.h"

#include <gtest/gtest.h>

#include <atomic>
#include <future>

namespace horopter {
namespace {

using Admission = WorkerPool::Admission;

TEST(WorkerPool, RefusesOnceThreadsAndQueueAreFull) {
  std::promise<void> open;
  const std::shared_future<void> gate = open.get_future().share();
  std::atomic<int> done{0};
  {
    WorkerPool pool(2, 3);
    const auto job = [&] {
      gate.wait();
      ++done;
    };
    for (int i = 0; i < 5; ++i) EXPECT_EQ(pool.TrySubmit(job), Admission::kAccepted) << i;
    EXPECT_EQ(pool.TrySubmit(job), Admission::kQueueFull);
    EXPECT_GE(pool.RetryAfterMs(), 100);
    EXPECT_LE(pool.RetryAfterMs(), 30000);
    pool.Close();
    EXPECT_EQ(pool.TrySubmit(job), Admission::kClosed);
    open.set_value();
  }
  EXPECT_EQ(done, 5) << "accepted jobs run also after closing";
}

TEST(WorkerPool, RunsEveryAcceptedJobOnceUnderContention) {
  std::atomic<int> ran{0}, accepted{0};
  {
    WorkerPool pool(3, 10);
    std::vector<std::thread> callers;
    for (int t = 0; t < 4; ++t) {
      callers.emplace_back([&] {
        for (int i = 0; i < 500; ++i) {
          if (pool.TrySubmit([&] { ++ran; }) == Admission::kAccepted) ++accepted;
        }
      });
    }
    for (std::thread& caller : callers) caller.join();
  }
  EXPECT_EQ(ran, accepted);
  EXPECT_GT(ran, 0);
}

}  // namespace
}  // namespace horopter
