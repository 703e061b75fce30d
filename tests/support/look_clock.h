// A stop flag that measures how long the work computes between two looks at it.
#pragma once

#include <algorithm>
#include <atomic>
#include <cstdint>
#include <ctime>
#include <functional>
#include <mutex>
#include <utility>

namespace horopter {

// Processor time of the calling thread, which other programs on the machine do not change.
inline double ThreadCpuMs() {
  timespec now = {};
  ::clock_gettime(CLOCK_THREAD_CPUTIME_ID, &now);
  return 1e3 * static_cast<double>(now.tv_sec) + 1e-6 * static_cast<double>(now.tv_nsec);
}

// Never stops. Thread-safe.
class LookClock {
 public:
  // above: told of every gap longer than above_ms, on the thread that had it, one at a time.
  explicit LookClock(double above_ms = 0.0, std::function<void(double gap_ms)> above = {})
      : above_ms_(above_ms), above_(std::move(above)) {}

  bool operator()() {
    thread_local int run = 0;
    thread_local double last_ms = 0.0;
    const double now = ThreadCpuMs();
    if (run == run_) Note(now - last_ms);
    run = run_;
    last_ms = now;
    return false;
  }

  // Looks of the work before do not count for the next.
  void Next() { run_ = ++Runs(); }

  int64_t looks() const { return looks_; }
  double longest_ms() const { return longest_ms_; }

 private:
  // Of all clocks: a thread keeps the number of its last one.
  static std::atomic<int>& Runs() {
    static std::atomic<int> runs{0};
    return runs;
  }

  void Note(double gap_ms) {
    ++looks_;
    const std::lock_guard lock(mutex_);
    longest_ms_ = std::max(longest_ms_, gap_ms);
    if (above_ && gap_ms > above_ms_) above_(gap_ms);
  }

  const double above_ms_;
  const std::function<void(double)> above_;
  std::atomic<int> run_{++Runs()};
  std::atomic<int64_t> looks_{0};
  std::mutex mutex_;
  double longest_ms_ = 0.0;  // guarded by mutex_
};

}  // namespace horopter
