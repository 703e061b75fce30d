// The entities of a STEP file as they are written (ISO 10303-21), beside what OpenCASCADE makes of
// them.
#pragma once

#include <string>
#include <string_view>
#include <unordered_map>
#include <utility>
#include <vector>

#include "absl/status/statusor.h"

namespace horopter {

// Views into a text that must outlive it.
class StepText {
 public:
  // Errors: INVALID_ARGUMENT (no STEP file, cut short).
  static absl::StatusOr<StepText> Parse(std::string_view text);

  bool Holds(int id) const { return bodies_.contains(id); }
  // The type of an entity, the first of a complex one; empty where there is no such entity.
  std::string TypeOf(int id) const;
  bool Is(int id, std::string_view type) const;
  // Those of a type in the order of the file; complex ones under each of theirs.
  const std::vector<int>& OfType(std::string_view type) const;
  // All types whose name has this in it.
  std::vector<int> OfTypesLike(std::string_view part) const;
  // Parameters of the type, or of a simple entity; empty where it is of another type.
  std::vector<std::string_view> Parameters(int id, std::string_view type = "") const;
  // One of them, empty where it is not there; and the entity that it names, or 0.
  std::string_view Parameter(int id, size_t number, std::string_view type = "") const;
  int Named(int id, size_t number, std::string_view type = "") const;
  // Entities that this one names, in their order.
  std::vector<int> ReferencesOf(int id) const;
  // Entities that name this one.
  std::vector<int> UsersOf(int id) const;
  const std::vector<int>& ids() const { return ids_; }

 private:
  std::unordered_map<int, std::string_view> bodies_;
  std::unordered_map<std::string_view, std::vector<int>> by_type_;
  std::vector<int> ids_;
  std::vector<std::pair<int, int>> users_;  // named, naming; sorted
};

// Whether the entity is a representation of a shape, which holds bodies or places those of others.
bool IsShapeRepresentation(const StepText& step, int id);

// What is between the brackets of a list, parted at its commas; a single value as itself.
std::vector<std::string_view> StepList(std::string_view parameter);

// The number of "#12", or 0.
int StepReference(std::string_view parameter);

// A string parameter in UTF-8: doubled quotes, \S\, \X\, \X2\ and \X4\ are decoded; UTF-8 and
// Latin-1 as many programs write them, against the norm, are kept. Empty for what is no string.
std::string StepString(std::string_view parameter);

// Whether it is UTF-8 without control characters.
bool IsCleanUtf8(std::string_view text);

}  // namespace horopter
