// absl::Status -> gRPC, with the offending field beside the message.
#pragma once

#include <string>
#include <string_view>

#include "absl/status/status.h"

namespace grpc {
class CallbackServerContext;
class Status;
}  // namespace grpc

namespace horopter {

// Keys of metadata: a call may bring the first two, the next three trail an answer, the last begins
// it.
inline constexpr char kVariantsKey[] = "horopter-variants";
inline constexpr char kMinGenerationKey[] = "horopter-min-generation";
inline constexpr char kCatalogAgeKey[] = "horopter-catalog-age-ms";
inline constexpr char kErrorFieldKey[] = "horopter-error-field";
inline constexpr char kRetryAfterKey[] = "retry-after-ms";
inline constexpr char kRequestIdKey[] = "horopter-request-id";

// INVALID_ARGUMENT "field: what"; the field also travels by itself (see ErrorField).
absl::Status InvalidField(std::string_view field, std::string_view what);

// The same for any code, e.g. NOT_FOUND of a candidate.
absl::Status FieldError(absl::StatusCode code, std::string_view field, std::string_view what);

// The same status with `prefix` before the field it names, if it names one: what is wrong with an
// object is wrong with that field of the request.
absl::Status PrefixField(std::string_view prefix, const absl::Status& status);

// RESOURCE_EXHAUSTED of a documented limit of the server, by its name in ServerLimits.
absl::Status LimitExceeded(std::string_view limit, std::string_view what);

// RESOURCE_EXHAUSTED with the time after which to try again.
absl::Status RetryLater(std::string_view what, int retry_after_ms);
absl::Status QueueFull(int retry_after_ms);

// Text for one line of a log: control characters become \xNN, so that nothing a client sends ends
// the line.
std::string EscapeControls(std::string_view text);

// The same in quotation marks; quotation marks and backslashes in it are escaped as well, so that
// nothing looks like another field.
std::string Quoted(std::string_view text);

// The field set by InvalidField, or the one that begins the message of an INVALID_ARGUMENT
// ("edges[3].kind: ..."); empty when there is none.
std::string ErrorField(const absl::Status& status);

// Milliseconds set by QueueFull; empty for any other status.
std::string RetryAfter(const absl::Status& status);

// Name set by LimitExceeded; empty for any other status.
std::string LimitOf(const absl::Status& status);

// Puts field and retry time into the context's trailing metadata and returns the status in gRPC's
// type; where there is no memory for words the code comes alone.
grpc::Status ToRpcStatus(const absl::Status& status,
                         grpc::CallbackServerContext* context,
                         std::string_view request_id = {}) noexcept;

}  // namespace horopter
