#include "server/service/catalog_store.h"

#include <spdlog/spdlog.h>

#include <algorithm>
#include <utility>

#include "absl/strings/str_cat.h"
#include "server/base/crash_point.h"
#include "server/base/parallel_for.h"
#include "server/base/status_macros.h"

namespace horopter {
namespace {

using Prepared = std::shared_ptr<const PreparedObject>;

// Objects read, prepared and stored together: enough to keep all threads busy, few enough that a
// kill loses little of a long rebuild.
constexpr int kLoadPage = 256;

struct Loaded {
  absl::StatusOr<Prepared> object = absl::UnknownError("not loaded");
  std::string new_data;  // to be stored; empty: the stored ones are right
};

Loaded LoadOne(Catalog& catalog, LoadedObject stored, const ObjectPreparer& preparer) {
  Loaded result;
  const std::string id = stored.model.id;
  if (stored.derived.version == preparer.version && !stored.derived.data.empty()) {
    result.object = preparer.restore(std::move(stored.model), stored.derived.data);
    if (result.object.ok()) return result;
    // Damaged data, which is rare: the model, which was given away, is read once more.
    absl::StatusOr<CatalogRecord> record = catalog.GetObject(id);
    if (!record.ok()) {
      result.object = record.status();
      return result;
    }
    stored.model = std::move(record->model);
  }
  result.object = preparer.prepare(std::move(stored.model));
  if (result.object.ok()) result.new_data = preparer.encode(**result.object);
  return result;
}

std::vector<Loaded> LoadPage(Catalog& catalog,
                             std::vector<LoadedObject> page,
                             const ObjectPreparer& preparer,
                             int threads) {
  std::vector<Loaded> loaded(page.size());
  ParallelFor(static_cast<int>(page.size()), threads, [&](int i) {
    loaded[i] = LoadOne(catalog, std::move(page[i]), preparer);
  });
  return loaded;
}

}  // namespace

bool PublishedCatalog::Contains(const std::string& id) const {
  return std::binary_search(ids.begin(), ids.end(), id);
}

CatalogStore::CatalogStore(std::unique_ptr<Catalog> catalog, ObjectPreparer preparer)
    : catalog_(std::move(catalog)), preparer_(std::move(preparer)) {}

absl::StatusOr<std::unique_ptr<CatalogStore>> CatalogStore::Load(std::unique_ptr<Catalog> catalog,
                                                                 ObjectPreparer preparer,
                                                                 int threads) {
  std::unique_ptr<CatalogStore> store(new CatalogStore(std::move(catalog), std::move(preparer)));
  LoadReport& report = store->load_report_;
  auto published = std::make_shared<PublishedCatalog>();
  published->snapshot.generation = 1;
  std::string after;
  while (true) {
    HOROPTER_ASSIGN_OR_RETURN(std::vector<LoadedObject> page,
                              store->catalog_->LoadObjects(after, kLoadPage));
    if (page.empty()) break;
    std::vector<std::string> ids;
    for (const LoadedObject& object : page) ids.push_back(object.model.id);
    std::vector<Loaded> loaded =
        LoadPage(*store->catalog_, std::move(page), store->preparer_, threads);
    std::vector<std::pair<std::string, DerivedData>> made;
    for (size_t i = 0; i < ids.size(); ++i) {
      if (!loaded[i].object.ok()) {
        report.failures.push_back(absl::StrCat(
            "object ", ids[i], ": ", std::string(loaded[i].object.status().message())));
        continue;
      }
      if (loaded[i].new_data.empty()) {
        ++report.restored;
      } else {
        ++report.prepared;
        made.push_back({ids[i], {store->preparer_.version, std::move(loaded[i].new_data)}});
      }
      published->ids.push_back(ids[i]);
      published->snapshot.objects.push_back(*std::move(loaded[i].object));
    }
    // A full disk is no reason not to serve.
    if (!made.empty()) report.stored.Update(store->catalog_->StoreDerived(made));
    after = ids.back();
  }
  HOROPTER_RETURN_IF_ERROR(store->BuildIndex(published.get()));
  store->published_ = std::move(published);
  return store;
}

std::shared_ptr<const PublishedCatalog> CatalogStore::Published() const {
  const std::lock_guard lock(published_mutex_);
  return published_;
}

absl::Status CatalogStore::Create(const CatalogRecord& record) {
  // A taken id is told before the time of a preparation is spent; the database decides in the end.
  if (catalog_->GetSummary(record.model.id).ok()) {
    return absl::AlreadyExistsError(
        absl::StrCat("object '", record.model.id, "' is already in the catalog"));
  }
  HOROPTER_ASSIGN_OR_RETURN(Prepared prepared, preparer_.prepare(record.model));
  const DerivedData derived{preparer_.version, preparer_.encode(*prepared)};
  const std::lock_guard lock(write_mutex_);
  HOROPTER_RETURN_IF_ERROR(catalog_->CreateObject(record, derived));
  Publish(record.model.id, std::move(prepared));
  return absl::OkStatus();
}

absl::Status CatalogStore::Update(const std::string& id,
                                  const UpdateParts& parts,
                                  const MergeFunction& merge) {
  const std::lock_guard lock(write_mutex_);
  HOROPTER_ASSIGN_OR_RETURN(CatalogRecord current, catalog_->GetObject(id));
  HOROPTER_ASSIGN_OR_RETURN(const CatalogRecord changed, merge(std::move(current)));
  absl::StatusOr<Prepared> prepared = absl::NotFoundError("no derived data");
  if (!parts.geometry) {  // what was derived of it holds on
    const absl::StatusOr<DerivedData> stored = catalog_->GetDerived(id);
    if (stored.ok()) prepared = preparer_.restore(changed.model, stored->data);
  }
  if (!prepared.ok()) prepared = preparer_.prepare(changed.model);
  if (!prepared.ok()) return prepared.status();
  const DerivedData derived{preparer_.version, preparer_.encode(**prepared)};
  HOROPTER_RETURN_IF_ERROR(catalog_->UpdateObject(changed, parts, derived));
  Publish(id, *std::move(prepared));
  return absl::OkStatus();
}

absl::Status CatalogStore::Delete(const std::string& id) {
  const std::lock_guard lock(write_mutex_);
  HOROPTER_RETURN_IF_ERROR(catalog_->DeleteObject(id));
  Publish(id, nullptr);
  return absl::OkStatus();
}

absl::StatusOr<bool> CatalogStore::Rebuild(const std::string& id) {
  const std::lock_guard lock(write_mutex_);
  HOROPTER_ASSIGN_OR_RETURN(CatalogRecord record, catalog_->GetObject(id));
  // Data that cannot be read are as good as none: they are about to be replaced.
  const absl::StatusOr<DerivedData> stored = catalog_->GetDerived(id);
  HOROPTER_ASSIGN_OR_RETURN(Prepared prepared, preparer_.prepare(std::move(record.model)));
  const DerivedData made{preparer_.version, preparer_.encode(*prepared)};
  const bool differs = !stored.ok() || stored->version != made.version || stored->data != made.data;
  if (differs) HOROPTER_RETURN_IF_ERROR(catalog_->StoreDerived({{id, made}}));
  Publish(id, std::move(prepared));
  return differs;
}

absl::Status CatalogStore::CheckDerived(const std::string& id, bool recompute) {
  HOROPTER_ASSIGN_OR_RETURN(CatalogRecord record, catalog_->GetObject(id));
  HOROPTER_ASSIGN_OR_RETURN(const DerivedData stored, catalog_->GetDerived(id));
  if (stored.data.empty()) return absl::FailedPreconditionError("has no derived data");
  HOROPTER_ASSIGN_OR_RETURN(const Prepared restored,
                            preparer_.restore(std::move(record.model), stored.data));
  if (!recompute) return absl::OkStatus();
  HOROPTER_ASSIGN_OR_RETURN(const Prepared made, preparer_.prepare(ModelOf(*restored)));
  if (preparer_.encode(*made) == stored.data) return absl::OkStatus();
  return absl::DataLossError("the derived data differ from what the geometry gives");
}

absl::Status CatalogStore::BuildIndex(PublishedCatalog* published) {
  CatalogSnapshot& snapshot = published->snapshot;
  std::vector<const ObjectKeys*> keys;
  for (size_t i = 0; i < snapshot.objects.size(); ++i) {
    keys.push_back(&preparer_.keys_of(*snapshot.objects[i]));
    snapshot.slots.push_back(static_cast<int>(i));
  }
  HOROPTER_ASSIGN_OR_RETURN(const int64_t generation, catalog_->Generation());
  absl::StatusOr<KeyIndex> built = KeyIndex::Build(keys, static_cast<uint32_t>(generation));
  if (!built.ok()) return built.status();
  index_ = *std::move(built);
  snapshot.keys = index_->Snapshot();
  return absl::OkStatus();
}

absl::Status CatalogStore::CheckIndex() const {
  const auto published = Published();
  const CatalogSnapshot& snapshot = published->snapshot;
  std::vector<const ObjectKeys*> keys;
  for (size_t i = 0; i < snapshot.objects.size(); ++i) {
    const size_t slot = static_cast<size_t>(snapshot.slots[i]);
    if (keys.size() <= slot) keys.resize(slot + 1, nullptr);
    keys[slot] = &preparer_.keys_of(*snapshot.objects[i]);
  }
  return snapshot.keys.CheckAgainst(keys);
}

void CatalogStore::Publish(const std::string& id, Prepared prepared) {
  CrashPoint("store.before_publish");
  auto next = std::make_shared<PublishedCatalog>(*Published());
  CatalogSnapshot& snapshot = next->snapshot;
  ++snapshot.generation;
  const auto at = std::lower_bound(next->ids.begin(), next->ids.end(), id) - next->ids.begin();
  const bool known = at != static_cast<long>(next->ids.size()) && next->ids[at] == id;
  // Keys were checked when they were made or read: the tree has no reason to refuse them.
  absl::Status indexed;
  if (known) {
    const int slot = snapshot.slots[at];
    indexed.Update(index_->Erase(slot, preparer_.keys_of(*snapshot.objects[at])));
    if (prepared != nullptr) {
      indexed.Update(index_->Insert(slot, preparer_.keys_of(*prepared)));
      snapshot.objects[at] = std::move(prepared);
    } else {
      free_slots_.push_back(slot);
      snapshot.objects.erase(snapshot.objects.begin() + at);
      snapshot.slots.erase(snapshot.slots.begin() + at);
      next->ids.erase(next->ids.begin() + at);
    }
  } else if (prepared != nullptr) {
    int slot = static_cast<int>(next->ids.size());  // every lower one is in use or free
    if (!free_slots_.empty()) {
      slot = free_slots_.back();
      free_slots_.pop_back();
    }
    indexed.Update(index_->Insert(slot, preparer_.keys_of(*prepared)));
    snapshot.objects.insert(snapshot.objects.begin() + at, std::move(prepared));
    snapshot.slots.insert(snapshot.slots.begin() + at, slot);
    next->ids.insert(next->ids.begin() + at, id);
  }
  indexed.Update(index_->RefreshTransforms(static_cast<uint32_t>(snapshot.generation)));
  if (!indexed.ok()) spdlog::error("index of {}: {}", id, std::string(indexed.message()));
  snapshot.keys = index_->Snapshot();
  {
    const std::lock_guard lock(published_mutex_);
    published_ = std::move(next);
  }
  CrashPoint("store.after_publish");
}

}  // namespace horopter
