#include "client/load/load_run.h"

#include <sys/resource.h>

#include <algorithm>
#include <chrono>
#include <cmath>
#include <condition_variable>
#include <memory>
#include <mutex>

#include "absl/strings/str_cat.h"
#include "server/base/status_macros.h"

namespace horopter {
namespace {

using Clock = std::chrono::steady_clock;
using std::chrono::duration;
using std::chrono::duration_cast;

double CpuSeconds() {
  rusage usage{};
  ::getrusage(RUSAGE_SELF, &usage);
  const auto seconds = [](const timeval& t) {
    return static_cast<double>(t.tv_sec) + 1e-6 * static_cast<double>(t.tv_usec);
  };
  return seconds(usage.ru_utime) + seconds(usage.ru_stime);
}

// Shared with the callbacks of requests that are under way.
struct Board {
  std::mutex mutex;
  std::condition_variable changed;
  std::vector<LoadSample> samples;  // guarded by mutex, as all below
  int in_flight = 0;
  bool awaited = false;  // the sender waits for answers, not for the time of the next request
  int unavailable_in_a_row = 0;
  int64_t done = 0, failed = 0;
};

class Runner {
 public:
  Runner(const LoadOptions& options, int items, const LoadTarget& target, const LoadHooks& hooks)
      : options_(options), target_(target), hooks_(hooks), order_(items, options.seed) {}

  LoadRun Run() {
    WarmUp();
    if (!Stopped()) {
      board_ = std::make_shared<Board>();
      start_ = Clock::now();
      const double cpu = CpuSeconds();
      options_.rate_hz > 0.0 ? OpenLoop() : ClosedLoop(options_.requests, options_.duration_s);
      Drain();
      run_.cpu_s = CpuSeconds() - cpu;
      run_.elapsed_s = Now();
      const std::lock_guard lock(board_->mutex);
      run_.samples = std::move(board_->samples);
    }
    return std::move(run_);
  }

 private:
  double Now() const { return duration<double>(Clock::now() - start_).count(); }

  void WarmUp() {
    board_ = std::make_shared<Board>();
    start_ = Clock::now();
    if (options_.warmup > 0) ClosedLoop(options_.warmup, 0.0);
    Drain();
  }

  bool Stopped() const { return run_.interrupted || run_.server_gone; }

  // Also true: nothing may be sent any more. The board must be locked.
  bool MustStop() {
    run_.interrupted = run_.interrupted || (hooks_.interrupted && hooks_.interrupted());
    run_.server_gone = run_.server_gone || board_->unavailable_in_a_row >= options_.give_up_after;
    return Stopped();
  }

  void Report(std::unique_lock<std::mutex>& lock) {
    if (!hooks_.report) return;
    const int64_t done = board_->done, failed = board_->failed;
    lock.unlock();
    hooks_.report(done, failed);
    lock.lock();
  }

  // Waits until `ready` or `until`; false when the run must stop.
  // for_answers: what makes it ready is an answer; otherwise none wakes this thread.
  template <typename Ready>
  bool Await(std::unique_lock<std::mutex>& lock,
             Clock::time_point until,
             const Ready& ready,
             bool for_answers = true) {
    board_->awaited = for_answers;
    while (!MustStop() && !ready()) {
      const auto slice = Clock::now() + std::chrono::milliseconds(100);
      board_->changed.wait_until(lock, std::min(until, slice));
      if (Clock::now() >= until) return !MustStop();
      if (Clock::now() >= slice) Report(lock);
    }
    return !Stopped();
  }

  void Send(double due_s) {
    const int item = order_.Next();
    size_t index;
    {
      const std::lock_guard lock(board_->mutex);
      index = board_->samples.size();
      LoadSample& sample = board_->samples.emplace_back();
      sample.item = item;
      sample.sent_s = Now();
      sample.due_s = due_s < 0.0 ? sample.sent_s : due_s;
      ++board_->in_flight;
    }
    target_.start(item, [board = board_, start = start_, index](LoadReply reply) {
      const auto done = reply.arrived == Clock::time_point{} ? Clock::now() : reply.arrived;
      const double done_s = duration<double>(done - start).count();
      // Under the lock: the waiting thread must not miss it.
      const std::lock_guard lock(board->mutex);
      LoadSample& sample = board->samples[index];
      sample.done_s = done_s;
      const bool gone = reply.code == absl::StatusCode::kUnavailable;
      board->unavailable_in_a_row = gone ? board->unavailable_in_a_row + 1 : 0;
      board->failed += reply.code == absl::StatusCode::kOk ? 0 : 1;
      sample.reply = std::move(reply);
      ++board->done;
      --board->in_flight;
      if (board->awaited) board->changed.notify_all();
    });
  }

