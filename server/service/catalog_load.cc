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
// Objects whose keys are read at once: 20 MB.
constexpr int kKeyPage = 1024;

}  // namespace

CatalogStore::Loaded CatalogStore::LoadOne(LoadedObject stored, bool prepare) const {
  Loaded result;
  if (!stored.damage.ok()) {
    result.object = stored.damage;
    return result;
  }
  const std::string id = stored.model.id;
  if (stored.derived.version == preparer_.version && !stored.derived.data.empty()) {
    result.object = preparer_.restore(
        std::move(stored.model),
        PreparedBytes{std::move(stored.derived.data), std::move(stored.derived.keys)});
    if (result.object.ok()) return result;
    // Damaged data, which is rare: the model, which was given away, is read once more.
    absl::StatusOr<CatalogRecord> record = catalog_->GetObject(id);
    if (!record.ok()) {
      result.object = record.status();
      return result;
    }
    stored.model = std::move(record->model);
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
  HOROPTER_ASSIGN_OR_RETURN(published->snapshot.generation, catalog_->Generation());
  HOROPTER_ASSIGN_OR_RETURN(const int objects, catalog_->CountObjects());
  load_report_.resident = objects <= options_.max_resident;
  KeyCollection keys;
  HOROPTER_RETURN_IF_ERROR(load_report_.resident ? LoadResident(published.get(), &keys)
                                                 : LoadStored(published.get(), &keys));
  HOROPTER_ASSIGN_OR_RETURN(KeyIndex index, BuildIndex(published.get(), std::move(keys)));
  return WriterState{std::move(published), std::move(index), {}};
}

void CatalogStore::LeaveOut(const std::string& id,
                            const absl::Status& why,
                            PublishedCatalog* published) {
  load_report_.failures.push_back(absl::StrCat("object ", id, ": ", std::string(why.message())));
  published->unusable[id] = std::string(why.message());
}

absl::Status CatalogStore::LoadResident(PublishedCatalog* published, KeyCollection* keys) {
  std::string after;
  while (true) {
    HOROPTER_ASSIGN_OR_RETURN(std::vector<LoadedObject> page,
                              catalog_->LoadObjects(after, kLoadPage));
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

absl::Status CatalogStore::LoadStored(PublishedCatalog* published, KeyCollection* keys) {
  std::vector<StoredKeys> page;
  HOROPTER_ASSIGN_OR_RETURN(page, catalog_->LoadKeys("", kKeyPage));
  while (!page.empty()) {
    // The next page is read while this one is decoded.
    absl::StatusOr<std::vector<StoredKeys>> following = absl::UnknownError("not read");
    std::vector<absl::StatusOr<ObjectKeys>> decoded(page.size(), absl::NotFoundError("none"));
    ParallelFor(1 + static_cast<int>(page.size()), options_.threads, [&](int item) {
      if (item == 0) {
        following = catalog_->LoadKeys(page.back().id, kKeyPage);
      } else if (const int i = item - 1; page[i].version == preparer_.version) {
        decoded[i] = preparer_.decode_keys(page[i].keys, page[i].vertex_count);
      }
    });
    for (size_t i = 0; i < page.size(); ++i) {
      const std::string& id = page[i].id;
      if (decoded[i].ok()) {
        ++load_report_.restored;
      } else if (options_.prepare_beside) {
        ++load_report_.pending;
        published->pending.insert(id);
        continue;
      } else {
        decoded[i] = MakeKeys(id);
        if (!decoded[i].ok()) {
          LeaveOut(id, decoded[i].status(), published);
          continue;
        }
        ++load_report_.prepared;
      }
      keys->Add(static_cast<int>(published->ids.size()), *decoded[i]);
      published->ids.push_back(id);
      published->snapshot.stored.push_back(Handle(id));
    }
    HOROPTER_RETURN_IF_ERROR(following.status());
    page = *std::move(following);
  }
  return absl::OkStatus();
}

absl::StatusOr<ObjectKeys> CatalogStore::MakeKeys(const std::string& id) {
  HOROPTER_ASSIGN_OR_RETURN(LoadedObject object, catalog_->LoadObject(id));
  const Loaded loaded = LoadOne(std::move(object), /*prepare=*/true);
  HOROPTER_RETURN_IF_ERROR(loaded.object.status());
  load_report_.stored.Update(catalog_->StoreDerived({{id, Derive(**loaded.object)}}));
  return preparer_.keys_of(**loaded.object);
}

absl::StatusOr<KeyIndex> CatalogStore::BuildIndex(PublishedCatalog* published, KeyCollection keys) {
  CatalogSnapshot& snapshot = published->snapshot;
  snapshot.slots.resize(published->ids.size());
  std::iota(snapshot.slots.begin(), snapshot.slots.end(), 0);
  HOROPTER_ASSIGN_OR_RETURN(
      KeyIndex built,
      KeyIndex::FromCollection(
          std::move(keys), static_cast<uint32_t>(snapshot.generation), options_.threads));
  snapshot.keys = built.Snapshot();
  return built;
}

}  // namespace horopter
