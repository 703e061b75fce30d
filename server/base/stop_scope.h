// Cancellation of computing that has no result until it is done: its loops leave at once, by an
// exception that whoever opened the scope turns into CANCELLED.
#pragma once

#include "server/base/stop_token.h"

namespace horopter {

// Thrown by LeaveIfStopped; no std::exception, so that nothing below the scope mistakes it for a
// library's. StatusOfException (server/pipeline) makes CANCELLED of it.
struct WorkStopped {};

// As long as it lives, what this thread computes, and ParallelFor for it on others, leaves soon
// after `stop` says so. Scopes nest, the inner one counts; one of an empty flag shields work that
// must not be left half done. The flag must outlive the scope.
class StopScope {
 public:
  explicit StopScope(const StopRequested& stop);
  ~StopScope();
  StopScope(const StopScope&) = delete;
  StopScope& operator=(const StopScope&) = delete;

  // Of this thread; null: none. For ParallelFor, which hands it to its helpers.
  static const StopRequested* Current();
  static void SetCurrent(const StopRequested* stop);

 private:
  const StopRequested* const outer_;
};

// Throws WorkStopped when the work of this thread is to stop. ParallelFor asks before each item;
// loops of their own that take more than some 10 ms ask at about each millisecond. Costs 50 ns.
void LeaveIfStopped();

// For loops whose steps are too short to ask at each: asks at every `steps`-th.
class StopPacer {
 public:
  explicit StopPacer(int steps) : steps_(steps) {}
  void Step() {
    if (++done_ < steps_) return;
    done_ = 0;
    LeaveIfStopped();
  }

 private:
  const int steps_;
  int done_ = 0;
};

// LeaveIfStopped as an answer, for callbacks of libraries that exceptions must not pass.
bool IsWorkStopped();

}  // namespace horopter
