// What a failed call says to programs beside its code.
#pragma once

#include <string>
#include <string_view>

#include "absl/status/status.h"

namespace horopter {

// The stable name of ErrorInfo in errors.proto; never empty.
std::string ErrorReason(const absl::Status& status);

// The details of a failed call as google.rpc.Status, serialised (errors.proto); at most 4 KiB.
// `request_id`: of the call in the server's log; empty: not told.
std::string ErrorDetails(const absl::Status& status, std::string_view request_id = {});

}  // namespace horopter
