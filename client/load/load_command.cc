#include "client/load/load_command.h"

#include <algorithm>
#include <nlohmann/json.hpp>

#include "absl/strings/str_cat.h"
#include "absl/strings/str_format.h"
#include "client/bop_results.h"
#include "client/convert.h"
#include "client/interrupt.h"
#include "client/load/load_accuracy.h"
#include "client/load/load_report.h"
#include "client/load/load_target.h"
#include "client/output.h"
#include "client/progress.h"
#include "server/base/status_macros.h"

namespace horopter {
namespace {

class LoadSession {
 public:
  LoadSession(HoropterClient& client,
              const LoadArguments& arguments,
              const std::vector<LoadItem>& items)
      : arguments_(arguments), items_(items), target_(client, items), judge_(items) {
    report.server = client.address();
    report.seed = arguments.load.seed;
    report.arrivals = arguments.rates.empty()  ? "closed"
                      : arguments.load.poisson ? "poisson"
                                               : "constant";
    for (const LoadItem& item : items) report.items.push_back(item.name);
  }

  // rate_hz 0: closed loop.
  absl::Status RunStep(double rate_hz) {
    LoadOptions options = arguments_.load;
    options.rate_hz = rate_hz;
    // A step starts warm where the one before it ended.
    if (!report.steps.empty()) options.warmup = 0;
    Progress progress(rate_hz > 0.0 ? absl::StrFormat("%g/s", rate_hz) : "requests",
                      options.requests);
    LoadHooks hooks;
    hooks.interrupted = Interrupted;
    hooks.report = [&](int64_t done, int64_t failed) {
      progress.Update(done, failed > 0 ? absl::StrCat(failed, " failed") : "");
    };
    LoadStep step;
    step.rate_hz = rate_hz;
    step.name = rate_hz > 0.0 ? absl::StrFormat("open loop, %s arrivals, %g requests/s",
                                                options.poisson ? "Poisson" : "constant",
                                                rate_hz)
                              : absl::StrFormat("closed loop, %d at a time", options.concurrency);
    if (options.rate_end_hz > 0.0) absl::StrAppend(&step.name, " to ", options.rate_end_hz);
    const LoadTarget target = target_.target();
    HOROPTER_ASSIGN_OR_RETURN(step.run,
                              RunLoad(options, static_cast<int>(items_.size()), target, hooks));
    progress.Clear();
    step.summary = Summarize(step.run);
    HOROPTER_ASSIGN_OR_RETURN(step.accuracy, judge_.Judge(step.run, target_.answers()));
    Say("%s\n", TextOf(step).c_str());
    report.steps.push_back(std::move(step));
    return absl::OkStatus();
  }

  bool Ended() const {
    return !report.steps.empty() &&
           (report.steps.back().run.interrupted || report.steps.back().run.server_gone);
  }

  // Whether the last step keeps the bound; a refusal breaks it.
  bool KeepsBound() const {
    const LoadRun& run = report.steps.back().run;
    std::vector<double> latency;
    for (const LoadSample& s : run.samples) {
      if (s.reply.code != absl::StatusCode::kOk) return false;
      latency.push_back(s.done_s - s.due_s);
    }
    if (latency.empty()) return false;
    std::sort(latency.begin(), latency.end());
    return Percentile(latency, arguments_.bound_percentile / 100.0) * 1e3 <= arguments_.bound_ms;
  }

  LoadRunReport report;

 private:
  const LoadArguments& arguments_;
  const std::vector<LoadItem>& items_;
  ServerTarget target_;
  AccuracyJudge judge_;
};

absl::Status Search(LoadSession& session, const LoadArguments& arguments) {
  RateSearch search;
  search.lowest_hz = arguments.rates.front();
  if (arguments.rates.size() > 1) search.highest_hz = arguments.rates.back();
  absl::Status status;
  session.report.highest_rate_hz = HighestRate(search, [&](double rate_hz, bool* stop) {
    status = session.RunStep(rate_hz);
    *stop = !status.ok() || session.Ended();
    return !*stop && session.KeepsBound();
  });
  if (!status.ok()) return status;
  Say("highest rate with p%g of latency below %g ms and no refusal: %.3g requests/s\n",
      arguments.bound_percentile,
      arguments.bound_ms,
      *session.report.highest_rate_hz);
  return absl::OkStatus();
}

absl::Status RunSteps(LoadSession& session, const LoadArguments& arguments) {
  if (arguments.bound_ms > 0.0) return Search(session, arguments);
  if (arguments.rates.empty()) return session.RunStep(0.0);
  for (const double rate : arguments.rates) {
    HOROPTER_RETURN_IF_ERROR(session.RunStep(rate));
    if (session.Ended()) break;
  }
  return absl::OkStatus();
}

absl::Status WriteFiles(const LoadRunReport& report, const LoadArguments& arguments) {
  if (!arguments.json_path.empty()) {
    HOROPTER_RETURN_IF_ERROR(WriteFileAtomically(arguments.json_path, JsonOf(report)));
  }
  if (!arguments.csv_path.empty()) {
    HOROPTER_RETURN_IF_ERROR(WriteFileAtomically(arguments.csv_path, CsvOf(report)));
  }
  if (!arguments.svg_path.empty()) {
    HOROPTER_RETURN_IF_ERROR(WriteFileAtomically(arguments.svg_path, SvgOf(report)));
  }
  return absl::OkStatus();
}

}  // namespace

absl::Status Load(HoropterClient& client, const LoadArguments& arguments) {
  if (arguments.bound_ms > 0.0 && arguments.rates.empty()) {
    return absl::InvalidArgumentError("--bound-ms: needs --rate, the lowest rate to try");
  }
  HOROPTER_ASSIGN_OR_RETURN(std::vector<LoadItem> items,
                            ReadLoadItems(arguments.sources, arguments.items));
  for (LoadItem& item : items) {
    for (const std::string& id : arguments.candidates) {
      item.request.add_candidate_objects(ResourceName(id));
    }
  }
  LoadSession session(client, arguments, items);
  // A file that cannot be written should fail before the work.
  HOROPTER_RETURN_IF_ERROR(WriteFiles(session.report, arguments));
  const absl::Status status = RunSteps(session, arguments);
  HOROPTER_RETURN_IF_ERROR(WriteFiles(session.report, arguments));
  HOROPTER_RETURN_IF_ERROR(status);
  if (JsonOutput()) SayJson(nlohmann::json::parse(JsonOf(session.report)));
  if (session.Ended()) {
    if (session.report.steps.back().run.interrupted) return absl::CancelledError("interrupted");
    return absl::UnavailableError(absl::StrCat("server ", client.address(), " is gone"));
  }
  return absl::OkStatus();
}

}  // namespace horopter
