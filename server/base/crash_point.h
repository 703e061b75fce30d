// Named places where a test may kill the process, to prove that nothing is lost there.
#pragma once

#include <atomic>

namespace horopter {

// Set by tests only, before other threads exist. Called with the name of every point passed.
using CrashHook = void (*)(const char* point);
inline std::atomic<CrashHook> crash_hook{nullptr};

inline void CrashPoint(const char* point) {
  if (const CrashHook hook = crash_hook.load(std::memory_order_relaxed); hook != nullptr) {
    hook(point);
  }
}

}  // namespace horopter
