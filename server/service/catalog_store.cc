#include "server/service/catalog_store.h"

#include <spdlog/spdlog.h>

#include <algorithm>
#include <iterator>
#include <utility>

#include "absl/strings/cord.h"
#include "absl/strings/numbers.h"
#include "absl/strings/str_cat.h"
#include "db/object_digest.h"
#include "server/base/crash_point.h"
#include "server/base/parallel_for.h"
#include "server/base/status_macros.h"
#include "server/base/stop_scope.h"
#include "server/pipeline/exception_status.h"
#include "server/service/rpc_status.h"

namespace horopter {
namespace {

using Prepared = std::shared_ptr<const PreparedObject>;

constexpr size_t kListPage = 256;
constexpr char kObjectPayload[] = "horopter/object-index";

const StopRequested kNeverStops;

// The status with the object of a list it is of (see ObjectOf).
absl::Status AtObject(size_t index, absl::Status status) {
  if (!status.ok()) status.SetPayload(kObjectPayload, absl::Cord(absl::StrCat(index)));
  return status;
}

// Beside the derived data; without a folder for them beside the catalog's file; empty: in memory.
std::string SegmentFolder(const Catalog& catalog, const StoreOptions& options) {
  if (!options.derived_cache.empty()) return options.derived_cache + "/keys";
  if (catalog.IsShared() || catalog.path() == ":memory:") return "";
  return catalog.path() + "-keys";
}

}  // namespace

std::optional<int> CatalogStore::ObjectOf(const absl::Status& status) {
  const auto payload = status.GetPayload(kObjectPayload);
  int index = 0;
  if (!payload || !absl::SimpleAtoi(std::string(*payload), &index)) return std::nullopt;
  return index;
}

CatalogStore::CatalogStore(std::unique_ptr<Catalog> catalog,
                           ObjectPreparer preparer,
                           const StoreOptions& options)
    : catalog_(std::move(catalog)),
      preparer_(std::move(preparer)),
      options_(options),
      cache_(
          options.derived_cache.empty()
              ? nullptr
              : std::make_unique<DerivedCache>(options.derived_cache, options.derived_cache_bytes)),
      segments_(SegmentFolder(*catalog_, options)) {}

absl::StatusOr<std::unique_ptr<CatalogStore>> CatalogStore::Load(std::unique_ptr<Catalog> catalog,
                                                                 ObjectPreparer preparer,
                                                                 const StoreOptions& options) {
  std::unique_ptr<CatalogStore> store(
      new CatalogStore(std::move(catalog), std::move(preparer), options));
  HOROPTER_ASSIGN_OR_RETURN(WriterState state, store->LoadAll(options.stop));
  store->published_ = state.published;
  store->writer_ = std::move(state);
  if (options.prepare_beside)
    store->preparing_ = std::thread([s = store.get()] { s->PrepareBeside(); });
  if (store->catalog_->IsShared())
    store->following_ = std::thread([s = store.get()] { s->Follow(); });
  if (!store->load_report_.resident) {
    store->covering_ = std::thread([s = store.get()] {
      const absl::Status covered = CatchExceptions(
          [s] { return s->CoverKeys(*s->Published(), [s] { return s->closing_.load(); }); });
      if (!covered.ok() && !s->closing_) {
        spdlog::warn("keys are not gathered yet, who asks for look-alikes waits for it: {}",
                     std::string(covered.message()));
      }
    });
  }
  return store;
}

CatalogStore::~CatalogStore() {
  {
    const std::lock_guard lock(write_mutex_);
    closing_ = true;
  }
  has_pending_.notify_all();
  if (preparing_.joinable()) preparing_.join();
  if (following_.joinable()) following_.join();
  if (covering_.joinable()) covering_.join();
}

std::shared_ptr<const StoredObject> CatalogStore::Handle(const std::string& id) {
  return std::make_shared<const StoredObject>(
      id, [this](const std::string& wanted) { return LoadForHandle(wanted); });
}

absl::StatusOr<Prepared> CatalogStore::LoadForHandle(const std::string& id) {
  HOROPTER_ASSIGN_OR_RETURN(LoadedObject object, catalog_->LoadObject(id, Wanted()));
  // What had to be prepared again is not stored here: a writer may be at work on the object.
  absl::StatusOr<Prepared> prepared = LoadOne(std::move(object), /*prepare=*/true).object;
  if (!prepared.ok()) return prepared;
  const std::lock_guard lock(recent_mutex_);
  if (recent_.size() < static_cast<size_t>(options_.max_resident)) {
    recent_.push_back(*prepared);
  } else if (!recent_.empty()) {
    recent_[next_recent_] = *prepared;
    next_recent_ = (next_recent_ + 1) % recent_.size();
  }
  return prepared;
}

void CatalogStore::KeepPublished(const std::string& id) {
  const auto published = Published();
  const auto& ids = published->ids;
  const auto at = std::lower_bound(ids.begin(), ids.end(), id) - ids.begin();
  if (published->snapshot.stored.empty() || at == std::ssize(ids) || ids[at] != id) return;
  const absl::Status kept = published->snapshot.stored[at]->Keep();
  if (!kept.ok())
    spdlog::warn(
        "object {}: {}", id, std::string(kept.message()));  // it can be replaced or removed
}

DerivedData CatalogStore::Derive(const PreparedObject& object) const {
  PreparedBytes bytes = preparer_.encode(object);
  return {preparer_.version,
          std::move(bytes.data),
          std::move(bytes.keys),
          DerivedAddress(preparer_.model_of(object), preparer_.version)};
}

std::shared_ptr<const PublishedCatalog> CatalogStore::Published() const {
  const std::lock_guard lock(published_mutex_);
  return published_;
}

absl::Status CatalogStore::Create(CatalogRecord record) {
  std::vector<CatalogRecord> one;
  one.push_back(std::move(record));
  return Create(std::move(one));
}

absl::Status CatalogStore::Create(std::vector<CatalogRecord> records,
                                  const RepeatableRequest& request,
                                  const BeforeCommit& before_commit,
                                  const StopRequested& stop) {
  // A taken id is told before the time of a preparation is spent; the database decides in the end.
  for (size_t i = 0; i < records.size(); ++i) {
    const std::string& id = records[i].model.id;
    if (catalog_->GetSummary(id).ok()) {
      return AtObject(
          i, absl::AlreadyExistsError(absl::StrCat("object '", id, "' is already in the catalog")));
    }
  }
  const int count = static_cast<int>(records.size());
  HOROPTER_RETURN_IF_ERROR(CheckRoomFor(count));
  std::vector<absl::StatusOr<Prepared>> prepared(count, absl::CancelledError("stopped"));
  std::vector<Catalog::NewObject> objects(count);
  ParallelFor(count, options_.threads, [&](int i) {
    if (IsStopRequested(stop)) return;
    prepared[i] = preparer_.prepare(records[i].model);
    if (prepared[i].ok()) objects[i].derived = Derive(**prepared[i]);
  });
  for (int i = 0; i < count; ++i) {
    if (!prepared[i].ok()) return AtObject(i, prepared[i].status());
    objects[i].record = std::move(records[i]);
    CadSource& source = objects[i].record.source;
    absl::StatusOr<CadSource> hashed = WithHash(std::move(source));
    if (!hashed.ok()) return AtObject(i, hashed.status());
    source = *std::move(hashed);
  }
  return OnNewest([&]() -> absl::Status {
    const StopScope shield(kNeverStops);  // what is committed is published
    HOROPTER_RETURN_IF_ERROR(CheckRoomFor(count));
    HOROPTER_ASSIGN_OR_RETURN(const int64_t generation, NextGeneration());
    CatalogDraft draft(*writer_, preparer_);
    for (int i = 0; i < count; ++i) {
      CatalogRecord& record = objects[i].record;
      HOROPTER_RETURN_IF_ERROR(
          AtObject(i, draft.Put(record.model.id, *prepared[i], HandleFor(record.model.id))));
      record.revision = generation;
      if (before_commit) HOROPTER_RETURN_IF_ERROR(AtObject(i, before_commit(record)));
    }
    HOROPTER_ASSIGN_OR_RETURN(WriterState next, std::move(draft).Finish(generation));
    HOROPTER_RETURN_IF_ERROR(catalog_->CreateObjects(objects, request, rests_on_));
    Adopt(std::move(next));
    return absl::OkStatus();
  });
}

absl::Status CatalogStore::Update(const std::string& id,
                                  const UpdateParts& parts,
                                  const MergeFunction& merge,
                                  const BeforeCommit& before_commit) {
  return OnNewest([&] { return UpdateOnce(id, parts, merge, before_commit); });
}

absl::Status CatalogStore::UpdateOnce(const std::string& id,
                                      const UpdateParts& parts,
                                      const MergeFunction& merge,
                                      const BeforeCommit& before_commit) {
  HOROPTER_ASSIGN_OR_RETURN(CatalogRecord current, catalog_->GetObject(id));
  HOROPTER_ASSIGN_OR_RETURN(CatalogRecord changed, merge(std::move(current)));
  return Write(std::move(changed), parts, before_commit);
}

absl::Status CatalogStore::RestoreVersion(const std::string& id,
                                          int64_t revision,
                                          const MergeFunction& merge,
                                          const BeforeCommit& before_commit) {
  return OnNewest([&] { return RestoreVersionOnce(id, revision, merge, before_commit); });
}

absl::Status CatalogStore::RestoreVersionOnce(const std::string& id,
                                              int64_t revision,
                                              const MergeFunction& merge,
                                              const BeforeCommit& before_commit) {
  HOROPTER_ASSIGN_OR_RETURN(const std::vector<ObjectVersion> versions, catalog_->ListVersions(id));
  HOROPTER_ASSIGN_OR_RETURN(const CatalogRecord merged, merge(versions.front().summary.record));
  HOROPTER_ASSIGN_OR_RETURN(CatalogRecord former, catalog_->GetVersion(id, revision));
  UpdateParts parts;
  for (const ObjectVersion& version : versions) {
    if (version.summary.record.revision <= revision) break;
    if (!version.changed) continue;
    parts.display_name |= version.changed->display_name;
    parts.geometry |= version.changed->geometry;
    parts.symmetries |= version.changed->symmetries;
    parts.grasps |= version.changed->grasps;
    parts.source |= version.changed->source;
    parts.labels |= version.changed->labels;
    parts.print |= version.changed->print;
  }
  former.create_time = merged.create_time;
  former.update_time = merged.update_time;
  former.changed_by = merged.changed_by;
  return Write(std::move(former), parts, before_commit);
}

absl::Status CatalogStore::Write(CatalogRecord changed,
                                 const UpdateParts& parts,
                                 const BeforeCommit& before_commit) {
  const std::string id = changed.model.id;
  if (parts.source) {
    HOROPTER_ASSIGN_OR_RETURN(changed.source, WithHash(std::move(changed.source)));
  }
  absl::StatusOr<Prepared> prepared = absl::NotFoundError("no derived data");
  if (!parts.geometry && !parts.symmetries) {  // what was derived of it holds on
    const auto stored = catalog_->GetDerived(id, {.version = preparer_.version});
    if (stored.ok() && stored->version == preparer_.version)
      prepared = preparer_.restore(changed.model, {stored->data, stored->keys});
  }
  if (!prepared.ok()) prepared = preparer_.prepare(changed.model);
  if (!prepared.ok()) return prepared.status();
  const DerivedData derived = Derive(**prepared);
  const StopScope shield(kNeverStops);
  KeepPublished(id);
  HOROPTER_ASSIGN_OR_RETURN(changed.revision, NextGeneration());
  HOROPTER_ASSIGN_OR_RETURN(WriterState next, WithObject(id, *prepared));
  if (before_commit) HOROPTER_RETURN_IF_ERROR(before_commit(changed));
  HOROPTER_RETURN_IF_ERROR(catalog_->UpdateObject(changed, parts, derived, rests_on_));
  Adopt(std::move(next));
  return absl::OkStatus();
}

absl::Status CatalogStore::Delete(const std::string& id, const DeleteCheck& check) {
  return OnNewest([&] { return DeleteOnce(id, check); });
}

absl::Status CatalogStore::DeleteOnce(const std::string& id, const DeleteCheck& check) {
  const StopScope shield(kNeverStops);
  HOROPTER_ASSIGN_OR_RETURN(const ObjectSummary current, catalog_->GetSummary(id));
  if (check) HOROPTER_RETURN_IF_ERROR(check(current.record));
  KeepPublished(id);
  HOROPTER_ASSIGN_OR_RETURN(const int64_t generation, NextGeneration());
  CatalogDraft draft(*writer_, preparer_);
  draft.Remove(id);
  HOROPTER_ASSIGN_OR_RETURN(WriterState next, std::move(draft).Finish(generation));
  HOROPTER_RETURN_IF_ERROR(catalog_->DeleteObject(id, rests_on_));
  Adopt(std::move(next));
  return absl::OkStatus();
}

absl::StatusOr<bool> CatalogStore::Rebuild(const std::string& id) {
  bool differs = false;
  const absl::Status done = OnNewest([&]() -> absl::Status {
    HOROPTER_ASSIGN_OR_RETURN(differs, RebuildOnce(id));
    return absl::OkStatus();
  });
  HOROPTER_RETURN_IF_ERROR(done);
  return differs;
}

absl::StatusOr<bool> CatalogStore::RebuildOnce(const std::string& id) {
  HOROPTER_ASSIGN_OR_RETURN(CatalogRecord record, catalog_->GetObject(id));
  // Data that cannot be read are as good as none: they are about to be replaced.
  const auto stored = catalog_->GetDerived(id, {.version = preparer_.version});
  HOROPTER_ASSIGN_OR_RETURN(Prepared prepared, preparer_.prepare(std::move(record.model)));
  const DerivedData made = Derive(*prepared);
  const bool differs = !stored.ok() || stored->version != made.version ||
                       stored->data != made.data || stored->keys != made.keys;
  const StopScope shield(kNeverStops);
  KeepPublished(id);
  HOROPTER_ASSIGN_OR_RETURN(WriterState next, WithObject(id, prepared));
  HOROPTER_RETURN_IF_ERROR(catalog_->StoreDerived({{id, made}}, /*counts=*/true, rests_on_));
  Adopt(std::move(next));
  return differs;
}

absl::Status CatalogStore::Restore(const std::string& path) {
  const std::lock_guard lock(write_mutex_);
  const StopScope shield(kNeverStops);
  HOROPTER_RETURN_IF_ERROR(catalog_->Restore(path));
  HOROPTER_ASSIGN_OR_RETURN(WriterState next, LoadAll(kNeverStops));
  Adopt(std::move(next));
  ++restored_;
  has_pending_.notify_all();
  return absl::OkStatus();
}

absl::StatusOr<CatalogStore::Contents> CatalogStore::Compare(const StopRequested& stop) {
  Contents contents;
  // Read last: an object enrolled meanwhile is published by the time it is listed or soon after, so
  // only differences that persist in a second look count.
  for (int look = 0; look < 2; ++look) {
    contents.stored.clear();
    std::string after;
    while (true) {
      if (IsStopRequested(stop)) return absl::CancelledError("stopped");
      HOROPTER_ASSIGN_OR_RETURN(const std::vector<ObjectSummary> page,
                                catalog_->ListObjects(after, kListPage));
      for (const ObjectSummary& summary : page) contents.stored.insert(summary.record.model.id);
      if (page.size() < kListPage) break;
      after = page.back().record.model.id;
    }
    const auto snapshot = Published();
    contents.published = {snapshot->ids.begin(), snapshot->ids.end()};
    contents.unusable = snapshot->unusable;
    contents.pending = snapshot->pending;
    if (contents.stored == contents.published) break;
  }
  return contents;
}

absl::Status CatalogStore::CheckDerived(const std::string& id,
                                        bool recompute,
                                        const StopRequested& stop) {
  const StopScope scope(stop);
  HOROPTER_ASSIGN_OR_RETURN(CatalogRecord record, catalog_->GetObject(id));
  HOROPTER_ASSIGN_OR_RETURN(const DerivedData stored,
                            catalog_->GetDerived(id, {.version = preparer_.version}));
  if (stored.data.empty()) return absl::FailedPreconditionError("has no derived data");
  HOROPTER_ASSIGN_OR_RETURN(const Prepared restored,
                            preparer_.restore(std::move(record.model), {stored.data, stored.keys}));
  if (!recompute) return absl::OkStatus();
  HOROPTER_ASSIGN_OR_RETURN(const Prepared made, preparer_.prepare(ModelOf(*restored)));
  if (preparer_.encode(*made) == PreparedBytes{stored.data, stored.keys}) return absl::OkStatus();
  return absl::DataLossError("the derived data differ from what the geometry gives");
}

absl::Status CatalogStore::CheckRoomFor(int more) const {
  HOROPTER_ASSIGN_OR_RETURN(const int objects, catalog_->CountObjects());
  if (objects + more <= options_.max_objects) return absl::OkStatus();
  return LimitExceeded(
      "max_objects",
      absl::StrCat("the catalog holds ", objects, " objects, at most ", options_.max_objects));
}

absl::StatusOr<int64_t> CatalogStore::NextGeneration() {
  if (rests_on_ != nullptr) return rests_on_->generation + 1;
  HOROPTER_ASSIGN_OR_RETURN(const int64_t generation, catalog_->Generation());
  return generation + 1;
}

std::shared_ptr<const StoredObject> CatalogStore::HandleFor(const std::string& id) {
  return load_report_.resident ? nullptr : Handle(id);
}

absl::StatusOr<WriterState> CatalogStore::WithObject(const std::string& id,
                                                     const Prepared& prepared) {
  HOROPTER_ASSIGN_OR_RETURN(const int64_t generation, NextGeneration());
  CatalogDraft draft(*writer_, preparer_);
  HOROPTER_RETURN_IF_ERROR(draft.Put(id, prepared, HandleFor(id)));
  return std::move(draft).Finish(generation);
}

void CatalogStore::Adopt(WriterState&& state) noexcept {
  CrashPoint("store.before_publish");
  {
    const std::lock_guard lock(published_mutex_);
    published_ = state.published;
  }
  published_changed_.notify_all();
  writer_ = std::move(state);
  CrashPoint("store.after_publish");
}

}  // namespace horopter
