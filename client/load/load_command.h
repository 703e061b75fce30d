// `horopter load`.
#pragma once

#include <optional>
#include <string>
#include <vector>

#include "absl/status/status.h"
#include "client/api.h"
#include "client/load/load_items.h"
#include "client/load/load_run.h"

namespace horopter {

struct LoadArguments {
  std::vector<std::string> sources;
  LoadItemOptions items;
  LoadOptions load;
  // Open loop: a step of load.duration_s for each rate; empty: closed loop, or a search.
  std::vector<double> rates;
  // > 0: looks for the highest rate whose percentile `bound_percentile` of latency is below this
  // and of which nothing is refused. `rates` then holds the lowest and highest to try.
  double bound_ms = 0.0;
  double bound_percentile = 99.0;
  std::vector<std::string> candidates;
  std::string json_path, csv_path, svg_path;  // empty: none
};

// Prints a table per step and writes the files, also when the run is interrupted or the server goes
// away: then with CANCELLED or UNAVAILABLE. Errors: those of ReadLoadItems, RunLoad and of writing.
absl::Status Load(HoropterClient& client, const LoadArguments& arguments);

}  // namespace horopter
