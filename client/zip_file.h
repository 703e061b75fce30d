// Files in a ZIP archive.
#pragma once

#include <map>
#include <string>
#include <string_view>
#include <vector>

#include "absl/status/statusor.h"

namespace horopter {

// Contents by name, of those whose name ends with one of `endings` (small letters). Errors:
// INVALID_ARGUMENT (no archive, cut short, damaged, encrypted, another packing than deflate),
// RESOURCE_EXHAUSTED (over 1 GB unpacked).
absl::StatusOr<std::map<std::string, std::string>> Unzip(std::string_view bytes,
                                                         const std::vector<std::string>& endings);

}  // namespace horopter