  void ClosedLoop(int64_t requests, double seconds) {
    for (int64_t sent = 0; requests == 0 || sent < requests; ++sent) {
      {
        std::unique_lock lock(board_->mutex);
        const auto free = [&] { return board_->in_flight < options_.concurrency; };
        if (!Await(lock, Clock::time_point::max(), free)) return;
      }
      if (seconds > 0.0 && Now() >= seconds) return;
      Send(-1.0);
    }
  }

  void OpenLoop() {
    Arrivals arrivals({options_.rate_hz,
                       options_.rate_end_hz,
                       options_.duration_s,
                       options_.poisson,
                       options_.seed});
    for (int64_t sent = 0; options_.requests == 0 || sent < options_.requests; ++sent) {
      const double due_s = arrivals.Next();
      if (options_.duration_s > 0.0 && due_s >= options_.duration_s) return;
      const auto due = start_ + duration_cast<Clock::duration>(duration<double>(due_s));
      {
        std::unique_lock lock(board_->mutex);
        if (!Await(
                lock, due, [&] { return Clock::now() >= due; }, false))
          return;
        const auto room = [&] { return board_->in_flight < options_.max_in_flight; };
        if (!Await(lock, Clock::time_point::max(), room)) return;
      }
      Send(due_s);
    }
  }

  // Waits for what is under way; an interrupted run does not wait.
  void Drain() {
    std::unique_lock lock(board_->mutex);
    const auto empty = [&] { return board_->in_flight == 0; };
    const auto until = Clock::now() + duration_cast<Clock::duration>(
                                          duration<double>(Stopped() ? 0.0 : options_.drain_s));
    Await(lock, until, empty);
    if (empty()) return;
    lock.unlock();
    if (target_.cancel_all) target_.cancel_all();
    lock.lock();
    board_->awaited = true;
    board_->changed.wait(lock, empty);
  }

  LoadOptions options_;
  const LoadTarget& target_;
  const LoadHooks& hooks_;
  ItemOrder order_;
  std::shared_ptr<Board> board_;
  Clock::time_point start_;
  LoadRun run_;
};

absl::Status Refuse(const char* option, const char* what) {
  return absl::InvalidArgumentError(absl::StrCat(option, ": ", what));
}

}  // namespace

absl::Status Validate(const LoadOptions& options) {
  constexpr double kMaxRateHz = 1e5;
  if (!(options.rate_hz >= 0.0 && options.rate_hz <= kMaxRateHz)) {
    return Refuse("rate", "must be 0 to 100000 per second");
  }
  if (!(options.rate_end_hz >= 0.0 && options.rate_end_hz <= kMaxRateHz)) {
    return Refuse("end of the ramp", "must be 0 to 100000 per second");
  }
  if (options.rate_end_hz > 0.0 && !(options.rate_hz > 0.0 && options.duration_s > 0.0)) {
    return Refuse("ramp", "needs a rate and a duration");
  }
  if (options.concurrency < 1) return Refuse("concurrency", "must be at least 1");
  if (options.max_in_flight < 1) return Refuse("max in flight", "must be at least 1");
  if (options.warmup < 0) return Refuse("warmup", "must not be negative");
  if (!(options.duration_s >= 0.0) || !std::isfinite(options.duration_s) || options.requests < 0) {
    return Refuse("duration and requests", "must not be negative");
  }
  if (options.duration_s == 0.0 && options.requests == 0) {
    return Refuse("duration", "give a duration or a number of requests");
  }
  return absl::OkStatus();
}

absl::StatusOr<LoadRun> RunLoad(const LoadOptions& options,
                                int items,
                                const LoadTarget& target,
                                const LoadHooks& hooks) {
  HOROPTER_RETURN_IF_ERROR(Validate(options));
  if (items < 1) return absl::InvalidArgumentError("there is nothing to send");
  return Runner(options, items, target, hooks).Run();
}

}  // namespace horopter
