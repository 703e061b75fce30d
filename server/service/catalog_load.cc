// What is read of the file when the catalog is opened or replaced.
#include <algorithm>
#include <chrono>
#include <numeric>
#include <utility>

#include "absl/strings/str_cat.h"
#include "server/base/parallel_for.h"
#include "server/base/status_macros.h"
#include "server/base/stop_scope.h"
#include "server/service/catalog_store.h"

namespace horopter {
namespace {

// Objects read, prepared and stored together: enough to keep all threads busy, few enough that a
// kill loses little of a long rebuild.
constexpr int kLoadPage = 256;
// Objects of a catalog that is not read whole, told together: 1 MB.
constexpr int kEntryPage = 10'000;

}  // namespace

absl::StatusOr<CatalogStore::Prepared> CatalogStore::RestoreOne(LoadedObject* stored) const {
  DerivedData& derived = stored->derived;
  if (derived.version != preparer_.version) return absl::NotFoundError("no derived data");
  const std::string id = stored->model.id, address = derived.address;
  const bool cached = cache_ != nullptr && derived.data.empty();
  if (cached) {
    if (std::optional<DerivedData> entry = cache_->Get(address)) {
      absl::StatusOr<Prepared> object = preparer_.restore(
          stored->model, PreparedBytes{std::move(entry->data), std::move(entry->keys)});
      if (object.ok()) return object;
      cache_->Quarantine(address, object.status());
    }
    HOROPTER_ASSIGN_OR_RETURN(derived, catalog_->GetDerived(id, {.version = preparer_.version}));
  }
  // What was written since the object was read is of another shape.
  if (derived.data.empty() || derived.address != address)
    return absl::NotFoundError("no derived data");
  DerivedData kept;
  if (cached) kept = derived;
  absl::StatusOr<Prepared> object = preparer_.restore(
      std::move(stored->model), PreparedBytes{std::move(derived.data), std::move(derived.keys)});
  if (object.ok()) {
    if (cached) cache_->Put(kept);
    return object;
  }
  // Damaged data, which is rare: the model, which was given away, is read once more.
  absl::StatusOr<CatalogRecord> record = catalog_->GetObject(id);
  stored->damage = record.status();
  if (record.ok()) stored->model = std::move(record->model);
  return object;
}

CatalogStore::Loaded CatalogStore::LoadOne(LoadedObject stored, bool prepare) const {
  Loaded result;
  if (!stored.damage.ok()) {
    result.object = stored.damage;
    return result;
  }
  result.object = RestoreOne(&stored);
  if (result.object.ok() || absl::IsUnavailable(result.object.status())) return result;
  if (!stored.damage.ok()) {
    result.object = stored.damage;
    return result;
  }
  result.pending = !prepare;
  if (!prepare) return result;
  result.object = preparer_.prepare(std::move(stored.model));
  result.made = result.object.ok();
  return result;
}

absl::StatusOr<WriterState> CatalogStore::LoadAll(const StopRequested& stop) {
  const StopScope scope(stop);
  auto published = std::make_shared<PublishedCatalog>();
  load_report_ = {};
  caught_up_ns_ = std::chrono::steady_clock::now().time_since_epoch().count();
  HOROPTER_ASSIGN_OR_RETURN(WriteIdentity seen, catalog_->LastWrite());
  published->snapshot.generation = seen.generation;
  HOROPTER_ASSIGN_OR_RETURN(const int objects, catalog_->CountObjects());
  load_report_.resident = objects <= options_.max_resident;
  KeyCollection keys;
  HOROPTER_RETURN_IF_ERROR(load_report_.resident ? LoadResident(published.get(), &keys, &seen)
                                                 : LoadStored(published.get(), &seen));
  HOROPTER_ASSIGN_OR_RETURN(KeyIndex index, BuildIndex(published.get(), std::move(keys)));
  seen_ = std::move(seen);
  return WriterState{std::move(published), std::move(index), {}};
}

void CatalogStore::LeaveOut(const std::string& id,
                            const absl::Status& why,
                            PublishedCatalog* published) {
  load_report_.failures.push_back(absl::StrCat("object ", id, ": ", std::string(why.message())));
  published->unusable[id] = std::string(why.message());
}

absl::Status CatalogStore::LoadResident(PublishedCatalog* published,
                                        KeyCollection* keys,
                                        WriteIdentity* seen) {
  std::string after;
  while (true) {
    HOROPTER_ASSIGN_OR_RETURN(std::vector<LoadedObject> page,
                              catalog_->LoadObjects(after, kLoadPage, Wanted(), seen));
    if (page.empty()) return absl::OkStatus();
    std::vector<std::string> ids;
    for (const LoadedObject& object : page) ids.push_back(object.model.id);
    std::vector<Loaded> loaded(page.size());
    ParallelFor(static_cast<int>(page.size()), options_.threads, [&](int i) {
      loaded[i] = LoadOne(std::move(page[i]), !options_.prepare_beside);
    });
    std::vector<std::pair<std::string, DerivedData>> made;
    for (size_t i = 0; i < ids.size(); ++i) {
      if (loaded[i].pending) {
        ++load_report_.pending;
        published->pending.insert(ids[i]);
        continue;
      }
      if (!loaded[i].object.ok()) {
        LeaveOut(ids[i], loaded[i].object.status(), published);
        continue;
      }
      ++(loaded[i].made ? load_report_.prepared : load_report_.restored);
      if (loaded[i].made) made.push_back({ids[i], Derive(**loaded[i].object)});
      keys->Add(static_cast<int>(published->ids.size()), preparer_.keys_of(**loaded[i].object));
      published->ids.push_back(ids[i]);
      published->snapshot.objects.push_back(*std::move(loaded[i].object));
    }
    // A full disk is no reason not to serve.
    if (!made.empty()) load_report_.stored.Update(catalog_->StoreDerived(made));
    after = ids.back();
  }
}

absl::Status CatalogStore::LoadStored(PublishedCatalog* published, WriteIdentity* seen) {
  std::string after;
  while (true) {
    HOROPTER_ASSIGN_OR_RETURN(
        std::vector<DerivedEntry> page,
        catalog_->ListDerived(after, kEntryPage, preparer_.version, -1, seen));
    if (page.empty()) return absl::OkStatus();
    after = page.back().id;
    for (DerivedEntry& entry : page) {
      if (entry.version == preparer_.version && !entry.address.empty()) {
        ++load_report_.restored;
      } else if (options_.prepare_beside) {
        ++load_report_.pending;
        published->pending.insert(entry.id);
        continue;
      } else {
        absl::StatusOr<std::string> address = MakeDerived(entry.id, seen);
        if (!address.ok()) {
          LeaveOut(entry.id, address.status(), published);
          continue;
        }
        entry.address = *std::move(address);
        ++load_report_.prepared;
      }
      published->addresses.push_back(std::move(entry.address));
      published->snapshot.stored.push_back(Handle(entry.id));
      published->ids.push_back(std::move(entry.id));
    }
  }
}

absl::StatusOr<std::string> CatalogStore::MakeDerived(const std::string& id, WriteIdentity* seen) {
  HOROPTER_ASSIGN_OR_RETURN(std::vector<LoadedObject> found,
                            catalog_->LoadObjects(std::span(&id, 1), Wanted(), seen));
  if (found.empty()) return absl::NotFoundError("it was removed meanwhile");
  const Loaded loaded = LoadOne(std::move(found.front()), /*prepare=*/true);
  if (!loaded.object.ok()) return loaded.object.status();
  DerivedData made = Derive(**loaded.object);
  std::string address = made.address;
  // A full disk is no reason not to serve.
  load_report_.stored.Update(catalog_->StoreDerived({{id, std::move(made)}}));
  return address;
}

absl::StatusOr<KeyIndex> CatalogStore::BuildIndex(PublishedCatalog* published, KeyCollection keys) {
  CatalogSnapshot& snapshot = published->snapshot;
  snapshot.slots.resize(snapshot.objects.size());
  std::iota(snapshot.slots.begin(), snapshot.slots.end(), 0);
  HOROPTER_ASSIGN_OR_RETURN(
      KeyIndex built,
      KeyIndex::FromCollection(
          std::move(keys), static_cast<uint32_t>(snapshot.generation), options_.threads));
  snapshot.keys = built.Snapshot();
  return built;
}

}  // namespace horopter
