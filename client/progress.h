// A progress line on stderr for work that takes a while.
#pragma once

#include <chrono>
#include <condition_variable>
#include <cstdint>
#include <mutex>
#include <string>
#include <thread>

namespace horopter {

// Draws nothing for the first two seconds, nothing at all where stderr is no terminal. Not
// thread-safe.
class Progress {
 public:
  // total 0: not known.
  Progress(std::string what, int64_t total);
  // As above, with the terminal decided by the caller (tests).
  Progress(std::string what, int64_t total, bool terminal);
  ~Progress();
  Progress(const Progress&) = delete;
  Progress& operator=(const Progress&) = delete;

  // At most ten lines a second are drawn.
  void Update(int64_t done, const std::string& note = "");

  // Wipes the line, so that other output can follow. The next Update draws it again.
  void Clear();

 private:
  std::string what_;
  int64_t total_;
  bool terminal_, drawn_ = false;
  std::chrono::steady_clock::time_point start_, last_;
};

// A progress line with the seconds, for work that does not say how far it is: drawn by a thread of
// its own until this goes.
class Waiting {
 public:
  explicit Waiting(std::string what);
  ~Waiting();
  Waiting(const Waiting&) = delete;
  Waiting& operator=(const Waiting&) = delete;

 private:
  std::mutex mutex_;
  std::condition_variable done_;
  bool is_done_ = false;
  std::thread drawer_;
};

// "scenes [######....]  12/20  60 %  note"; with total 0 only "scenes 12  note".
std::string ProgressLine(const std::string& what,
                         int64_t done,
                         int64_t total,
                         const std::string& note);

}  // namespace horopter
