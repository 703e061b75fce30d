#include "tests/bench/enrolled.h"

#include <utility>

#include "client/bop_dataset.h"
#include "db/catalog.h"
#include "server/base/parallel_for.h"
#include "server/pipeline/pipeline.h"
#include "server/vision/recognition/object/prepared_blob.h"

namespace horopter {
namespace {

constexpr int kPage = 500;  // objects read or written at once

}  // namespace

absl::Status AddPrepared(const std::string& folder, Enrolled* catalog, TrueModels* models) {
  const auto dataset = ReadBopDataset(folder);
  if (!dataset.ok()) {
    return dataset.status();
  }
  auto read = ReadTrueModels(*dataset);
  if (!read.ok()) {
    return read.status();
  }
  std::vector<ObjectModel> list;
  for (const auto& [obj_id, model] : *read) {
    list.push_back(model);
  }
  const size_t first = catalog->objects.size();
  catalog->objects.resize(first + list.size());
  std::vector<absl::Status> status(list.size());
  ParallelFor(static_cast<int>(list.size()), 2, [&](int i) {
    auto prepared = PrepareCatalogObject(std::move(list[i]));
    status[i] = prepared.status();
    if (prepared.ok()) {
      catalog->objects[first + i] = *std::move(prepared);
    }
  });
  for (const absl::Status& s : status) {
    if (!s.ok()) {
      return s;
    }
  }
  for (size_t i = first; i < catalog->objects.size(); ++i) {
    catalog->slots.push_back(static_cast<int>(i));
  }
  if (models != nullptr) {
    *models = *std::move(read);
  }
  return absl::OkStatus();
}

absl::Status AddKept(const std::string& file, Enrolled* catalog) {
  const auto from = Catalog::Open(file);
  if (!from.ok()) {
    return from.status();
  }
  std::string last;
  while (true) {
    auto page = (*from)->LoadObjects(last, kPage);
    if (!page.ok()) {
      return page.status();
    }
    if (page->empty()) {
      return absl::OkStatus();
    }
    last = page->back().model.id;
    for (LoadedObject& object : *page) {
      auto restored = RestorePrepared(
          std::move(object.model), {object.derived.data, object.derived.keys}, {.aspects = true});
      if (!restored.ok()) {
        return restored.status();
      }
      catalog->slots.push_back(static_cast<int>(catalog->objects.size()));
      catalog->objects.push_back(*std::move(restored));
    }
  }
}

absl::Status Keep(const Enrolled& catalog, size_t first, const std::string& file) {
  const auto to = Catalog::Open(file);
  if (!to.ok()) {
    return to.status();
  }
  std::vector<Catalog::NewObject> batch;
  for (size_t i = first; i < catalog.objects.size(); ++i) {
    const PreparedBytes bytes = EncodePrepared(*catalog.objects[i], {.aspects = true});
    Catalog::NewObject& object = batch.emplace_back();
    object.record.model = catalog.objects[i]->model;
    object.record.create_time = object.record.update_time = "2026-01-01T00:00:00Z";
    object.derived = {kPreparedVersion, bytes.data, bytes.keys};
    if (batch.size() < kPage && i + 1 < catalog.objects.size()) {
      continue;
    }
    const absl::Status status = (*to)->CreateObjects(batch);
    if (!status.ok()) {
      return status;
    }
    batch.clear();
  }
  return absl::OkStatus();
}

}  // namespace horopter
