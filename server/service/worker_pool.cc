#include "server/service/worker_pool.h"

#include <algorithm>
#include <cmath>
#include <tuple>
#include <utility>

namespace horopter {
namespace {

// Peers whose turns are remembered; forgetting them all costs one round of fairness.
constexpr size_t kMaxPeers = 1000;

}  // namespace

WorkerPool::WorkerPool(int threads, int queue_limit, double max_wait_jobs)
    : queue_limit_(queue_limit),
      max_wait_jobs_(max_wait_jobs),
      begun_(static_cast<size_t>(threads)) {
  for (size_t i = 0; i < begun_.size(); ++i) threads_.emplace_back([this, i] { Run(i); });
}

WorkerPool::~WorkerPool() {
  Close();
  for (std::thread& thread : threads_) thread.join();
}

int WorkerPool::QueueLimitOf(const JobTraits& traits) const {
  if (traits.batch) return queue_limit_ - queue_limit_ / 2;
  const bool waits = std::any_of(
      queue_.begin(), queue_.end(), [&](const Job& job) { return job.traits.peer == traits.peer; });
  return waits ? queue_limit_ - queue_limit_ / 4 : queue_limit_;
}

bool WorkerPool::HasPlace(const JobTraits& traits) const {
  const int ahead = running_ + static_cast<int>(queue_.size());
  if (ahead >= static_cast<int>(begun_.size()) + QueueLimitOf(traits)) return false;
  return max_wait_jobs_ <= 0.0 || !measured_ ||
         ExpectedWaitSeconds(traits.batch) <= max_wait_jobs_ * mean_job_seconds_;
}

bool WorkerPool::IsFull(const JobTraits& traits) const {
  const std::lock_guard lock(mutex_);
  return !closed_ && !HasPlace(traits);
}

bool WorkerPool::IsTooLate(const JobTraits& traits) const {
  if (!measured_ || traits.deadline == Clock::time_point::max()) return false;
  const std::chrono::duration<double> left = traits.deadline - Clock::now();
  return ExpectedWaitSeconds(traits.batch) > left.count();
}

double WorkerPool::ExpectedWaitSeconds(bool batch) const {
  std::vector<double> free_in;
  const auto now = Clock::now();
  for (const auto& begun : begun_) {
    // A job that has taken longer than the mean is believed to take as long again beyond it.
    const std::chrono::duration<double> elapsed = begun ? now - *begun : Clock::duration::zero();
    free_in.push_back(begun ? std::abs(mean_job_seconds_ - elapsed.count()) : 0.0);
  }
  const auto ahead = std::count_if(
      queue_.begin(), queue_.end(), [&](const Job& job) { return batch || !job.traits.batch; });
  for (auto i = ahead; i > 0; --i)
    *std::min_element(free_in.begin(), free_in.end()) += mean_job_seconds_;
  return *std::min_element(free_in.begin(), free_in.end());
}

WorkerPool::Submission WorkerPool::TrySubmit(std::function<void()> job, const JobTraits& traits) {
  Submission submission;
  {
    const std::lock_guard lock(mutex_);
    if (closed_) return {Admission::kClosed, 0};
    if (!HasPlace(traits)) return {Admission::kQueueFull, 0};
    if (IsTooLate(traits)) return {Admission::kTooLate, 0};
    submission = {Admission::kAccepted, next_ticket_++};
    queue_.push_back({submission.ticket, std::move(job), traits});
  }
  wake_.notify_one();
  return submission;
}

bool WorkerPool::Withdraw(uint64_t ticket) {
  Job withdrawn;  // destroyed outside of the lock
  const std::lock_guard lock(mutex_);
  const auto found = std::find_if(
      queue_.begin(), queue_.end(), [&](const Job& job) { return job.ticket == ticket; });
  if (found == queue_.end()) return false;
  withdrawn = std::move(*found);
  queue_.erase(found);
  return true;
}

bool WorkerPool::IsClosed() const {
  const std::lock_guard lock(mutex_);
  return closed_;
}

void WorkerPool::Close() {
  {
    const std::lock_guard lock(mutex_);
    closed_ = true;
  }
  wake_.notify_all();
}

int WorkerPool::RetryAfterMs() const {
  const std::lock_guard lock(mutex_);
  const double jobs_ahead =
      static_cast<double>(running_ + queue_.size()) / static_cast<double>(begun_.size());
  return static_cast<int>(std::clamp(1000.0 * mean_job_seconds_ * jobs_ahead, 100.0, 30000.0));
}

WorkerPool::Load WorkerPool::load() const {
  const std::lock_guard lock(mutex_);
  return {running_, static_cast<int>(queue_.size())};
}

WorkerPool::Job WorkerPool::TakeNext() {
  const auto turn = [&](const Job& job) {
    const auto known = last_turn_.find(job.traits.peer);
    return std::tuple(job.traits.batch, known == last_turn_.end() ? 0 : known->second, job.ticket);
  };
  const auto next = std::min_element(
      queue_.begin(), queue_.end(), [&](const Job& a, const Job& b) { return turn(a) < turn(b); });
  Job job = std::move(*next);
  queue_.erase(next);
  try {
    if (last_turn_.size() >= kMaxPeers) last_turn_.clear();
    last_turn_[job.traits.peer] = ++turns_;
  } catch (...) {
    // Out of memory: this turn is not remembered.
  }
  return job;
}

void WorkerPool::Run(size_t thread) {
  constexpr double kMeanWeight = 0.2;  // of the newest job
  std::unique_lock lock(mutex_);
  while (true) {
    wake_.wait(lock, [this] { return closed_ || !queue_.empty(); });
    if (queue_.empty()) return;
    Job job = TakeNext();
    ++running_;
    const auto start = Clock::now();
    begun_[thread] = start;
    lock.unlock();
    job.run();
    job = {};
    const std::chrono::duration<double> elapsed = Clock::now() - start;
    lock.lock();
    --running_;
    begun_[thread].reset();
    mean_job_seconds_ += (measured_ ? kMeanWeight : 1.0) * (elapsed.count() - mean_job_seconds_);
    measured_ = true;
  }
}

}  // namespace horopter
