#include "server/pipeline/select_objects.h"

#include <algorithm>
#include <numeric>
#include <string>

#include "absl/strings/str_cat.h"
#include "server/base/status_macros.h"

namespace horopter {

const std::string& IdAt(const CatalogSnapshot& catalog, int index) {
  return catalog.stored.empty() ? catalog.objects[index]->model.id : catalog.stored[index]->id();
}

int FindObject(const CatalogSnapshot& catalog, const std::string& id) {
  int low = 0, high = ObjectCount(catalog);
  while (low < high) {
    const int middle = low + (high - low) / 2;
    if (IdAt(catalog, middle) < id) {
      low = middle + 1;
    } else {
      high = middle;
    }
  }
  return low < ObjectCount(catalog) && IdAt(catalog, low) == id ? low : -1;
}

int ObjectCount(const CatalogSnapshot& catalog) {
  return static_cast<int>(std::max(catalog.objects.size(), catalog.stored.size()));
}

absl::StatusOr<std::shared_ptr<const PreparedObject>> ObjectAt(const CatalogSnapshot& catalog,
                                                               int index) {
  if (catalog.stored.empty()) return catalog.objects[index];
  return catalog.stored[index]->Get();
}

absl::StatusOr<std::shared_ptr<const PreparedObject>> ObjectById(const CatalogSnapshot& catalog,
                                                                 const std::string& id) {
  const int index = FindObject(catalog, id);
  if (index < 0) return absl::NotFoundError(absl::StrCat("object ", id, " is not enrolled"));
  return ObjectAt(catalog, index);
}

std::vector<std::string> ExpectedIds(const SceneRequest& request) {
  std::vector<std::string> out;
  for (const ExpectedPart& part : request.expected_parts) {
    out.push_back(part.object_id);
    if (!part.frame_object.empty()) out.push_back(part.frame_object);
  }
  return out;
}

absl::StatusOr<Selection> SelectObjects(const SceneRequest& request,
                                        const CatalogSnapshot& catalog,
                                        int most) {
  const std::vector<ReferenceObject> references = ReferencesOf(request);
  for (const ReferenceObject& reference : references) {
    if (FindObject(catalog, reference.object_id) >= 0) continue;
    return absl::NotFoundError(
        absl::StrCat("reference.object: ", reference.object_id, " is not enrolled"));
  }
  if (!request.explained.empty() && FindObject(catalog, request.explained) < 0) {
    return absl::NotFoundError(
        absl::StrCat("explained: object ", request.explained, " is not enrolled"));
  }
  std::vector<int> selected;
  if (request.candidates.empty()) {
    selected.resize(ObjectCount(catalog));
    std::iota(selected.begin(), selected.end(), 0);
  }
  std::vector<std::string> wanted = request.candidates;
  for (const ReferenceObject& reference : references) {
    if (!request.candidates.empty()) wanted.push_back(reference.object_id);
  }
  for (const std::string& id : ExpectedIds(request)) {
    if (FindObject(catalog, id) < 0)
      return absl::NotFoundError(absl::StrCat("expected_parts: ", id, " is not enrolled"));
    if (!request.candidates.empty()) wanted.push_back(id);
  }
  if (!wanted.empty() && !request.explained.empty()) wanted.push_back(request.explained);
  std::sort(wanted.begin(), wanted.end());
  wanted.erase(std::unique(wanted.begin(), wanted.end()), wanted.end());
  for (const std::string& id : wanted) {
    selected.push_back(FindObject(catalog, id));
    if (selected.back() < 0) {
      return absl::NotFoundError(absl::StrCat("candidate_objects: ", id, " is not enrolled"));
    }
  }
  if (static_cast<int>(selected.size()) > most) {
    return absl::InvalidArgumentError(absl::StrCat("candidate_objects: ",
                                                   selected.size(),
                                                   " objects, at most ",
                                                   most,
                                                   " are searched for at once "
                                                   "(max_searched_objects)"));
  }
  const bool keyed = static_cast<int>(catalog.slots.size()) == ObjectCount(catalog);
  Selection out;
  for (const int index : selected) {
    HOROPTER_ASSIGN_OR_RETURN(out.objects.emplace_back(), ObjectAt(catalog, index));
    if (keyed) out.slots.push_back(catalog.slots[index]);
  }
  return out;
}

}  // namespace horopter
