#include "server/service/trace_context.h"

#include <gtest/gtest.h>

#include <nlohmann/json.hpp>
#include <set>

#include "absl/strings/str_cat.h"
#include "server/service/telemetry.h"

namespace horopter {
namespace {

constexpr char kTrace[] = "4bf92f3577b34da6a3ce929d0e0e4736";
constexpr char kParent[] = "00f067aa0ba902b7";

TEST(TraceContext, AHeaderIsContinued) {
  const TraceContext c = TraceContextFrom(absl::StrCat("00-", kTrace, "-", kParent, "-01"));
  EXPECT_EQ(c.trace_id, kTrace);
  EXPECT_EQ(c.parent_span_id, kParent);
  EXPECT_EQ(c.span_id.size(), 16u);
  EXPECT_NE(c.span_id, kParent);
  EXPECT_TRUE(c.sampled);
  EXPECT_FALSE(TraceContextFrom(absl::StrCat("00-", kTrace, "-", kParent, "-00")).sampled);
  // A later version may say more.
  EXPECT_EQ(TraceContextFrom(absl::StrCat("01-", kTrace, "-", kParent, "-01-x")).trace_id, kTrace);
}

TEST(TraceContext, WhatIsNoHeaderBeginsANewTrace) {
  std::set<std::string> traces;
  const std::string zeros(32, '0');
  const std::string bad[] = {"",
                             "nonsense",
                             absl::StrCat("ff-", kTrace, "-", kParent, "-01"),
                             absl::StrCat("00-", kTrace, "-", kParent, "-01-x"),
                             absl::StrCat("00-", zeros, "-", kParent, "-01"),
                             absl::StrCat("00-", kTrace, "-0000000000000000-01"),
                             absl::StrCat("00-", kTrace, "-", kParent, "-0G"),
                             "00-4BF92F3577B34DA6A3CE929D0E0E4736-00f067aa0ba902b7-01"};
  for (const std::string& header : bad) {
    const TraceContext c = TraceContextFrom(header);
    EXPECT_EQ(c.trace_id.size(), 32u) << header;
    EXPECT_NE(c.trace_id, kTrace) << header;
    EXPECT_EQ(c.parent_span_id, "") << header;
    EXPECT_TRUE(c.sampled);
    traces.insert(c.trace_id);
  }
  EXPECT_EQ(traces.size(), std::size(bad));
}

RequestRecord SampleCall() {
  RequestRecord r;
  r.request_id = "abc-1";
  r.method = "RecognizeScene";
  r.peer = "ipv4:1";
  r.trace = TraceContextFrom(absl::StrCat("00-", kTrace, "-", kParent, "-01"));
  r.arrival = std::chrono::system_clock::time_point(std::chrono::seconds(1000));
  r.queue_seconds = 0.25;
  r.total_seconds = 1.0;
  r.images = 2;
  r.state = "RECOGNIZED";
  r.objects = 1;
  r.stages = {{"decode", 0.1}, {"features", 0.4}};
  return r;
}

TEST(OtlpJson, StagesAreSpansOfTheCallOneAfterTheOther) {
  const auto json = nlohmann::json::parse(OtlpJson(SampleCall()));
  const auto& spans = json["resourceSpans"][0]["scopeSpans"][0]["spans"];
  ASSERT_EQ(spans.size(), 4u);
  EXPECT_EQ(spans[0]["parentSpanId"], kParent);
  EXPECT_EQ(spans[0]["startTimeUnixNano"], "1000000000000");
  EXPECT_EQ(spans[0]["endTimeUnixNano"], "1001000000000");
  for (int k = 1; k < 4; ++k) {
    EXPECT_EQ(spans[k]["traceId"], kTrace);
    EXPECT_EQ(spans[k]["parentSpanId"], spans[0]["spanId"]);
  }
  EXPECT_EQ(spans[1]["name"], "queue");
  EXPECT_EQ(spans[2]["startTimeUnixNano"], spans[1]["endTimeUnixNano"]);
  EXPECT_EQ(spans[3]["name"], "features");
  EXPECT_EQ(spans[3]["endTimeUnixNano"], "1000750000000");
}

TEST(RequestLog, ALineHoldsWhatAnOperatorAsksFor) {
  RequestRecord r = SampleCall();
  auto line = nlohmann::json::parse(RequestLogLine(r));
  EXPECT_EQ(line["request_id"], "abc-1");
  EXPECT_EQ(line["state"], "RECOGNIZED");
  EXPECT_EQ(line["images"], 2);
  EXPECT_DOUBLE_EQ(line["queue_ms"], 250.0);
  EXPECT_DOUBLE_EQ(line["stages_ms"]["features"], 400.0);
  EXPECT_FALSE(line.contains("error"));
  r.status = absl::InvalidArgumentError("images[0]: \"bad\"\nline \xff");
  r.state = "";
  const std::string text = RequestLogLine(r);
  EXPECT_EQ(text.find('\n'), std::string::npos);
  line = nlohmann::json::parse(text);
  EXPECT_EQ(line["code"], "INVALID_ARGUMENT");
  EXPECT_FALSE(line.contains("state"));
}

}  // namespace
}  // namespace horopter
