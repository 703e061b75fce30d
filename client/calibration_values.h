// Values of calibration files, with errors that name their field.
#pragma once

#include <yaml-cpp/yaml.h>

#include <optional>
#include <string>
#include <vector>

#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "absl/strings/str_cat.h"

namespace horopter {

inline absl::Status Bad(const std::string& field, const std::string& what) {
  return absl::InvalidArgumentError(absl::StrCat(field, ": ", what));
}

// The node's value; nothing where it is not there. Errors: it is none, naming the field.
template <typename T>
absl::StatusOr<std::optional<T>> NodeValue(const YAML::Node& node, const std::string& field) {
  if (!node.IsDefined() || node.IsNull()) return std::optional<T>();
  try {
    return std::optional<T>(node.as<T>());
  } catch (const YAML::Exception&) {
    return Bad(field, "is not what it should be");
  }
}

// All numbers of a list, of a list of lists, or of a map with `data`; empty where the node is of
// another kind. Errors: INVALID_ARGUMENT (no number, not finite).
absl::StatusOr<std::vector<double>> FiniteNumbers(const YAML::Node& node, const std::string& field);

// Numbers in a word: "0.1, 0.2", "[0 0 0]", "640x480". Errors: as above.
absl::StatusOr<std::vector<double>> NumbersOfWord(const std::string& word,
                                                  const std::string& field);

}  // namespace horopter
