#include "server/service/log_limiter.h"

namespace horopter {
namespace {

// Kinds hold what clients send: peers and the like. Beyond, all others are one kind.
constexpr size_t kMaxKinds = 256;

}  // namespace

LogLimiter::Verdict LogLimiter::Ask(const std::string& kind, Clock::time_point now) {
  const std::lock_guard lock(mutex_);
  Verdict verdict;
  for (auto w = windows_.begin(); w != windows_.end();) {
    if (now < w->second.end) {
      ++w;
      continue;
    }
    if (w->second.lines > kept_) verdict.left_out.emplace_back(w->first, w->second.lines - kept_);
    w = windows_.erase(w);
  }
  const bool known = windows_.size() < kMaxKinds || windows_.count(kind) > 0;
  Window& window =
      windows_.try_emplace(known ? kind : "others", Window{now + window_, 0}).first->second;
  verdict.write = ++window.lines <= kept_;
  return verdict;
}

}  // namespace horopter
