// Which objects of a catalog a request is about.
#pragma once

#include <memory>
#include <string>
#include <vector>

#include "absl/status/statusor.h"
#include "server/pipeline/pipeline.h"

namespace horopter {

struct Selection {
  std::vector<std::shared_ptr<const PreparedObject>> objects;
  std::vector<int> slots;  // of the objects in the catalog's keys; empty when it has none
};

// Id of one of a catalog's objects, and the index of the object with an id, or -1.
const std::string& IdAt(const CatalogSnapshot& catalog, int index);
int FindObject(const CatalogSnapshot& catalog, const std::string& id);

// The object of this id. Errors: NOT_FOUND, those of the stored objects.
absl::StatusOr<std::shared_ptr<const PreparedObject>> ObjectById(const CatalogSnapshot& catalog,
                                                                 const std::string& id);

// The objects that the request expects, and those in whose frames it expects them.
std::vector<std::string> ExpectedIds(const SceneRequest& request);

// The candidates, references, expected and explained objects, or all; in the catalog's order.
// Errors: NOT_FOUND (one of them is not enrolled), INVALID_ARGUMENT (more than `most`), those of
// the stored objects.
absl::StatusOr<Selection> SelectObjects(const SceneRequest& request,
                                        const CatalogSnapshot& catalog,
                                        int most);

}  // namespace horopter
