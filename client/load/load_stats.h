// Numbers of a run. Percentiles are order statistics of all samples, not of a histogram.
#pragma once

#include <functional>
#include <map>
#include <string>
#include <vector>

#include "client/load/load_run.h"

namespace horopter {

// Seconds; all 0 without samples.
struct LatencySummary {
  int64_t count = 0;
  double min_s = 0, mean_s = 0, p50_s = 0, p90_s = 0, p95_s = 0, p99_s = 0, p999_s = 0, max_s = 0;
};

// The smallest value that at least the share q (0..1) of all values does not exceed (nearest rank).
// `sorted` ascending, not empty.
double Percentile(const std::vector<double>& sorted, double q);

LatencySummary Summarize(std::vector<double> seconds);

struct LoadSummary {
  double offered_hz = 0.0;    // requests due (closed loop: sent) a second while requests were sent
  double answered_hz = 0.0;   // answers (code OK) a second until the last one
  LatencySummary latency;     // of answers, from when they were due: no coordinated omission
  LatencySummary service;     // of answers, from when they were sent
  LatencySummary send_delay;  // sent minus due of all requests: large means this program was slow
  std::map<std::string, int64_t> codes;          // canonical names
  std::map<std::string, int64_t> states;         // of answers
  std::map<std::string, LatencySummary> stages;  // of answers, as the server reports them
  int64_t requests = 0, bytes_sent = 0, bytes_received = 0;
  double elapsed_s = 0.0;
  double cpu_share = 0.0;  // of one core, this process
};
LoadSummary Summarize(const LoadRun& run);

// The highest rate that `holds`, between lowest and highest: doubles from `lowest` until one fails,
// then halves the interval (geometrically) until its ends are within `ratio`. 0 when `lowest`
// fails.
struct RateSearch {
  double lowest_hz = 0.1;
  double highest_hz = 1000.0;
  double ratio = 1.1;
};
// holds: true, false; a run that was interrupted sets *stop, and the best rate so far is returned.
double HighestRate(const RateSearch& search,
                   const std::function<bool(double rate_hz, bool* stop)>& holds);

}  // namespace horopter
