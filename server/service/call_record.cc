#include "server/service/call_record.h"

#include <spdlog/spdlog.h>

#include <atomic>
#include <random>

#include "absl/strings/str_cat.h"
#include "absl/strings/str_format.h"
#include "server/base/status_macros.h"
#include "server/service/log_limiter.h"
#include "server/service/rpc_status.h"
#include "server/service/trace_context.h"

namespace horopter {
namespace {

using Clock = std::chrono::steady_clock;

constexpr char kTraceParentKey[] = "traceparent";

// Unique in this process; the random part tells the logs of two runs apart.
std::string NextRequestId() {
  static const uint32_t run = std::random_device{}();
  static std::atomic<int64_t> next{1};
  return absl::StrFormat("%08x-%06d", run, next++);
}

// "ipv4:10.0.0.7:41234" -> "ipv4:10.0.0.7": all connections of a machine are one peer.
std::string HostOfPeer(const std::string& peer) {
  return peer.substr(0, peer.rfind(':'));
}

// Of calls that fail, the log has some of a kind in a while: a client can bring about thousands.
bool IsTold(const char* method, const std::string& code, const std::string& host) {
  constexpr int kLines = 50;
  static LogLimiter& limiter = *new LogLimiter(kLines);
  const LogLimiter::Verdict verdict =
      limiter.Ask(absl::StrCat("method=", method, " peer=", host, " code=", code));
  for (const auto& [what, lines] : verdict.left_out) {
    spdlog::warn("{}: {} more such calls were left out of the log", what, lines);
  }
  return verdict.write;
}

}  // namespace

CallRecord::CallRecord(const CallMethod& method,
                       const CallGate& gate,
                       grpc::CallbackServerContext* context)
    : method_(method), gate_(gate), context_(context), start_(Clock::now()) {
  record_.request_id = NextRequestId();
  record_.method = method.name;
  record_.admin_call = method.needs == Role::kAdmin;
  record_.arrival = std::chrono::system_clock::now();
  context->AddInitialMetadata(kRequestIdKey, record_.request_id);
  const auto& metadata = context->client_metadata();
  const auto parent = metadata.find(kTraceParentKey);
  record_.trace = TraceContextFrom(
      parent == metadata.end() ? std::string_view()
                               : std::string_view(parent->second.data(), parent->second.size()));
}

absl::Status CallRecord::Authorize() {
  if (gate_.access == nullptr) return absl::PermissionDeniedError("nobody may call");
  const absl::StatusOr<Caller> caller = gate_.access->Authorize(*context_, method_.needs);
  record_.caller = caller.ok() ? caller->name : CallerOf(caller.status());
  if (!caller.ok()) return caller.status();
  role_ = caller->role;
  if (!record_.admin_call || gate_.sink == nullptr) return absl::OkStatus();
  record_.peer = context_->peer();
  return gate_.sink->BeforeAdminCall(record_);
}

std::string CallRecord::TurnOf() const {
  return record_.caller.empty() ? HostOfPeer(context_->peer()) : record_.caller;
}

void CallRecord::Begin() {
  record_.queue_seconds = SecondsSinceStart();
  begun_ = true;
}

grpc::Status CallRecord::End(const absl::Status& status) noexcept {
  try {
    Log(status);
    Tell(status);
    if (record_.catalog_age_ms)
      context_->AddTrailingMetadata(kCatalogAgeKey, absl::StrCat(*record_.catalog_age_ms));
  } catch (...) {
  }
  return ToRpcStatus(status, context_, record_.request_id);
}

double CallRecord::SecondsSinceStart() const {
  return std::chrono::duration<double>(Clock::now() - start_).count();
}

void CallRecord::Log(const absl::Status& status) const {
  const std::string code = absl::StatusCodeToString(status.code());
  if (!status.ok() && !IsTold(method_.name, code, HostOfPeer(context_->peer()))) return;
  const auto level = status.ok() ? spdlog::level::info : spdlog::level::warn;
  spdlog::log(level,
              "request={} method={} peer={} caller={} code={} ms={:.1f}{}",
              record_.request_id,
              method_.name,
              context_->peer(),
              record_.caller.empty() ? "-" : record_.caller,
              code,
              1e3 * SecondsSinceStart(),
              status.ok() ? "" : absl::StrCat(" error=", Quoted(std::string(status.message()))));
}

void CallRecord::Tell(const absl::Status& status) {
  if (gate_.sink == nullptr) return;
  record_.peer = context_->peer();
  record_.status = status;
  record_.busy = !RetryAfter(status).empty();
  record_.total_seconds = SecondsSinceStart();
  if (!begun_) record_.queue_seconds = record_.total_seconds;
  gate_.sink->OnRequest(record_);
}

}  // namespace horopter
