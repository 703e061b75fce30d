// What the pipeline measures of a request: time of stages and steps, and where time ran short.
#pragma once

#include <atomic>
#include <chrono>
#include <map>
#include <string>
#include <string_view>
#include <utility>
#include <vector>

#include "server/base/stop_token.h"
#include "server/pipeline/scene.h"

namespace horopter {

// Times one stage and keeps its counts.
class StageClock {
 public:
  StageClock(std::string stage, std::vector<StageReport>* reports)
      : reports_(reports),
        report_{std::move(stage), 0.0, {}},
        start_(std::chrono::steady_clock::now()) {}
  void Finish(std::map<std::string, double> counts) {
    report_.seconds =
        std::chrono::duration<double>(std::chrono::steady_clock::now() - start_).count();
    report_.counts = std::move(counts);
    reports_->push_back(std::move(report_));
  }

 private:
  std::vector<StageReport>* reports_;
  StageReport report_;
  std::chrono::steady_clock::time_point start_;
};

// Adds up the wall time of a stage's steps under "seconds_<step>".
class StepClock {
 public:
  void Begin(std::string_view step) {
    End();
    step_ = std::string(step);
    start_ = std::chrono::steady_clock::now();
  }
  void End() {
    if (step_.empty()) return;
    seconds_["seconds_" + step_] +=
        std::chrono::duration<double>(std::chrono::steady_clock::now() - start_).count();
    step_.clear();
  }
  const std::map<std::string, double>& seconds() const { return seconds_; }

 private:
  std::string step_;
  std::chrono::steady_clock::time_point start_;
  std::map<std::string, double> seconds_;
};

// Notes whether a stage was told to hurry, and in which step: stages read no clock, so one that
// never heard it gave all it has. Begin() on the thread of the request; the token on any.
class HurryWatch {
 public:
  explicit HurryWatch(StopRequested hurry) : hurry_(std::move(hurry)) {}

  StopRequested Token() {
    if (!hurry_) return {};
    return [this] {
      if (!hurry_()) return false;
      int none = -1;
      heard_in_.compare_exchange_strong(none, static_cast<int>(steps_begun_.load()));
      return true;
    };
  }
  void Begin(std::string_view step) {
    steps_.emplace_back(step);
    ++steps_begun_;
  }
  bool heard() const { return heard_in_ >= 0; }
  // Empty: not heard, or before the first step.
  std::string step() const {
    return heard_in_ > 0 ? steps_[static_cast<std::size_t>(heard_in_) - 1] : std::string();
  }

 private:
  const StopRequested hurry_;
  std::vector<std::string> steps_;
  std::atomic<int> steps_begun_{0};
  std::atomic<int> heard_in_{-1};
};

}  // namespace horopter
