// A run as text, JSON, CSV and SVG.
#pragma once

#include <map>
#include <optional>
#include <string>
#include <vector>

#include "client/load/load_stats.h"

namespace horopter {

// Means over the answers that have ground truth, weighted by targets.
struct LoadAccuracy {
  int64_t answers = 0;  // judged
  double ar = 0.0;      // average recall, as `dataset evaluate`
  double recall_10px = 0.0;
  double precision = 0.0;
  int64_t wrong = 0;  // false estimates, summed over images and answers
  int sets = 0;       // image sets with ground truth
  int different = 0;  // answers that differ from the first one of their set
};

struct LoadStep {
  std::string name;      // "closed loop, 2 at a time", "4.0 requests/s"
  double rate_hz = 0.0;  // asked for; 0: closed loop
  LoadRun run;
  LoadSummary summary;
  std::optional<LoadAccuracy> accuracy;
};

struct LoadRunReport {
  std::string server;
  std::string arrivals;  // "closed", "constant" or "poisson"
  uint64_t seed = 0;
  std::vector<std::string> items;
  std::vector<LoadStep> steps;
  std::optional<double> highest_rate_hz;  // of a search
};

std::string TextOf(const LoadStep& step);
std::string JsonOf(const LoadRunReport& report);
// One line a request.
std::string CsvOf(const LoadRunReport& report);
// Several rates: percentiles of latency against the rate; else latency against the percentile.
std::string SvgOf(const LoadRunReport& report);

}  // namespace horopter
