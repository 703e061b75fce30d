// The load tool without a server: schedules, numbers, and that a stall of the server is seen in the
// latencies of all requests that were due meanwhile.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <atomic>
#include <chrono>
#include <cmath>
#include <mutex>
#include <nlohmann/json.hpp>
#include <set>
#include <thread>

#include "client/load/arrivals.h"
#include "client/load/load_report.h"
#include "client/load/load_run.h"
#include "client/load/load_stats.h"
#include "client/load/svg_chart.h"
#include "client/progress.h"

namespace horopter {
namespace {

using testing::HasSubstr;

TEST(Arrivals, ConstantOnesAreEvenlySpaced) {
  Arrivals arrivals({.rate_hz = 4.0});
  for (int k = 0; k < 100; ++k) EXPECT_NEAR(arrivals.Next(), 0.25 * k, 1e-12);
}

TEST(Arrivals, PoissonGapsHaveMeanAndDeviationOfTheRateAndRepeatWithTheSeed) {
  const ArrivalOptions options{.rate_hz = 50.0, .poisson = true, .seed = 7};
  Arrivals a(options), b(options);
  Arrivals other({.rate_hz = 50.0, .poisson = true, .seed = 8});
  const int n = 20000;
  double last = a.Next(), sum = 0.0, squares = 0.0;
  EXPECT_EQ(b.Next(), last);
  other.Next();
  bool differs = false;
  for (int k = 0; k < n; ++k) {
    const double t = a.Next();
    ASSERT_EQ(b.Next(), t);
    differs = differs || other.Next() != t;
    ASSERT_GE(t, last);
    sum += t - last;
    squares += (t - last) * (t - last);
    last = t;
  }
  const double mean = sum / n;
  EXPECT_NEAR(mean, 0.02, 0.0005);
  EXPECT_NEAR(std::sqrt(squares / n - mean * mean), 0.02, 0.001);
  EXPECT_TRUE(differs);
}

TEST(Arrivals, ARampGoesFromOneRateToTheOtherAndStaysThere) {
  Arrivals arrivals({.rate_hz = 10.0, .rate_end_hz = 30.0, .ramp_s = 5.0});
  int first = 0, last = 0, all = 0, after = 0;
  for (double t = arrivals.Next(); t < 6.0; t = arrivals.Next()) {
    first += t < 0.5;
    last += t >= 4.5 && t < 5.0;
    all += t < 5.0;
    after += t >= 5.0;
  }
  EXPECT_NEAR(first, 5.5, 1.0);
  EXPECT_NEAR(last, 14.5, 1.0);
  EXPECT_NEAR(all, 100, 1);
  EXPECT_NEAR(after, 30, 1);
}

TEST(ItemOrder, EverySetComesOnceARound) {
  ItemOrder order(7, 3), same(7, 3);
  for (int round = 0; round < 5; ++round) {
    std::set<int> seen;
    for (int k = 0; k < 7; ++k) {
      const int item = order.Next();
      EXPECT_EQ(same.Next(), item);
      seen.insert(item);
    }
    EXPECT_EQ(seen.size(), 7u);
  }
}

TEST(LoadStats, PercentilesAreOrderStatistics) {
  std::vector<double> values;
  for (int k = 1; k <= 1000; ++k) values.push_back(k);
  EXPECT_EQ(Percentile(values, 0.5), 500);
  EXPECT_EQ(Percentile(values, 0.9), 900);
  EXPECT_EQ(Percentile(values, 0.999), 999);
  EXPECT_EQ(Percentile(values, 1.0), 1000);
  EXPECT_EQ(Percentile({3.0}, 0.999), 3.0);
  const LatencySummary s = Summarize({4, 2, 8, 6});
  EXPECT_EQ(s.count, 4);
  EXPECT_EQ(s.p50_s, 4);
  EXPECT_EQ(s.max_s, 8);
  EXPECT_EQ(s.mean_s, 5);
  EXPECT_EQ(Summarize(std::vector<double>{}).p99_s, 0);
}

TEST(HighestRate, IsWithinTheRatioOfTheTrueLimit) {
  for (const double limit : {0.3, 1.0, 7.7, 120.0}) {
    int runs = 0;
    const double found = HighestRate({.lowest_hz = 0.25}, [&](double rate, bool*) {
      ++runs;
      return rate <= limit;
    });
    EXPECT_LE(found, limit);
    EXPECT_GE(found * 1.1, limit * 0.999);
    EXPECT_LT(runs, 20);
  }
  EXPECT_EQ(HighestRate({}, [](double, bool*) { return false; }), 0.0);
  int runs = 0;
  HighestRate({}, [&](double, bool* stop) { return *stop = ++runs == 3, true; });
  EXPECT_EQ(runs, 3);
}

// Answers one request at a time, each after `busy`; nothing while `stalled`.
class SlowServer {
 public:
  explicit SlowServer(std::chrono::milliseconds busy) : busy_(busy) {}
  ~SlowServer() {
    for (std::thread& t : threads_) t.join();
  }
  LoadTarget target() {
    return {[this](int, std::function<void(LoadReply)> done) {
              threads_.emplace_back([this, done] {
                {
                  const std::lock_guard one_at_a_time(mutex_);
                  const int n = served_++;
                  std::this_thread::sleep_for(n == stall_at ? stall : busy_);
                }
                LoadReply reply;
                reply.code = code;
                reply.state = "RECOGNIZED";
                done(reply);
              });
            },
            {}};
  }
  int stall_at = -1;
  std::chrono::milliseconds stall{0};
  absl::StatusCode code = absl::StatusCode::kOk;
  int served() const { return served_; }

