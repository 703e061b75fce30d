#include "client/progress.h"

#include <unistd.h>

#include <algorithm>
#include <cstdio>

#include "absl/strings/str_cat.h"
#include "absl/strings/str_format.h"

namespace horopter {

std::string ProgressLine(const std::string& what,
                         int64_t done,
                         int64_t total,
                         const std::string& note) {
  const std::string tail = note.empty() ? "" : absl::StrCat("  ", note);
  if (total <= 0) return absl::StrCat(what, " ", done, tail);
  constexpr int kBarWidth = 24;
  const double share = std::clamp(static_cast<double>(done) / static_cast<double>(total), 0.0, 1.0);
  const auto filled = static_cast<size_t>(share * kBarWidth);
  return absl::StrFormat("%s [%s%s]  %d/%d  %.0f %%%s",
                         what,
                         std::string(filled, '#'),
                         std::string(kBarWidth - filled, '.'),
                         done,
                         total,
                         share * 100.0,
                         tail);
}

Progress::Progress(std::string what, int64_t total)
    : Progress(std::move(what), total, ::isatty(STDERR_FILENO) == 1) {}

Progress::Progress(std::string what, int64_t total, bool terminal)
    : what_(std::move(what)),
      total_(total),
      terminal_(terminal),
      start_(std::chrono::steady_clock::now()),
      last_(start_) {}

Progress::~Progress() {
  Clear();
}

void Progress::Update(int64_t done, const std::string& note) {
  using namespace std::chrono_literals;
  const auto now = std::chrono::steady_clock::now();
  if (!terminal_ || now - start_ < 2s || (drawn_ && now - last_ < 100ms)) return;
  last_ = now;
  drawn_ = true;
  // Carriage return and blanks only: no escape codes, so that dumb terminals can show it.
  std::fprintf(stderr, "\r%-79.79s", ProgressLine(what_, done, total_, note).c_str());
  std::fflush(stderr);
}

Waiting::Waiting(std::string what) {
  if (::isatty(STDERR_FILENO) != 1) return;
  drawer_ = std::thread([this, what = std::move(what)] {
    using namespace std::chrono_literals;
    const auto start = std::chrono::steady_clock::now();
    Progress line(what, 0);
    std::unique_lock lock(mutex_);
    while (!done_.wait_for(lock, 500ms, [this] { return is_done_; })) {
      const auto passed = std::chrono::steady_clock::now() - start;
      line.Update(std::chrono::duration_cast<std::chrono::seconds>(passed).count(), "seconds");
    }
  });
}

Waiting::~Waiting() {
  {
    const std::lock_guard lock(mutex_);
    is_done_ = true;
  }
  done_.notify_all();
  if (drawer_.joinable()) drawer_.join();
}

void Progress::Clear() {
  if (!drawn_) return;
  std::fprintf(stderr, "\r%79s\r", "");
  std::fflush(stderr);
  drawn_ = false;
}

}  // namespace horopter
