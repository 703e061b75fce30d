#include "server/service/worker_pool.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <atomic>
#include <chrono>
#include <future>
#include <memory>
#include <string>
#include <thread>
#include <vector>

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
    for (int i = 0; i < 5; ++i) EXPECT_EQ(pool.TrySubmit(job).admission, Admission::kAccepted) << i;
    EXPECT_EQ(pool.TrySubmit(job).admission, Admission::kQueueFull);
    EXPECT_GE(pool.RetryAfterMs(), 100);
    EXPECT_LE(pool.RetryAfterMs(), 30000);
    pool.Close();
    EXPECT_EQ(pool.TrySubmit(job).admission, Admission::kClosed);
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
          if (pool.TrySubmit([&] { ++ran; }).admission == Admission::kAccepted) ++accepted;
        }
      });
    }
    for (std::thread& caller : callers) caller.join();
  }
  EXPECT_EQ(ran, accepted);
  EXPECT_GT(ran, 0);
}

// One thread that waits for the gate, and the order in which the jobs behind it ran.
struct Held {
  std::promise<void> open;
  std::vector<std::string> ran;
  WorkerPool pool;

  explicit Held(int queue) : pool(1, queue) {
    std::promise<void> begun;
    pool.TrySubmit([&, gate = open.get_future().share()] {
      begun.set_value();
      gate.wait();
    });
    begun.get_future().wait();
  }
  WorkerPool::Submission Submit(const std::string& name, JobTraits traits = {}) {
    if (traits.peer.empty()) traits.peer = name.substr(0, 1);
    return pool.TrySubmit([this, name] { ran.push_back(name); }, traits);
  }
  std::vector<std::string> Finish() {
    pool.Close();
    open.set_value();
    while (pool.load().running + pool.load().waiting > 0) std::this_thread::yield();
    return ran;
  }
};

TEST(WorkerPool, AWithdrawnJobGivesItsPlaceBackAtOnceAndNeverRuns) {
  Held held(1);
  const auto held_by_job = std::make_shared<int>(0);
  const auto first = held.pool.TrySubmit([held_by_job] { FAIL(); });
  ASSERT_EQ(first.admission, Admission::kAccepted);
  EXPECT_EQ(held.Submit("b").admission, Admission::kQueueFull);
  EXPECT_TRUE(held.pool.Withdraw(first.ticket));
  EXPECT_EQ(held_by_job.use_count(), 1) << "what the job held is given back";
  EXPECT_FALSE(held.pool.Withdraw(first.ticket));
  EXPECT_EQ(held.Submit("b").admission, Admission::kAccepted);
  EXPECT_THAT(held.Finish(), testing::ElementsAre("b"));
}

TEST(WorkerPool, PeersTakeTurnsAndBatchesWait) {
  Held held(12);
  JobTraits batch;
  batch.batch = true;
  held.Submit("z1", batch);
  for (const char* name : {"a1", "a2", "a3", "b1", "c1", "b2"}) held.Submit(name);
  EXPECT_THAT(held.Finish(), testing::ElementsAre("a1", "b1", "c1", "a2", "b2", "a3", "z1"));
}

TEST(WorkerPool, NoPeerAndNoBatchTakesTheWholeQueue) {
  Held held(8);
  JobTraits batch;
  batch.batch = true;
  for (int i = 0; i < 4; ++i) EXPECT_EQ(held.Submit("z", batch).admission, Admission::kAccepted);
  EXPECT_EQ(held.Submit("y", batch).admission, Admission::kQueueFull);
  for (int i = 0; i < 2; ++i) EXPECT_EQ(held.Submit("a").admission, Admission::kAccepted);
  EXPECT_EQ(held.Submit("a").admission, Admission::kQueueFull);
  EXPECT_EQ(held.Submit("b").admission, Admission::kAccepted);
  held.Finish();
}

TEST(WorkerPool, AJobWhoseTurnWouldComeAfterItsDeadlineIsRefused) {
  WorkerPool pool(1, 10);
  // Teaches the pool that jobs take 50 ms.
  std::promise<void> taught;
  pool.TrySubmit([] { std::this_thread::sleep_for(std::chrono::milliseconds(50)); });
  pool.TrySubmit([&] {
    std::this_thread::sleep_for(std::chrono::milliseconds(50));
    taught.set_value();
  });
  taught.get_future().wait();
  while (pool.load().running > 0) std::this_thread::yield();
  std::promise<void> open, begun;
  pool.TrySubmit([&] {
    begun.set_value();
    open.get_future().wait();
  });
  begun.get_future().wait();
  for (int i = 0; i < 4; ++i) pool.TrySubmit([] {});
  const auto now = std::chrono::steady_clock::now();
  JobTraits patient, hasty;
  hasty.deadline = now + std::chrono::milliseconds(20);
  patient.deadline = now + std::chrono::hours(1);
  EXPECT_EQ(pool.TrySubmit([] {}, hasty).admission, Admission::kTooLate);
  EXPECT_EQ(pool.TrySubmit([] {}, patient).admission, Admission::kAccepted);
  open.set_value();
}

TEST(WorkerPool, AJobThatWouldWaitLongerThanItMayIsRefusedThoughTheQueueHasPlaces) {
  WorkerPool pool(2, 10, /*max_wait_jobs=*/0.5);
  // Teaches the pool that jobs take 400 ms.
  const auto slow = [] { std::this_thread::sleep_for(std::chrono::milliseconds(400)); };
  EXPECT_EQ(pool.TrySubmit(slow).admission, Admission::kAccepted);
  while (pool.load().running + pool.load().waiting > 0) std::this_thread::yield();
  std::promise<void> open;
  const std::shared_future<void> gate = open.get_future().share();
  for (int i = 0; i < 2; ++i) {
    EXPECT_EQ(pool.TrySubmit([gate] { gate.wait(); }).admission, Admission::kAccepted);
  }
  EXPECT_TRUE(pool.IsFull({})) << "both threads have just begun";
  EXPECT_EQ(pool.TrySubmit([] {}).admission, Admission::kQueueFull);
  std::this_thread::sleep_for(std::chrono::milliseconds(300));
  EXPECT_FALSE(pool.IsFull({})) << "both are nearly done, by what is known";
  EXPECT_EQ(pool.TrySubmit([] {}).admission, Admission::kAccepted);
  EXPECT_EQ(pool.TrySubmit([] {}).admission, Admission::kAccepted) << "one for each thread";
  EXPECT_EQ(pool.TrySubmit([] {}).admission, Admission::kQueueFull);
  open.set_value();
}

}  // namespace
}  // namespace horopter
