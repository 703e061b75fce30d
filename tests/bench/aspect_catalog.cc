#include "tests/bench/aspect_catalog.h"

#include <fstream>
#include <sstream>

#include "server/base/parallel_for.h"
#include "server/base/status_macros.h"
#include "server/vision/recognition/aspects/fragment_blob.h"
#include "tests/diagnose/ground_truth.h"

namespace horopter {
namespace {

std::string ReadAll(const std::string& path) {
  std::ifstream in(path, std::ios::binary);
  std::stringstream text;
  text << in.rdbuf();
  return text.str();
}

absl::Status LoadPart(const ObjectModel& model,
                      const std::string& cache,
                      ObjectAspects* object,
                      PartFragments* fragments) {
  const std::string stem = cache + "/" + model.id;
  if (!cache.empty()) {
    auto known = DecodeObjectAspects(ReadAll(stem + ".aspects"), model);
    if (known.ok()) {
      *object = *std::move(known);
      auto drawn = DecodePartFragments(ReadAll(stem + ".fragments"), object->aspects);
      if (drawn.ok()) {
        *fragments = *std::move(drawn);
        return absl::OkStatus();
      }
    }
  }
  HOROPTER_ASSIGN_OR_RETURN(*object, MakeObjectAspects(model));
  *fragments = MakePartFragments(object->mesh, object->aspects);
  if (cache.empty()) return absl::OkStatus();
  std::ofstream(stem + ".aspects", std::ios::binary) << EncodeObjectAspects(*object, model);
  std::ofstream(stem + ".fragments", std::ios::binary)
      << EncodePartFragments(*fragments, object->aspects);
  return absl::OkStatus();
}

}  // namespace

absl::Status LoadAspectCatalog(const BopDataset& dataset,
                               const std::string& cache,
                               AspectCatalog* catalog) {
  HOROPTER_ASSIGN_OR_RETURN(auto models, ReadTrueModels(dataset));
  for (auto& [obj_id, model] : models) {
    catalog->obj_ids.push_back(obj_id);
    catalog->models.push_back(std::move(model));
  }
  const int n = static_cast<int>(catalog->models.size());
  catalog->objects.resize(n);
  catalog->fragments.resize(n);
  std::vector<absl::Status> status(n);
  ParallelFor(n, 2, [&](int i) {
    status[i] = LoadPart(catalog->models[i], cache, &catalog->objects[i], &catalog->fragments[i]);
  });
  for (const absl::Status& s : status) HOROPTER_RETURN_IF_ERROR(s);
  for (int i = 0; i < n; ++i) {
    catalog->parts.push_back(
        {&catalog->objects[i], &catalog->fragments[i], catalog->models[i].symmetries});
  }
  HOROPTER_ASSIGN_OR_RETURN(catalog->index, BuildFragmentIndex(catalog->parts));
  return absl::OkStatus();
}

}  // namespace horopter
