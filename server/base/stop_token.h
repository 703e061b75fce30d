// Cancellation seen by the stages: a deadline or a client's cancel, asked between and inside
// stages.
#pragma once

#include <functional>

namespace horopter {

// Returns true once the caller no longer wants the answer. Empty means "never". Must be thread-safe
// and cheap (the stages ask it inside loops of about a millisecond).
using StopRequested = std::function<bool()>;

inline bool IsStopRequested(const StopRequested& stop) {
  return stop && stop();
}

}  // namespace horopter
