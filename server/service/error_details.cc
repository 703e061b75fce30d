#include "server/service/error_details.h"

#include <google/protobuf/util/time_util.h>

#include <string_view>

#include "absl/strings/numbers.h"
#include "absl/strings/str_cat.h"
#include "horopter/v1/errors.pb.h"
#include "server/service/rpc_status.h"

namespace horopter {
namespace {

// The trailing metadata of a call are 8 KiB at most, and may quote what a client sent.
std::string ShortText(std::string_view text) {
  constexpr size_t kMost = 1000;
  std::string out(text.substr(0, kMost));
  for (char& c : out) {
    if (c < 32 || c > 126) c = '?';
  }
  return out;
}

// Libraries that have googleapis-common-protos know these names.
void AddDetail(const char* name, const google::protobuf::Message& detail, v1::Status* status) {
  google::protobuf::Any* any = status->add_details();
  any->set_type_url(absl::StrCat("type.googleapis.com/google.rpc.", name));
  detail.SerializeToString(any->mutable_value());
}

}  // namespace

std::string ErrorReason(const absl::Status& status) {
  switch (status.code()) {
    case absl::StatusCode::kInvalidArgument:
      return ErrorField(status).empty() ? "REQUEST_INVALID" : "FIELD_INVALID";
    case absl::StatusCode::kResourceExhausted:
      return RetryAfter(status).empty() ? "LIMIT_EXCEEDED" : "SERVER_BUSY";
    case absl::StatusCode::kAborted:
      return "ETAG_MISMATCH";
    case absl::StatusCode::kUnavailable:
      return "SERVER_STOPPING";
    case absl::StatusCode::kDataLoss:
      return "CATALOG_DAMAGED";
    case absl::StatusCode::kFailedPrecondition:
      return "PRECONDITION_FAILED";
    case absl::StatusCode::kNotFound:
    case absl::StatusCode::kAlreadyExists:
    case absl::StatusCode::kDeadlineExceeded:
    case absl::StatusCode::kCancelled:
    case absl::StatusCode::kPermissionDenied:
    case absl::StatusCode::kUnauthenticated:
      return absl::StatusCodeToString(status.code());
    default:
      return "INTERNAL";
  }
}

std::string ErrorDetails(const absl::Status& status, std::string_view request_id) {
  v1::Status out;
  out.set_code(static_cast<int32_t>(status.code()));
  out.set_message(ShortText(std::string(status.message())));
  v1::ErrorInfo info;
  info.set_reason(ErrorReason(status));
  info.set_domain("horopter");
  if (const std::string limit = LimitOf(status); !limit.empty()) {
    (*info.mutable_metadata())["limit"] = limit;
  }
  AddDetail("ErrorInfo", info, &out);
  if (const std::string field = ErrorField(status); !field.empty()) {
    v1::BadRequest bad;
    v1::BadRequest::FieldViolation* violation = bad.add_field_violations();
    violation->set_field(ShortText(field));
    violation->set_description(out.message());
    AddDetail("BadRequest", bad, &out);
  }
  int64_t retry_ms = 0;
  if (absl::SimpleAtoi(RetryAfter(status), &retry_ms)) {
    v1::RetryInfo retry;
    *retry.mutable_retry_delay() =
        google::protobuf::util::TimeUtil::MillisecondsToDuration(retry_ms);
    AddDetail("RetryInfo", retry, &out);
  }
  if (!request_id.empty()) {
    v1::RequestInfo request;
    request.set_request_id(std::string(request_id));
    AddDetail("RequestInfo", request, &out);
  }
  return out.SerializeAsString();
}

}  // namespace horopter
