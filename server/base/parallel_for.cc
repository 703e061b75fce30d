#include "server/base/parallel_for.h"

#include <algorithm>
#include <atomic>
#include <condition_variable>
#include <exception>
#include <mutex>
#include <system_error>
#include <thread>
#include <vector>

#include "server/base/stop_scope.h"

namespace horopter {
namespace {

// Of the loop or request this thread works for; null outside.
thread_local CoreBudget* current_budget = nullptr;

}  // namespace

// A worker sleeps only while no loop can take it. Whatever lets a loop take one more wakes one: a
// new loop, or a worker that leaves a loop and then looks for the next itself.
class LoopPool {
 public:
  // Lives as long as the process: its threads may still wait when main returns.
  static LoopPool& Get() {
    static LoopPool* pool = new LoopPool;
    return *pool;
  }

  bool SetThreads(int threads) {
    const std::lock_guard lock(mutex_);
    if (started_) return false;
    threads_ = std::max(0, threads);
    return true;
  }

  // wanted: helpers, at least one.
  void Run(int count, int wanted, absl::FunctionRef<void(int)> body) {
    Loop loop{count, body, current_budget, StopScope::Current(), wanted};
    {
      const std::lock_guard lock(mutex_);
      Start();
      loops_.push_back(&loop);
      for (int i = 0; i < std::min(wanted, loop.budget->free_); ++i) wake_.notify_one();
    }
    Work(loop);
    {
      std::unique_lock lock(mutex_);
      std::erase(loops_, &loop);
      loop.done.wait(lock, [&] { return loop.helpers == 0; });
    }
    if (loop.thrown) std::rethrow_exception(loop.thrown);
  }

 private:
  struct Loop {
    const int count;
    const absl::FunctionRef<void(int)> body;
    CoreBudget* const budget;
    const StopRequested* const stop;
    int wanted;       // helpers that may still join; guarded by mutex_, as all below but next
    int helpers = 0;  // at work
    std::exception_ptr thrown = nullptr;
    std::condition_variable done = {};
    std::atomic<int> next{0};
  };

  LoopPool() : threads_(static_cast<int>(std::thread::hardware_concurrency()) - 1) {}

  // mutex_ is held.
  void Start() {
    if (started_) return;
    started_ = true;
    try {
      for (int i = 0; i < threads_; ++i) std::thread([this] { Serve(); }).detach();
    } catch (const std::system_error&) {
      // The loops make do with what there is.
    }
  }

  void Work(Loop& loop) {
    try {
      for (int i = loop.next++; i < loop.count; i = loop.next++) {
        LeaveIfStopped();
        loop.body(i);
      }
    } catch (...) {
      loop.next = loop.count;
      const std::lock_guard lock(mutex_);
      if (!loop.thrown) loop.thrown = std::current_exception();
    }
  }

  // The oldest loop that can take one more, or null. mutex_ is held.
  Loop* Next() const {
    const auto found = std::find_if(loops_.begin(), loops_.end(), [](const Loop* loop) {
      return loop->wanted > 0 && loop->budget->free_ > 0 && loop->next < loop->count;
    });
    return found == loops_.end() ? nullptr : *found;
  }

  void Serve() {
    std::unique_lock lock(mutex_);
    while (true) {
      Loop* loop = nullptr;
      wake_.wait(lock, [&] { return (loop = Next()) != nullptr; });
      --loop->wanted;
      ++loop->helpers;
      --loop->budget->free_;
      lock.unlock();
      current_budget = loop->budget;
      StopScope::SetCurrent(loop->stop);
      Work(*loop);
      StopScope::SetCurrent(nullptr);
      current_budget = nullptr;
      lock.lock();
      ++loop->budget->free_;
      // Under the lock: the loop is gone as soon as its owner sees this.
      if (--loop->helpers == 0) loop->done.notify_one();
    }
  }

  std::mutex mutex_;
  std::condition_variable wake_;
  std::vector<Loop*> loops_;  // that may have items left; guarded by mutex_, as all below
  int threads_;
  bool started_ = false;
};

CoreBudget::CoreBudget(int cores)
    : free_(std::max(0, cores - 1)), outermost_(current_budget == nullptr) {
  if (outermost_) current_budget = this;
}

CoreBudget::~CoreBudget() {
  if (outermost_) current_budget = nullptr;
}

void ParallelFor(int count, int threads, absl::FunctionRef<void(int)> body) {
  const CoreBudget budget(threads);
  const int helpers = std::min(threads, count) - 1;
  if (helpers > 0) {
    LoopPool::Get().Run(count, helpers, body);
    return;
  }
  for (int i = 0; i < count; ++i) {
    LeaveIfStopped();
    body(i);
  }
}

bool SetPoolThreads(int threads) {
  return LoopPool::Get().SetThreads(threads);
}

}  // namespace horopter
