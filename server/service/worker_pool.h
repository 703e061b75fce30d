// Threads with a bounded queue: admission control of the service.
#pragma once

#include <chrono>
#include <condition_variable>
#include <cstdint>
#include <deque>
#include <functional>
#include <map>
#include <mutex>
#include <optional>
#include <string>
#include <thread>
#include <vector>

namespace horopter {

// Whose job it is and how long its caller waits.
struct JobTraits {
  // Jobs that others wait for come before those of a batch, which also get only half of the queue.
  bool batch = false;
  // Peers take turns; the last quarter of the queue is for peers that have nothing in it.
  std::string peer;
  std::chrono::steady_clock::time_point deadline = std::chrono::steady_clock::time_point::max();
};

// Thread-safe. Every accepted job runs exactly once, also when the pool is closed, unless it is
// withdrawn before; of one peer in order of submission.
class WorkerPool {
 public:
  enum class Admission {
    kAccepted,
    // No place in it, or, of a pool with a bound of waiting, the job would wait longer.
    kQueueFull,
    kClosed,
    // By the time of the last jobs its turn would come after its deadline.
    kTooLate,
  };
  struct Submission {
    Admission admission = Admission::kQueueFull;
    uint64_t ticket = 0;  // for Withdraw
  };

  // `queue_limit`: jobs that may wait while all threads are busy; 0 lets a job in only when a
  // thread is free. `max_wait_jobs`: by the mean time of a job, how long one may have to wait; 0:
  // as long as the queue is.
  WorkerPool(int threads, int queue_limit, double max_wait_jobs = 0.0);
  // Closes, runs what is queued, joins.
  ~WorkerPool();
  WorkerPool(const WorkerPool&) = delete;
  WorkerPool& operator=(const WorkerPool&) = delete;

  // Whether such a job would find no place now.
  bool IsFull(const JobTraits& traits) const;

  // A job must not throw.
  Submission TrySubmit(std::function<void()> job, const JobTraits& traits = {});

  // Takes a job that has not begun out of the queue and destroys it. False: it has begun, or is
  // done.
  bool Withdraw(uint64_t ticket);

  // From now on nothing is accepted.
  void Close();
  bool IsClosed() const;

  // Time after which a refused caller should try again: mean job time times the jobs ahead, 100 ms
  // to 30 s.
  int RetryAfterMs() const;

  struct Load {
    int running = 0;
    int waiting = 0;
  };
  Load load() const;

 private:
  struct Job {
    uint64_t ticket = 0;
    std::function<void()> run;
    JobTraits traits;
  };

  using Clock = std::chrono::steady_clock;

  void Run(size_t thread);
  // All need mutex_.
  int QueueLimitOf(const JobTraits& traits) const;
  bool HasPlace(const JobTraits& traits) const;
  bool IsTooLate(const JobTraits& traits) const;
  double ExpectedWaitSeconds(bool batch) const;
  Job TakeNext();

  const int queue_limit_;
  const double max_wait_jobs_;
  mutable std::mutex mutex_;
  std::condition_variable wake_;
  std::deque<Job> queue_;  // guarded by mutex_, as all below
  bool closed_ = false;
  int running_ = 0;
  std::vector<std::optional<Clock::time_point>> begun_;  // the job of each thread
  uint64_t next_ticket_ = 1;
  uint64_t turns_ = 0;
  std::map<std::string, uint64_t> last_turn_;  // of the peers served lately
  bool measured_ = false;
  double mean_job_seconds_ = 1.0;
  std::vector<std::thread> threads_;
};

}  // namespace horopter
