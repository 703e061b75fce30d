#include "client/load/load_stats.h"

#include <algorithm>
#include <cmath>
#include <numeric>

namespace horopter {

double Percentile(const std::vector<double>& sorted, double q) {
  const auto n = static_cast<double>(sorted.size());
  // The tolerance keeps 0.9 * 10 at rank 9.
  const double rank = std::ceil(q * n - 1e-9 * n);
  const double index = std::clamp(rank - 1.0, 0.0, n - 1.0);
  return sorted[static_cast<size_t>(index)];
}

LatencySummary Summarize(std::vector<double> seconds) {
  LatencySummary s;
  if (seconds.empty()) return s;
  std::sort(seconds.begin(), seconds.end());
  s.count = static_cast<int64_t>(seconds.size());
  s.min_s = seconds.front();
  s.max_s = seconds.back();
  s.mean_s =
      std::accumulate(seconds.begin(), seconds.end(), 0.0) / static_cast<double>(seconds.size());
  s.p50_s = Percentile(seconds, 0.5);
  s.p90_s = Percentile(seconds, 0.9);
  s.p95_s = Percentile(seconds, 0.95);
  s.p99_s = Percentile(seconds, 0.99);
  s.p999_s = Percentile(seconds, 0.999);
  return s;
}

LoadSummary Summarize(const LoadRun& run) {
  LoadSummary summary;
  std::vector<double> latency, service, send_delay;
  std::map<std::string, std::vector<double>> stages;
  double last_due = 0.0;
  for (const LoadSample& s : run.samples) {
    const LoadReply& reply = s.reply;
    ++summary.codes[absl::StatusCodeToString(reply.code)];
    summary.bytes_sent += reply.bytes_sent;
    summary.bytes_received += reply.bytes_received;
    send_delay.push_back(s.sent_s - s.due_s);
    last_due = std::max(last_due, s.due_s);
    if (reply.code != absl::StatusCode::kOk) continue;
    latency.push_back(s.done_s - s.due_s);
    service.push_back(s.done_s - s.sent_s);
    ++summary.states[reply.state];
    for (const auto& [stage, seconds] : reply.stages) stages[stage].push_back(seconds);
  }
  summary.requests = static_cast<int64_t>(run.samples.size());
  summary.elapsed_s = run.elapsed_s;
  if (run.elapsed_s > 0.0) {
    summary.answered_hz = static_cast<double>(latency.size()) / run.elapsed_s;
    summary.cpu_share = run.cpu_s / run.elapsed_s;
  }
  if (last_due > 0.0) summary.offered_hz = static_cast<double>(summary.requests - 1) / last_due;
  summary.latency = Summarize(std::move(latency));
  summary.service = Summarize(std::move(service));
  summary.send_delay = Summarize(std::move(send_delay));
  for (auto& [stage, seconds] : stages) summary.stages[stage] = Summarize(std::move(seconds));
  return summary;
}

double HighestRate(const RateSearch& search,
                   const std::function<bool(double rate_hz, bool* stop)>& holds) {
  double good = 0.0, bad = 0.0;
  bool stop = false;
  for (double rate = search.lowest_hz; !stop && rate <= search.highest_hz; rate *= 2.0) {
    if (!holds(rate, &stop)) {
      bad = rate;
      break;
    }
    good = rate;
  }
  while (!stop && good > 0.0 && bad > good * search.ratio) {
    const double rate = std::sqrt(good * bad);
    (holds(rate, &stop) ? good : bad) = rate;
  }
  return good;
}

}  // namespace horopter
