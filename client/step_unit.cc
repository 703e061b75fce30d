#include "client/step_unit.h"

#include <algorithm>
#include <cmath>
#include <map>
#include <optional>

#include "absl/strings/ascii.h"
#include "absl/strings/match.h"
#include "client/mesh_text.h"

namespace horopter {
namespace {

// The number in "LENGTH_MEASURE(25.4)" or "25.4".
double Measure(std::string_view parameter) {
  const size_t open = parameter.find('('), close = parameter.rfind(')');
  if (open != std::string_view::npos && close != std::string_view::npos && close > open) {
    parameter = parameter.substr(open + 1, close - open - 1);
  }
  const auto words = WordsOf(parameter);
  const auto value = words.empty() ? std::nullopt : ParseNumber(words[0]);
  return value.value_or(0.0);
}

double MetresOfSi(const StepText& step, int unit) {
  static const std::map<std::string_view, double> kPrefixes = {{"$", 1.0},
                                                               {"*", 1.0},
                                                               {".KILO.", 1e3},
                                                               {".HECTO.", 1e2},
                                                               {".DECA.", 1e1},
                                                               {".DECI.", 1e-1},
                                                               {".CENTI.", 1e-2},
                                                               {".MILLI.", 1e-3},
                                                               {".MICRO.", 1e-6},
                                                               {".NANO.", 1e-9},
                                                               {".MEGA.", 1e6},
                                                               {".GIGA.", 1e9}};
  if (step.Parameter(unit, 1, "SI_UNIT") != ".METRE.") return 0.0;
  const auto prefix = kPrefixes.find(step.Parameter(unit, 0, "SI_UNIT"));
  return prefix == kPrefixes.end() ? 0.0 : prefix->second;
}

// Metres in a length unit, 0 where it has none.
double MetresOf(const StepText& step, int unit, int depth = 0) {
  constexpr int kDeepest = 8;
  if (step.Is(unit, "SI_UNIT")) return MetresOfSi(step, unit);
  if (!step.Is(unit, "CONVERSION_BASED_UNIT") || depth > kDeepest) return 0.0;
  const int measure = step.Named(unit, 1, "CONVERSION_BASED_UNIT");
  const char* type = step.Is(measure, "MEASURE_WITH_UNIT") ? "MEASURE_WITH_UNIT" : "";
  return Measure(step.Parameter(measure, 0, type)) *
         MetresOf(step, step.Named(measure, 1, type), depth + 1);
}

std::string WordOf(const StepText& step, int unit) {
  if (step.Is(unit, "CONVERSION_BASED_UNIT")) {
    return absl::AsciiStrToLower(StepString(step.Parameter(unit, 0, "CONVERSION_BASED_UNIT")));
  }
  std::string prefix(step.Parameter(unit, 0, "SI_UNIT"));
  prefix.erase(
      std::remove_if(prefix.begin(),
                     prefix.end(),
                     [](char c) { return !absl::ascii_isalpha(static_cast<unsigned char>(c)); }),
      prefix.end());
  return absl::AsciiStrToLower(prefix) + "metre";
}

}  // namespace

StepUnit LengthUnitOf(const StepText& step) {
  StepUnit first;
  for (const int context : step.OfType("GLOBAL_UNIT_ASSIGNED_CONTEXT")) {
    const auto users = step.UsersOf(context);
    if (std::none_of(users.begin(), users.end(), [&](int user) {
          return IsShapeRepresentation(step, user);
        })) {
      continue;
    }
    for (const std::string_view unit :
         StepList(step.Parameter(context, 0, "GLOBAL_UNIT_ASSIGNED_CONTEXT"))) {
      const int id = StepReference(unit);
      if (!step.Is(id, "LENGTH_UNIT")) continue;
      const double metres = MetresOf(step, id);
      if (!(metres > 0.0) || !std::isfinite(metres)) continue;
      if (first.metres == 0.0) {
        first = {WordOf(step, id), metres, false};
      } else {
        first.mixed = first.mixed || std::abs(metres / first.metres - 1.0) > 1e-6;
      }
    }
  }
  return first;
}

}  // namespace horopter
