#include "client/load/load_report.h"

#include <algorithm>
#include <cmath>
#include <nlohmann/json.hpp>

#include "absl/strings/str_cat.h"
#include "absl/strings/str_format.h"
#include "client/load/svg_chart.h"

namespace horopter {
namespace {

nlohmann::json ToJson(const LatencySummary& s) {
  return {{"count", s.count},
          {"min_ms", s.min_s * 1e3},
          {"mean_ms", s.mean_s * 1e3},
          {"p50_ms", s.p50_s * 1e3},
          {"p90_ms", s.p90_s * 1e3},
          {"p95_ms", s.p95_s * 1e3},
          {"p99_ms", s.p99_s * 1e3},
          {"p99_9_ms", s.p999_s * 1e3},
          {"max_ms", s.max_s * 1e3}};
}

nlohmann::json ToJson(const LoadStep& step) {
  const LoadSummary& s = step.summary;
  nlohmann::json json = {{"name", step.name},
                         {"rate_hz", step.rate_hz},
                         {"offered_hz", s.offered_hz},
                         {"answered_hz", s.answered_hz},
                         {"requests", s.requests},
                         {"elapsed_s", s.elapsed_s},
                         {"latency", ToJson(s.latency)},
                         {"service", ToJson(s.service)},
                         {"send_delay", ToJson(s.send_delay)},
                         {"codes", s.codes},
                         {"states", s.states},
                         {"bytes_sent", s.bytes_sent},
                         {"bytes_received", s.bytes_received},
                         {"client_cpu_share", s.cpu_share},
                         {"interrupted", step.run.interrupted},
                         {"server_gone", step.run.server_gone}};
  json["stages"] = nlohmann::json::object();
  for (const auto& [stage, summary] : s.stages) json["stages"][stage] = ToJson(summary);
  if (step.accuracy) {
    const LoadAccuracy& a = *step.accuracy;
    json["accuracy"] = {{"answers", a.answers},
                        {"sets", a.sets},
                        {"AR", a.ar},
                        {"R10", a.recall_10px},
                        {"precision", a.precision},
                        {"wrong", a.wrong},
                        {"different", a.different}};
  }
  return json;
}

std::string Line(const std::string& name, const LatencySummary& s) {
  return absl::StrFormat("%-16s %8.1f %8.1f %8.1f %8.1f %8.1f %8.1f %8.1f\n",
                         name,
                         s.mean_s * 1e3,
                         s.p50_s * 1e3,
                         s.p90_s * 1e3,
                         s.p95_s * 1e3,
                         s.p99_s * 1e3,
                         s.p999_s * 1e3,
                         s.max_s * 1e3);
}

std::string Counts(const std::map<std::string, int64_t>& counts) {
  std::string text;
  for (const auto& [name, n] : counts) absl::StrAppend(&text, " ", name, " ", n);
  return text;
}

// A comma or quote in a name must not shift the columns.
std::string Quoted(const std::string& text) {
  std::string out = "\"";
  for (char c : text) out += c == '"' ? std::string("\"\"") : std::string(1, c);
  return out + "\"";
}

}  // namespace

std::string TextOf(const LoadStep& step) {
  const LoadSummary& s = step.summary;
  std::string text = absl::StrFormat("%s%s%s\n",
                                     step.name,
                                     step.run.interrupted ? " (interrupted)" : "",
                                     step.run.server_gone ? " (the server is gone)" : "");
  absl::StrAppend(&text,
                  absl::StrFormat("  %d requests in %.1f s; offered %.2f/s, answered %.2f/s; sent "
                                  "%.1f MB, received %.1f MB; this program %.1f %% of a core\n",
                                  s.requests,
                                  s.elapsed_s,
                                  s.offered_hz,
                                  s.answered_hz,
                                  static_cast<double>(s.bytes_sent) / 1e6,
                                  static_cast<double>(s.bytes_received) / 1e6,
                                  s.cpu_share * 100.0));
  absl::StrAppend(&text, "  codes:", Counts(s.codes), "\n");
  if (!s.states.empty()) absl::StrAppend(&text, "  states:", Counts(s.states), "\n");
  absl::StrAppend(&text,
                  absl::StrFormat("  %-16s %8s %8s %8s %8s %8s %8s %8s\n",
                                  "ms",
                                  "mean",
                                  "p50",
                                  "p90",
                                  "p95",
                                  "p99",
                                  "p99.9",
                                  "max"));
  absl::StrAppend(&text, "  ", Line("latency", s.latency));
  if (step.rate_hz > 0.0) {
    absl::StrAppend(&text, "  ", Line("  since sent", s.service));
    absl::StrAppend(&text, "  ", Line("  send delay", s.send_delay));
  }
  for (const auto& [stage, summary] : s.stages) absl::StrAppend(&text, "  ", Line(stage, summary));
  if (step.accuracy) {
    const LoadAccuracy& a = *step.accuracy;
    absl::StrAppend(&text,
                    absl::StrFormat("  accuracy of %d answers to %d sets: AR %.3f, R@10 %.3f, "
                                    "precision %.3f, wrong %d; %d differ from their set's first\n",
                                    a.answers,
                                    a.sets,
                                    a.ar,
                                    a.recall_10px,
                                    a.precision,
                                    a.wrong,
                                    a.different));
  }
  return text;
}

std::string JsonOf(const LoadRunReport& report) {
  nlohmann::json json = {{"server", report.server},
                         {"arrivals", report.arrivals},
                         {"seed", report.seed},
                         {"items", report.items},
                         {"steps", nlohmann::json::array()}};
  for (const LoadStep& step : report.steps) json["steps"].push_back(ToJson(step));
  if (report.highest_rate_hz) json["highest_rate_hz"] = *report.highest_rate_hz;
  return json.dump(1) + "\n";
}

std::string CsvOf(const LoadRunReport& report) {
  std::string csv =
      "step,rate_hz,item,due_s,sent_s,done_s,latency_ms,code,state,bytes_sent,bytes_received,"
      "answer\n";
  for (size_t k = 0; k < report.steps.size(); ++k) {
    for (const LoadSample& s : report.steps[k].run.samples) {
      const LoadReply& r = s.reply;
      absl::StrAppend(&csv,
                      absl::StrFormat("%d,%g,%s,%.6f,%.6f,%.6f,%.3f,%s,%s,%d,%d,%d\n",
                                      k,
                                      report.steps[k].rate_hz,
                                      Quoted(report.items[static_cast<size_t>(s.item)]),
                                      s.due_s,
                                      s.sent_s,
                                      s.done_s,
                                      (s.done_s - s.due_s) * 1e3,
                                      absl::StatusCodeToString(r.code),
                                      r.state,
                                      r.bytes_sent,
                                      r.bytes_received,
                                      r.answer));
    }
  }
  return csv;
}

std::string SvgOf(const LoadRunReport& report) {
  SvgChart chart;
  chart.y_label = "latency, ms";
  chart.log_y = true;
  std::vector<const LoadStep*> steps;
  for (const LoadStep& step : report.steps) {
    if (step.summary.latency.count > 0) steps.push_back(&step);
  }
  std::stable_sort(steps.begin(), steps.end(), [](const LoadStep* a, const LoadStep* b) {
    return a->rate_hz < b->rate_hz;
  });
  if (steps.size() > 1) {
    chart.title = absl::StrCat("Latency against rate, ", report.server);
    chart.x_label = "requests/s";
    chart.series = {{"p50", {}}, {"p90", {}}, {"p99", {}}, {"max", {}}};
    for (const LoadStep* step : steps) {
      const LatencySummary& s = step->summary.latency;
      const double values[] = {s.p50_s, s.p90_s, s.p99_s, s.max_s};
      for (size_t k = 0; k < 4; ++k) {
        chart.series[k].points.emplace_back(step->summary.offered_hz, values[k] * 1e3);
      }
    }
    return SvgOf(chart);
  }
  chart.title = steps.empty() ? "no answers" : steps[0]->name;
  chart.x_label = "percentile of answers";
  if (steps.empty()) return SvgOf(chart);
  std::vector<double> latency;
  for (const LoadSample& s : steps[0]->run.samples) {
    if (s.reply.code == absl::StatusCode::kOk) latency.push_back(s.done_s - s.due_s);
  }
  std::sort(latency.begin(), latency.end());
  chart.series = {{"latency", {}}};
  for (int p = 1; p <= 1000; ++p) {
    chart.series[0].points.emplace_back(p / 10.0, Percentile(latency, p / 1000.0) * 1e3);
  }
  return SvgOf(chart);
}

}  // namespace horopter
