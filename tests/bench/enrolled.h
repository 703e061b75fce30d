// Catalogs that a report works with: prepared from a data set, or kept in a catalog file.
#pragma once

#include <memory>
#include <string>
#include <vector>

#include "absl/status/status.h"
#include "server/vision/recognition/object/prepared_object.h"
#include "tests/diagnose/ground_truth.h"

namespace horopter {

// Objects and where the index has their keys.
struct Enrolled {
  std::vector<std::shared_ptr<const PreparedObject>> objects;
  std::vector<int> slots;

  void Add(const Enrolled& other, size_t i) {
    objects.push_back(other.objects[i]);
    slots.push_back(other.slots[i]);
  }
};

// Adds the prepared objects of a data set, each in the slot of its place; models (may be null)
// receives them as they were read. Errors: those of reading and preparing.
absl::Status AddPrepared(const std::string& folder, Enrolled* catalog, TrueModels* models);

// The same of a catalog file that Keep wrote. Errors: those of the catalog.
absl::Status AddKept(const std::string& file, Enrolled* catalog);

// Writes the objects from `first` on, with what was derived of them, into a new catalog file.
// Errors: those of the catalog.
absl::Status Keep(const Enrolled& catalog, size_t first, const std::string& file);

}  // namespace horopter
