// Ranges of options' fields, checked by name.
#pragma once

#include <initializer_list>
#include <string_view>

#include "absl/status/status.h"

namespace horopter {

enum class FieldRange { kShare, kPositive, kNotNegative };

struct RangedField {
  const char* name;
  double value;
  FieldRange range;
};

// Errors: INVALID_ARGUMENT, "group.name: value is out of range", of the first that is not finite or
// not in its range.
absl::Status CheckFields(std::string_view group, std::initializer_list<RangedField> fields);

}  // namespace horopter
