#include "server/service/trace_context.h"

#include <mutex>
#include <nlohmann/json.hpp>
#include <random>

#include "absl/strings/str_cat.h"
#include "absl/strings/str_format.h"

namespace horopter {
namespace {

// Not zero, which means "no id".
uint64_t RandomId() {
  static std::mutex mutex;
  static std::mt19937_64 random = [] {
    std::random_device device;
    std::seed_seq seed{device(), device(), device(), device()};
    return std::mt19937_64(seed);
  }();
  const std::lock_guard lock(mutex);
  uint64_t id = 0;
  while (id == 0) id = random();
  return id;
}

std::string NewSpanId() {
  return absl::StrFormat("%016x", RandomId());
}

bool IsHexId(std::string_view text) {
  return text.find_first_not_of("0123456789abcdef") == std::string_view::npos &&
         text.find_first_not_of('0') != std::string_view::npos;
}

bool IsHex(std::string_view text) {
  return text.find_first_not_of("0123456789abcdef") == std::string_view::npos;
}

nlohmann::json Attribute(const char* key, const std::string& value) {
  return {{"key", key}, {"value", {{"stringValue", value}}}};
}

class SpanWriter {
 public:
  explicit SpanWriter(const RequestRecord& record) : record_(record) {}

  nlohmann::json Span(const std::string& name,
                      const std::string& id,
                      const std::string& parent,
                      double from_s,
                      double to_s) const {
    nlohmann::json span = {{"traceId", record_.trace.trace_id},
                           {"spanId", id},
                           {"name", name},
                           {"startTimeUnixNano", Nanos(from_s)},
                           {"endTimeUnixNano", Nanos(to_s)}};
    if (!parent.empty()) span["parentSpanId"] = parent;
    return span;
  }

 private:
  // 64-bit numbers are strings in OTLP/JSON.
  std::string Nanos(double offset_s) const {
    const auto start =
        std::chrono::duration_cast<std::chrono::nanoseconds>(record_.arrival.time_since_epoch());
    return absl::StrCat(start.count() + static_cast<int64_t>(offset_s * 1e9));
  }

  const RequestRecord& record_;
};

}  // namespace

TraceContext TraceContextFrom(std::string_view header) {
  TraceContext context;
  context.span_id = NewSpanId();
  // version "-" trace-id "-" parent-id "-" flags; later versions may append fields.
  const bool shape = header.size() >= 55 && header[2] == '-' && header[35] == '-' &&
                     header[52] == '-' && (header.size() == 55 || header[55] == '-');
  if (shape && IsHex(header.substr(0, 2)) && header.substr(0, 2) != "ff" &&
      (header.size() == 55 || header.substr(0, 2) != "00") && IsHexId(header.substr(3, 32)) &&
      IsHexId(header.substr(36, 16)) && IsHex(header.substr(53, 2))) {
    context.trace_id = header.substr(3, 32);
    context.parent_span_id = header.substr(36, 16);
    const char last = header[54];
    context.sampled = ((last >= 'a' ? last - 'a' + 10 : last - '0') & 1) != 0;
    return context;
  }
  context.trace_id = absl::StrFormat("%016x%016x", RandomId(), RandomId());
  return context;
}

std::string OtlpJson(const RequestRecord& record) {
  const SpanWriter writer(record);
  const TraceContext& trace = record.trace;
  nlohmann::json call = writer.Span("horopter.v1/" + record.method,
                                    trace.span_id,
                                    trace.parent_span_id,
                                    0.0,
                                    record.total_seconds);
  constexpr int kServer = 2, kInternal = 1, kError = 2;
  call["kind"] = kServer;
  call["attributes"] = {Attribute("horopter.request_id", record.request_id),
                        Attribute("rpc.system", "grpc"),
                        Attribute("horopter.state", record.state)};
  if (!record.status.ok()) {
    call["status"] = {{"code", kError},
                      {"message", absl::StatusCodeToString(record.status.code())}};
  }
  nlohmann::json spans = {call};
  double at = record.queue_seconds;
  nlohmann::json queue = writer.Span("queue", NewSpanId(), trace.span_id, 0.0, at);
  queue["kind"] = kInternal;
  spans.push_back(queue);
  for (const auto& [stage, seconds] : record.stages) {
    nlohmann::json span = writer.Span(stage, NewSpanId(), trace.span_id, at, at + seconds);
    span["kind"] = kInternal;
    spans.push_back(span);
    at += seconds;
  }
  const nlohmann::json resource = {{"attributes", {Attribute("service.name", "horopterd")}}};
  const nlohmann::json scope = {{"scope", {{"name", "horopter"}}}, {"spans", spans}};
  const nlohmann::json line = {
      {"resourceSpans",
       nlohmann::json::array(
           {{{"resource", resource}, {"scopeSpans", nlohmann::json::array({scope})}}})}};
  return line.dump(-1, ' ', false, nlohmann::json::error_handler_t::replace);
}

}  // namespace horopter
