#include "server/service/worker_pool.h"

#include <algorithm>
#include <chrono>
#include <utility>

namespace horopter {

WorkerPool::WorkerPool(int threads, int queue_limit) : queue_limit_(queue_limit) {
  for (int i = 0; i < threads; ++i) threads_.emplace_back([this] { Run(); });
}

WorkerPool::~WorkerPool() {
  Close();
  for (std::thread& thread : threads_) thread.join();
}

WorkerPool::Admission WorkerPool::TrySubmit(std::function<void()> job) {
  {
    const std::lock_guard lock(mutex_);
    if (closed_) return Admission::kClosed;
    const int ahead = running_ + static_cast<int>(queue_.size());
    if (ahead >= static_cast<int>(threads_.size()) + queue_limit_) return Admission::kQueueFull;
    queue_.push_back(std::move(job));
  }
  wake_.notify_one();
  return Admission::kAccepted;
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
      static_cast<double>(running_ + queue_.size()) / static_cast<double>(threads_.size());
  return static_cast<int>(std::clamp(1000.0 * mean_job_seconds_ * jobs_ahead, 100.0, 30000.0));
}

void WorkerPool::Run() {
  constexpr double kMeanWeight = 0.2;  // of the newest job
  std::unique_lock lock(mutex_);
  while (true) {
    wake_.wait(lock, [this] { return closed_ || !queue_.empty(); });
    if (queue_.empty()) return;
    std::function<void()> job = std::move(queue_.front());
    queue_.pop_front();
    ++running_;
    lock.unlock();
    const auto start = std::chrono::steady_clock::now();
    job();
    job = nullptr;
    const std::chrono::duration<double> elapsed = std::chrono::steady_clock::now() - start;
    lock.lock();
    --running_;
    mean_job_seconds_ += kMeanWeight * (elapsed.count() - mean_job_seconds_);
  }
}

}  // namespace horopter
