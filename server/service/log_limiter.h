// So many lines of a kind in a while, and how many were left out: what a client can bring about by
// the thousand must not fill the disk.
#pragma once

#include <chrono>
#include <cstdint>
#include <map>
#include <mutex>
#include <string>
#include <utility>
#include <vector>

namespace horopter {

// Thread-safe.
class LogLimiter {
 public:
  using Clock = std::chrono::steady_clock;
  struct Verdict {
    bool write = true;
    // Kinds whose while is over, with the lines of theirs that were left out: to be told now.
    std::vector<std::pair<std::string, int64_t>> left_out;
  };

  // `kept` lines of a kind in each `window`.
  explicit LogLimiter(int kept, std::chrono::seconds window = std::chrono::seconds(10))
      : kept_(kept), window_(window) {}

  Verdict Ask(const std::string& kind, Clock::time_point now = Clock::now());

 private:
  struct Window {
    Clock::time_point end;
    int64_t lines = 0;
  };
  const int64_t kept_;
  const std::chrono::seconds window_;
  std::mutex mutex_;
  std::map<std::string, Window> windows_;  // guarded by mutex_
};

}  // namespace horopter
