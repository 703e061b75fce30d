// Sends requests in a closed loop (a fixed number at a time) or an open loop (at given times,
// whatever the server does) and keeps what became of each. Knows no protocol.
#pragma once

#include <chrono>
#include <cstdint>
#include <functional>
#include <string>
#include <utility>
#include <vector>

#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "client/load/arrivals.h"

namespace horopter {

struct LoadOptions {
  // > 0: open loop with these arrivals; 0: closed loop.
  double rate_hz = 0.0;
  double rate_end_hz = 0.0;  // see ArrivalOptions; the ramp takes duration_s
  bool poisson = false;
  int concurrency = 1;      // closed loop: requests at a time
  double duration_s = 0.0;  // no request starts after it; 0: not bounded
  int64_t requests = 0;     // that are counted; 0: not bounded. One of the two bounds is needed.
  int warmup = 0;           // requests before the first that counts
  uint64_t seed = 1;
  // Open loop: beyond so many unanswered ones no request is sent, but its clock runs from when it
  // was due all the same.
  int max_in_flight = 1000;
  int give_up_after = 20;  // this many UNAVAILABLE in a row end the run
  double drain_s = 60.0;   // for answers after the last request; then they are cancelled
};

// Errors: INVALID_ARGUMENT naming the option.
absl::Status Validate(const LoadOptions& options);

// What a target says of one request.
struct LoadReply {
  absl::StatusCode code = absl::StatusCode::kOk;
  std::string state;                                   // of an answer
  std::vector<std::pair<std::string, double>> stages;  // seconds
  int64_t bytes_sent = 0, bytes_received = 0;
  int answer = -1;  // which of the different answers of its set; -1: none
  // When it arrived, before it was read; unset: when `done` was called.
  std::chrono::steady_clock::time_point arrived{};
};

// start: sends set `item` and calls `done` once, from any thread. cancel_all: ends what is under
// way; `done` is called all the same.
struct LoadTarget {
  std::function<void(int item, std::function<void(LoadReply)> done)> start;
  std::function<void()> cancel_all;
};

// Times in seconds from the start of the run. due: when it should have been sent; of a closed loop
// equal to sent.
struct LoadSample {
  int item = 0;
  double due_s = 0.0, sent_s = 0.0, done_s = 0.0;
  LoadReply reply;
};

struct LoadRun {
  std::vector<LoadSample> samples;  // in order of sending, without the warm-up
  double elapsed_s = 0.0;           // from the start to the last answer
  double cpu_s = 0.0;               // this process, meanwhile
  bool interrupted = false;
  bool server_gone = false;
};

struct LoadHooks {
  std::function<bool()> interrupted;                         // may be empty
  std::function<void(int64_t done, int64_t failed)> report;  // some times a second; may be empty
};

// `items`: how many sets there are, >= 1. Errors: those of Validate.
absl::StatusOr<LoadRun> RunLoad(const LoadOptions& options,
                                int items,
                                const LoadTarget& target,
                                const LoadHooks& hooks = {});

}  // namespace horopter
