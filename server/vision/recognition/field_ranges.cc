#include "server/vision/recognition/field_ranges.h"

#include <cmath>
#include <string>

#include "absl/strings/str_cat.h"

namespace horopter {
namespace {

bool IsIn(FieldRange range, double x) {
  if (!std::isfinite(x)) return false;
  switch (range) {
    case FieldRange::kShare:
      return x >= 0.0 && x <= 1.0;
    case FieldRange::kPositive:
      return x > 0.0;
    case FieldRange::kNotNegative:
      return x >= 0.0;
  }
  return false;
}

}  // namespace

absl::Status CheckFields(std::string_view group, std::initializer_list<RangedField> fields) {
  for (const RangedField& f : fields) {
    if (!IsIn(f.range, f.value))
      return absl::InvalidArgumentError(
          absl::StrCat(std::string(group), ".", f.name, ": ", f.value, " is out of range"));
  }
  return absl::OkStatus();
}

}  // namespace horopter
