// A forked writer that says through a pipe which writes were acknowledged to it, and is killed.
#pragma once

#include <gtest/gtest.h>
#include <signal.h>
#include <sys/wait.h>
#include <unistd.h>

#include <functional>
#include <optional>

namespace horopter {

// Exit codes of a writer that was not killed.
inline constexpr int kWriterCannotOpen = 3;
inline constexpr int kWriterRefused = 4;
inline constexpr int kWriterUnheard = 5;
inline constexpr int kWriterFinished = 6;

class KilledWriter {
 public:
  using Acknowledge = std::function<void(int write)>;

  // Runs body(acknowledge) in a child, which ends with body's result as exit code.
  explicit KilledWriter(const std::function<int(const Acknowledge&)>& body) {
    int ends[2];
    if (pipe(ends) != 0) return;
    pid_ = fork();
    if (pid_ == 0) {
      close(ends[0]);
      const int out = ends[1];
      _exit(body([out](int number) {
        if (write(out, &number, sizeof(number)) != sizeof(number)) _exit(kWriterUnheard);
      }));
    }
    close(ends[1]);
    in_ = ends[0];
  }
  KilledWriter(const KilledWriter&) = delete;
  KilledWriter& operator=(const KilledWriter&) = delete;
  ~KilledWriter() {
    if (pid_ > 0) kill(pid_, SIGKILL);
    AwaitKilled();
  }

  // The next acknowledged write; nothing when the child is gone.
  std::optional<int> Next() {
    int number = 0;
    if (read(in_, &number, sizeof(number)) != static_cast<ssize_t>(sizeof(number))) {
      return std::nullopt;
    }
    return number;
  }

  void Kill() { kill(pid_, SIGKILL); }

  // Waits for the end; success when it was a kill.
  testing::AssertionResult AwaitKilled() {
    if (pid_ <= 0) return testing::AssertionFailure() << "no child";
    int status = 0;
    const pid_t waited = waitpid(pid_, &status, 0);
    close(in_);
    pid_ = -1;
    if (waited < 0) return testing::AssertionFailure() << "waitpid failed";
    if (WIFSIGNALED(status)) return testing::AssertionSuccess();
    return testing::AssertionFailure() << "ended by itself: " << WEXITSTATUS(status);
  }

 private:
  pid_t pid_ = -1;
  int in_ = -1;
};

}  // namespace horopter
