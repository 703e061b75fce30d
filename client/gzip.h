// Files packed with gzip.
#pragma once

#include <string>
#include <string_view>

#include "absl/status/statusor.h"

namespace horopter {

bool IsGzip(std::string_view bytes);

// What is packed, of all members of the file. Errors: INVALID_ARGUMENT (damaged, cut short),
// RESOURCE_EXHAUSTED (over 1 GB unpacked).
absl::StatusOr<std::string> Gunzip(std::string_view bytes);

}  // namespace horopter
