#include "server/service/rpc_status.h"

#include <grpcpp/server_context.h>
#include <grpcpp/support/status.h>

#include "absl/strings/cord.h"
#include "absl/strings/str_cat.h"
#include "server/service/error_details.h"

namespace horopter {
namespace {

constexpr char kFieldPayload[] = "horopter/error-field";
constexpr char kRetryPayload[] = "horopter/retry-after-ms";
constexpr char kLimitPayload[] = "horopter/limit";

std::string Payload(const absl::Status& status, const char* url) {
  const auto payload = status.GetPayload(url);
  return payload.has_value() ? std::string(*payload) : std::string();
}

// Metadata values must be printable ASCII; field names may quote user input.
std::string Printable(std::string text) {
  for (char& c : text) {
    if (c < 32 || c > 126) c = '?';
  }
  return text;
}

}  // namespace

absl::Status FieldError(absl::StatusCode code, std::string_view field, std::string_view what) {
  absl::Status status(code, absl::StrCat(std::string(field), ": ", std::string(what)));
  status.SetPayload(kFieldPayload, absl::Cord(std::string(field)));
  return status;
}

absl::Status PrefixField(std::string_view prefix, const absl::Status& status) {
  const std::string field = ErrorField(status);
  if (field.empty()) return status;
  const std::string message(status.message());
  absl::Status named(status.code(), absl::StrCat(std::string(prefix), message));
  status.ForEachPayload(
      [&](absl::string_view url, const absl::Cord& payload) { named.SetPayload(url, payload); });
  named.SetPayload(kFieldPayload, absl::Cord(absl::StrCat(std::string(prefix), field)));
  return named;
}

absl::Status InvalidField(std::string_view field, std::string_view what) {
  return FieldError(absl::StatusCode::kInvalidArgument, field, what);
}

absl::Status LimitExceeded(std::string_view limit, std::string_view what) {
  absl::Status status = absl::ResourceExhaustedError(
      absl::StrCat(std::string(what), " (limit ", std::string(limit), ")"));
  status.SetPayload(kLimitPayload, absl::Cord(std::string(limit)));
  return status;
}

absl::Status RetryLater(std::string_view what, int retry_after_ms) {
  absl::Status status = absl::ResourceExhaustedError(
      absl::StrCat(std::string(what), "; try again in ", retry_after_ms, " ms"));
  status.SetPayload(kRetryPayload, absl::Cord(absl::StrCat(retry_after_ms)));
  return status;
}

absl::Status QueueFull(int retry_after_ms) {
  return RetryLater("the request queue is full", retry_after_ms);
}

std::string EscapeControls(std::string_view text) {
  std::string out;
  for (const char c : text) {
    const auto byte = static_cast<unsigned char>(c);
    if (byte < 32 || byte == 127) {
      absl::StrAppend(&out, "\\x", absl::Hex(byte, absl::kZeroPad2));
    } else {
      out += c;
    }
  }
  return out;
}

std::string Quoted(std::string_view text) {
  std::string out = "\"";
  for (const char c : text) {
    if (c == '"' || c == '\\') out += '\\';
    out += c;
  }
  return EscapeControls(out) + "\"";
}

std::string ErrorField(const absl::Status& status) {
  const std::string field = Payload(status, kFieldPayload);
  if (!field.empty() || !absl::IsInvalidArgument(status)) return field;
  const std::string message(status.message());
  const size_t end = message.find(": ");
  if (end == std::string::npos) return "";
  const std::string prefix = message.substr(0, end);
  const bool is_field =
      prefix.find_first_not_of("abcdefghijklmnopqrstuvwxyz0123456789_.[]") == std::string::npos;
  return is_field ? prefix : "";
}

std::string LimitOf(const absl::Status& status) {
  return Payload(status, kLimitPayload);
}

std::string RetryAfter(const absl::Status& status) {
  return Payload(status, kRetryPayload);
}

grpc::Status ToRpcStatus(const absl::Status& status,
                         grpc::CallbackServerContext* context,
                         std::string_view request_id) noexcept try {
  if (status.ok()) return grpc::Status::OK;
  if (const std::string field = ErrorField(status); !field.empty()) {
    context->AddTrailingMetadata(kErrorFieldKey, Printable(field));
  }
  if (const std::string retry = RetryAfter(status); !retry.empty()) {
    context->AddTrailingMetadata(kRetryAfterKey, retry);
  }
  // absl and gRPC number the canonical codes alike.
  return grpc::Status(static_cast<grpc::StatusCode>(status.code()),
                      std::string(status.message()),
                      ErrorDetails(status, request_id));
} catch (...) {
  return grpc::Status(static_cast<grpc::StatusCode>(status.code()), "");
}

}  // namespace horopter
