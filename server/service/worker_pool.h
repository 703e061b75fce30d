// Threads with a bounded queue: admission control of the service.
#pragma once

#include <condition_variable>
#include <deque>
#include <functional>
#include <mutex>
#include <thread>
#include <vector>

namespace horopter {

// Thread-safe. Every accepted job runs exactly once, in order of submission, also when the pool is
// closed.
class WorkerPool {
 public:
  enum class Admission { kAccepted, kQueueFull, kClosed };

  // `queue_limit`: jobs that may wait while all threads are busy; 0 lets a job in only when a
  // thread is free.
  WorkerPool(int threads, int queue_limit);
  // Closes, runs what is queued, joins.
  ~WorkerPool();
  WorkerPool(const WorkerPool&) = delete;
  WorkerPool& operator=(const WorkerPool&) = delete;

  Admission TrySubmit(std::function<void()> job);

  // From now on nothing is accepted.
  void Close();

  // Time after which a refused caller should try again: mean job time times the jobs ahead, 100 ms
  // to 30 s.
  int RetryAfterMs() const;

 private:
  void Run();

  const int queue_limit_;
  mutable std::mutex mutex_;
  std::condition_variable wake_;
  std::deque<std::function<void()>> queue_;  // guarded by mutex_, as all below
  bool closed_ = false;
  int running_ = 0;
  double mean_job_seconds_ = 1.0;
  std::vector<std::thread> threads_;
};

}  // namespace horopter