 private:
  std::chrono::milliseconds busy_;
  std::mutex mutex_;
  std::atomic<int> served_{0};
  std::vector<std::thread> threads_;
};

TEST(RunLoad, AStallCountsForEveryRequestThatWasDueMeanwhile) {
  SlowServer server(std::chrono::milliseconds(1));
  server.stall_at = 10;
  server.stall = std::chrono::milliseconds(1000);
  LoadOptions options;
  options.rate_hz = 50.0;
  options.requests = 100;
  options.max_in_flight = 4;  // sending stops as well, the clocks do not
  const auto run = RunLoad(options, 1, server.target());
  ASSERT_TRUE(run.ok()) << run.status();
  ASSERT_EQ(run->samples.size(), 100u);
  // 50 requests are due within the second; their latencies fall linearly from 1 s to 0.
  const LoadSummary s = Summarize(*run);
  int late = 0;
  for (const LoadSample& sample : run->samples) late += sample.done_s - sample.due_s > 0.25;
  EXPECT_GE(late, 35);
  EXPECT_GT(s.latency.p90_s, 0.7);
  // A tool that counts from sending sees only the few that were under way.
  int late_since_sent = 0;
  for (const LoadSample& sample : run->samples) {
    late_since_sent += sample.done_s - sample.sent_s > 0.25;
  }
  EXPECT_LE(late_since_sent, 5);
}

TEST(RunLoad, AClosedLoopKeepsItsNumberAndItsWarmUpDoesNotCount) {
  std::atomic<int> under_way{0}, most{0}, all{0};
  std::vector<std::thread> threads;
  const LoadTarget target{[&](int, std::function<void(LoadReply)> done) {
                            threads.emplace_back([&, done] {
                              most = std::max(most.load(), ++under_way);
                              std::this_thread::sleep_for(std::chrono::milliseconds(5));
                              --under_way;
                              ++all;
                              done({});
                            });
                          },
                          {}};
  LoadOptions options;
  options.concurrency = 3;
  options.requests = 30;
  options.warmup = 4;
  const auto run = RunLoad(options, 2, target);
  for (std::thread& t : threads) t.join();
  ASSERT_TRUE(run.ok());
  EXPECT_EQ(run->samples.size(), 30u);
  EXPECT_EQ(all, 34);
  EXPECT_EQ(most, 3);
  for (const LoadSample& s : run->samples) EXPECT_EQ(s.due_s, s.sent_s);
}

TEST(RunLoad, AServerThatIsGoneEndsTheRunAndKeepsWhatIsThere) {
  SlowServer server(std::chrono::milliseconds(0));
  server.code = absl::StatusCode::kUnavailable;
  LoadOptions options;
  options.requests = 100000;
  const auto run = RunLoad(options, 1, server.target());
  ASSERT_TRUE(run.ok());
  EXPECT_TRUE(run->server_gone);
  EXPECT_GE(run->samples.size(), 20u);
  EXPECT_LT(run->samples.size(), 30u);
  EXPECT_EQ(Summarize(*run).codes.at("UNAVAILABLE"), static_cast<int64_t>(run->samples.size()));
}

TEST(RunLoad, AnInterruptedRunCancelsWhatIsUnderWayAndKeepsTheRest) {
  std::mutex mutex;
  std::vector<std::function<void(LoadReply)>> hanging;
  std::atomic<bool> interrupted{false};
  int started = 0;
  const LoadTarget target{[&](int, std::function<void(LoadReply)> done) {
                            if (++started <= 5) return done({});
                            const std::lock_guard lock(mutex);
                            hanging.push_back(done);
                            interrupted = true;
                          },
                          [&] {
                            const std::lock_guard lock(mutex);
                            for (const auto& done : hanging) {
                              LoadReply reply;
                              reply.code = absl::StatusCode::kCancelled;
                              done(reply);
                            }
                          }};
  LoadOptions options;
  options.requests = 1000;
  LoadHooks hooks;
  hooks.interrupted = [&] { return interrupted.load(); };
  const auto run = RunLoad(options, 1, target, hooks);
  ASSERT_TRUE(run.ok());
  EXPECT_TRUE(run->interrupted);
  ASSERT_EQ(run->samples.size(), 6u);
  EXPECT_EQ(Summarize(*run).latency.count, 5);
}

TEST(RunLoad, OptionsThatMakeNoSenseAreNamed) {
  const LoadTarget target{[](int, std::function<void(LoadReply)> done) { done({}); }, {}};
  EXPECT_THAT(RunLoad({}, 1, target).status().message(), HasSubstr("duration"));
  LoadOptions options;
  options.requests = 1;
  EXPECT_FALSE(RunLoad(options, 0, target).ok());
  options.rate_hz = -1.0;
  EXPECT_THAT(RunLoad(options, 1, target).status().message(), HasSubstr("rate"));
  options.rate_hz = 0.0;
  options.rate_end_hz = 2.0;
  EXPECT_THAT(RunLoad(options, 1, target).status().message(), HasSubstr("ramp"));
}

TEST(LoadRunReport, JsonCsvAndSvgHoldTheNumbers) {
  LoadRunReport report;
  report.items = {"a \"b\", c"};
  for (int k = 1; k <= 2; ++k) {
    LoadStep step;
    step.rate_hz = k;
    step.run.elapsed_s = 10.0;
    for (int i = 0; i < 10; ++i) {
      LoadSample sample;
      sample.due_s = i;
      sample.sent_s = i + 0.001;
      sample.done_s = i + 0.1 * k;
      sample.reply.stages = {{"features", 0.05}};
      step.run.samples.push_back(sample);
    }
    step.run.samples[3].reply.code = absl::StatusCode::kResourceExhausted;
    step.summary = Summarize(step.run);
    step.accuracy = LoadAccuracy{.answers = 9, .ar = 0.5};
    report.steps.push_back(step);
  }
  const auto json = nlohmann::json::parse(JsonOf(report));
  EXPECT_NEAR(json["steps"][1]["latency"]["p50_ms"].get<double>(), 200.0, 1e-6);
  EXPECT_EQ(json["steps"][0]["codes"]["RESOURCE_EXHAUSTED"], 1);
  EXPECT_EQ(json["steps"][0]["latency"]["count"], 9);
  EXPECT_NEAR(json["steps"][0]["offered_hz"].get<double>(), 1.0, 1e-9);
  EXPECT_NEAR(json["steps"][0]["stages"]["features"]["p99_ms"].get<double>(), 50.0, 1e-6);
  EXPECT_EQ(json["steps"][0]["accuracy"]["AR"], 0.5);
  const std::string csv = CsvOf(report);
  EXPECT_EQ(std::count(csv.begin(), csv.end(), '\n'), 21);
  EXPECT_THAT(csv, HasSubstr("\"a \"\"b\"\", c\""));
  EXPECT_THAT(SvgOf(report), HasSubstr(">p99<"));
  EXPECT_THAT(TextOf(report.steps[0]), HasSubstr("RESOURCE_EXHAUSTED 1"));
  // Without answers there is a chart all the same.
  EXPECT_THAT(SvgOf(LoadRunReport{}), HasSubstr("no answers"));
}

TEST(SvgChart, KeepsPointsInsideAndEscapesText) {
  SvgChart chart;
  chart.title = "a < b & c";
  chart.log_y = true;
  chart.series = {{"s", {{1, 10}, {2, 1000}, {3, 0.0}, {4, std::nan("")}}}};
  const std::string svg = SvgOf(chart);
  EXPECT_THAT(svg, HasSubstr("a &lt; b &amp; c"));
  EXPECT_THAT(svg, testing::Not(HasSubstr("nan")));
  EXPECT_THAT(svg, testing::Not(HasSubstr("inf")));
}

TEST(Progress, ALineShowsShareAndNote) {
  EXPECT_EQ(ProgressLine("scenes", 6, 12, "x"), "scenes [############............]  6/12  50 %  x");
  EXPECT_EQ(ProgressLine("MB", 3, 0, ""), "MB 3");
  testing::internal::CaptureStderr();
  Progress("quiet", 3, false).Update(1);
  EXPECT_EQ(testing::internal::GetCapturedStderr(), "");
}

}  // namespace
}  // namespace horopter
