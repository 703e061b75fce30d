#include "client/calibration_values.h"

#include <cmath>

#include "absl/strings/numbers.h"
#include "absl/strings/str_split.h"
#include "client/calibration_document.h"

namespace horopter {

absl::StatusOr<std::vector<double>> FiniteNumbers(const YAML::Node& node,
                                                  const std::string& field) {
  std::vector<double> numbers;
  try {
    numbers = NumbersOf(node);
  } catch (const YAML::Exception&) {
    return Bad(field, "holds something that is no number");
  }
  for (const double n : numbers) {
    if (!std::isfinite(n)) return Bad(field, "a number is not finite");
  }
  return numbers;
}

// Numbers in a word: "0.1, 0.2", "[0 0 0]", "640x480".
absl::StatusOr<std::vector<double>> NumbersOfWord(const std::string& word,
                                                  const std::string& field) {
  std::vector<double> numbers;
  for (const std::string& part : std::vector<std::string>(
           absl::StrSplit(word, absl::ByAnyChar(" \t\r\n,;x[]()"), absl::SkipEmpty()))) {
    double number = 0.0;
    if (!absl::SimpleAtod(part, &number) || !std::isfinite(number))
      return Bad(field, "holds something that is no number");
    numbers.push_back(number);
  }
  return numbers;
}

}  // namespace horopter
