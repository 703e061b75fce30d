// The catalog as the service uses it: SQLite behind, an immutable snapshot in front.
#pragma once

#include <atomic>
#include <condition_variable>
#include <functional>
#include <map>
#include <memory>
#include <mutex>
#include <optional>
#include <set>
#include <span>
#include <string>
#include <thread>
#include <vector>

#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "db/catalog.h"
#include "server/base/stop_token.h"
#include "server/pipeline/pipeline.h"
#include "server/service/catalog_draft.h"
#include "server/service/derived_cache.h"
#include "server/service/key_segments.h"

namespace horopter {

// What Load did.
struct LoadReport {
  bool resident = true;  // all objects are in memory; false: their keys are
  int restored = 0;      // objects whose derived data, or keys, were there
  int prepared = 0;      // objects that had to be prepared again: no data, another version, damaged
  int pending = 0;       // objects that are left to be prepared beside what is served
  std::vector<std::string> failures;  // one message per object that cannot be prepared
  absl::Status stored;                // whether the new derived data could be written
};

struct StoreOptions {
  int threads = 1;          // that load
  StopRequested stop = {};  // of loading
  // Objects held in memory. A larger catalog has only its keys there; objects are read when they
  // are asked for, and as many as this stay. Raising it costs 0.2 MB an object, more for large
  // meshes.
  int max_resident = 5000;
  // A catalog that holds as many takes no more; one that holds more already is served.
  int max_objects = 5000;
  // Objects whose derived data are missing or of another version are left out at first (pending)
  // and prepared on a thread beside what is served, some at a time; each lot is stored and joins at
  // once, so that after a kill the next start goes on there. False: Load prepares them.
  bool prepare_beside = false;
  // Folder that keeps what was derived of objects (derived_cache.h), and its size; empty: none.
  std::string derived_cache = {};
  int64_t derived_cache_bytes = int64_t{20} << 30;
};

// Of a catalog that several servers share it follows what the others write (catalog_follow.cc): a
// thread looks at least twice a second, and a write first takes in what it has not seen yet. The
// generation of a published state is the last write that is in it with all before it; parts of
// later ones may be there already.
//
// A write makes the next published state first, then is committed to SQLite, the derived data with
// it, and takes the other's place then, which cannot fail; only the object that changed is prepared
// again. Thread-safe; readers hold a shared_ptr and wait for nobody.
class CatalogStore {
 public:
  // Loads all objects from their derived data, or their keys, and prepares and stores again what is
  // out of date. An object that is damaged or cannot be prepared stays in the catalog and is left
  // out of the snapshot; nothing is recomputed from damaged bytes. Errors: as Catalog::LoadObjects,
  // CANCELLED.
  static absl::StatusOr<std::unique_ptr<CatalogStore>> Load(std::unique_ptr<Catalog> catalog,
                                                            ObjectPreparer preparer,
                                                            const StoreOptions& options = {});
  ~CatalogStore();

  std::shared_ptr<const PublishedCatalog> Published() const;

  // Told what is about to be committed, its revision set, while no other write is under way; told
  // anew, from the first object on, when another server's write came first. An error ends the
  // write, and nothing has changed. Whatever an answer needs is made here: after the commit nothing
  // can fail.
  using BeforeCommit = std::function<absl::Status(const CatalogRecord& written)>;

  // All of them or none. Errors: INVALID_ARGUMENT, ALREADY_EXISTS, CANCELLED, RESOURCE_EXHAUSTED
  // (max_objects), those of before_commit, which is called for each in order; ObjectOf says which
  // object an error is of.
  absl::Status Create(std::vector<CatalogRecord> records,
                      const RepeatableRequest& request = {},
                      const BeforeCommit& before_commit = {},
                      const StopRequested& stop = {});
  absl::Status Create(CatalogRecord record);
  static std::optional<int> ObjectOf(const absl::Status& status);

  // Reads the object, lets `merge` change it and writes the parts, with no other write in between.
  // Errors: NOT_FOUND, INVALID_ARGUMENT, those of `merge` and before_commit.
  using MergeFunction = std::function<absl::StatusOr<CatalogRecord>(CatalogRecord current)>;
  absl::Status Update(const std::string& id,
                      const UpdateParts& parts,
                      const MergeFunction& merge,
                      const BeforeCommit& before_commit = {});

  // Makes the object what it was; `merge` sees it as it is and says time and writer of the result.
  // Errors: NOT_FOUND (no such object or revision), INVALID_ARGUMENT, those of `merge` and
  // before_commit.
  absl::Status RestoreVersion(const std::string& id,
                              int64_t revision,
                              const MergeFunction& merge,
                              const BeforeCommit& before_commit = {});

  // `check` sees the object as it is, without geometry; its error ends the call. Errors: NOT_FOUND,
  // those of `check`.
  using DeleteCheck = std::function<absl::Status(const CatalogRecord& current)>;
  absl::Status Delete(const std::string& id, const DeleteCheck& check = {});

  // Prepares the object again, stores its derived data when they differ from those in the catalog,
  // and publishes it. True: they differed. Errors: NOT_FOUND, INVALID_ARGUMENT.
  absl::StatusOr<bool> Rebuild(const std::string& id);

  // Whether the stored derived data are those of the object's geometry; `recompute` also makes them
  // again and compares. Errors: NOT_FOUND, CANCELLED; otherwise the answer, FAILED_PRECONDITION or
  // DATA_LOSS.
  absl::Status CheckDerived(const std::string& id, bool recompute, const StopRequested& stop = {});

  // Replaces the whole catalog by the file's (Catalog::Restore) and publishes it. Errors: those of
  // Catalog::Restore and Load; after one of the latter what was published stays.
  absl::Status Restore(const std::string& path);

  // Which objects the file holds, which recognition uses and which it leaves out, of one moment but
  // for writes that are under way. Errors: CANCELLED.
  struct Contents {
    std::set<std::string> stored, published;
    std::map<std::string, std::string> unusable;
    std::set<std::string> pending;
  };
  absl::StatusOr<Contents> Compare(const StopRequested& stop);

  // The objects (indices into the snapshot) that are worth comparing with the named one: all others
  // while they are in memory, else the `most` of them that share most keys with it. The latter
  // waits until there are segments of all keys: minutes, where a large catalog has none yet.
  // Errors: NOT_FOUND, CANCELLED, those of the catalog.
  absl::StatusOr<std::vector<int>> LookAlikeCandidates(const PublishedCatalog& published,
                                                       const std::string& id,
                                                       int most,
                                                       const StopRequested& stop = {});

  // Returns when what is published holds all writes up to that one; at once when it does. Errors:
  // UNAVAILABLE (it does not, within `most_s` seconds or before `stop`).
  absl::Status AwaitGeneration(int64_t generation, double most_s, const StopRequested& stop) const;

  // How long ago what is published was known to be all there is, seconds; 0 of a catalog of our
  // own.
  double SecondsBehind() const;

  // Reads go straight to the database.
  Catalog& catalog() { return *catalog_; }

  const ObjectModel& ModelOf(const PreparedObject& object) const {
    return preparer_.model_of(object);
  }

  // Of the derived data that this program makes and reads.
  int derived_version() const { return preparer_.version; }

  const LoadReport& load_report() const { return load_report_; }

  // Whether the published index, or the segments, hold the keys of exactly the published objects.
  // Errors: INTERNAL, CANCELLED, those of the catalog.
  absl::Status CheckIndex(const StopRequested& stop = {}) const;

  // All zero without a cache.
  DerivedCacheFigures cache_figures() const {
    return cache_ != nullptr ? cache_->figures() : DerivedCacheFigures();
  }
  KeySegments::Figures segment_figures() const { return segments_.figures(); }

 private:
  using Prepared = std::shared_ptr<const PreparedObject>;
  struct Loaded {
    absl::StatusOr<Prepared> object = absl::UnknownError("not loaded");
    bool made = false;     // to be stored; false: the stored data are right
    bool pending = false;  // has to be prepared, which was not asked for
  };

  CatalogStore(std::unique_ptr<Catalog> catalog,
               ObjectPreparer preparer,
               const StoreOptions& options);

  // Everything from the database. Needs write_mutex_, or nobody else to have the store.
  absl::StatusOr<WriterState> LoadAll(const StopRequested& stop);
  // Leaves the keys of the published objects in `keys`. Both: what is read follows from `seen`, and
  // is of no later moment than it is afterwards.
  absl::Status LoadResident(PublishedCatalog* published, KeyCollection* keys, WriteIdentity* seen);
  // Reads no object, but those that have to be prepared.
  absl::Status LoadStored(PublishedCatalog* published, WriteIdentity* seen);
  void LeaveOut(const std::string& id, const absl::Status& why, PublishedCatalog* published);
  // What is read of derived data together with their object: not what a cache may have.
  DerivedWanted Wanted() const {
    return {.version = preparer_.version, .bytes = cache_ == nullptr};
  }
  // Prepares an object whose derived data are not right only when it is asked to.
  Loaded LoadOne(LoadedObject stored, bool prepare) const;
  // From the cache, else from the catalog, whose data it then keeps. Errors: as
  // ObjectPreparer::restore; NOT_FOUND: there are none; those of the catalog. The model stays
  // there, unless stored->damage says why not.
  absl::StatusOr<Prepared> RestoreOne(LoadedObject* stored) const;
  // Prepares an object without derived data and stores them. Their address. Errors: those of the
  // catalog and of ObjectPreparer::prepare.
  absl::StatusOr<std::string> MakeDerived(const std::string& id, WriteIdentity* seen);

  // catalog_keys.cc. Makes the segments that are missing; damaged keys are made anew and stored.
  absl::Status CoverKeys(const PublishedCatalog& published, const StopRequested& stop);
  // Makes the segments that are missing and remembers whose stored keys are damaged.
  absl::Status MakeSegments(const PublishedCatalog& published, const StopRequested& stop) const;
  // Keys of the objects with these indices; the ids of those that are damaged.
  absl::Status ReadKeys(const PublishedCatalog& published,
                        std::span<const int> wanted,
                        const KeySegments::TakeKeys& take,
                        const StopRequested& stop,
                        std::vector<std::string>* damaged) const;
  absl::Status CheckSegments(const PublishedCatalog& published, const StopRequested& stop) const;
  // Of an object that is not to stay in memory.
  std::shared_ptr<const StoredObject> Handle(const std::string& id);
  // What a handle calls: reads and restores or prepares the object and keeps it for a while.
  absl::StatusOr<Prepared> LoadForHandle(const std::string& id);
  // Before an object is changed: what snapshots show of it is kept by its handle.
  void KeepPublished(const std::string& id);
  DerivedData Derive(const PreparedObject& object) const;

  // The index over all published objects, built at once; the objects get their slots in it. Errors:
  // INTERNAL.
  absl::StatusOr<KeyIndex> BuildIndex(PublishedCatalog* published, KeyCollection keys);

  // Writes and publishes the parts of an object that is there. Needs write_mutex_.
  absl::Status Write(CatalogRecord changed,
                     const UpdateParts& parts,
                     const BeforeCommit& before_commit);
  // The writes themselves, on the newest state. Need write_mutex_.
  absl::Status UpdateOnce(const std::string& id,
                          const UpdateParts& parts,
                          const MergeFunction& merge,
                          const BeforeCommit& before_commit);
  absl::Status RestoreVersionOnce(const std::string& id,
                                  int64_t revision,
                                  const MergeFunction& merge,
                                  const BeforeCommit& before_commit);
  absl::Status DeleteOnce(const std::string& id, const DeleteCheck& check);
  absl::StatusOr<bool> RebuildOnce(const std::string& id);
  // Runs a write on the newest state, again as long as other servers' writes come first.
  absl::Status OnNewest(const std::function<absl::Status()>& write);
  // Publishes what other servers have written. Needs write_mutex_.
  absl::Status CatchUp();
  absl::Status TakeOver(const CatalogChanges& changes);
  // Of a catalog whose objects are read when they are asked for: takes the addresses of some that
  // were written since a generation, from `after` on, and moves it. Objects that have none are left
  // to be loaded. True: there are more.
  absl::StatusOr<bool> TakeStored(int64_t since,
                                  std::string* after,
                                  std::vector<std::string>* without,
                                  CatalogDraft* draft);
  // Loads those that are there.
  absl::Status TakeLoaded(std::span<const std::string> ids, CatalogDraft* draft);
  // What following_ does until it is told to stop.
  void Follow();

  absl::Status CheckRoomFor(int more) const;
  // Number of the write that is under way. Needs write_mutex_.
  absl::StatusOr<int64_t> NextGeneration();

  // What preparing_ does until it is told to stop (catalog_pending.cc).
  void PrepareBeside();
  // Reads and prepares them; one per id.
  std::vector<Loaded> PrepareLot(const std::vector<std::string>& ids);
  // Stores and publishes those that are still pending. Needs write_mutex_.
  absl::Status PublishLot(const std::vector<std::string>& ids, const std::vector<Loaded>& loaded);
  // The same without those that another server has changed since that generation.
  absl::Status DropChanged(int64_t since,
                           std::vector<std::string>* ids,
                           std::vector<Loaded>* loaded);
  // Null while all objects are in memory.
  std::shared_ptr<const StoredObject> HandleFor(const std::string& id);

  // The present state with the object put in its place. Needs write_mutex_.
  absl::StatusOr<WriterState> WithObject(const std::string& id, const Prepared& prepared);
  // What readers see from now on. Needs write_mutex_.
  void Adopt(WriterState&& state) noexcept;

  const std::unique_ptr<Catalog> catalog_;
  const ObjectPreparer preparer_;
  const StoreOptions options_;
  const std::unique_ptr<DerivedCache> cache_;  // null: none
  mutable KeySegments segments_;               // of a catalog larger than max_resident
  LoadReport load_report_;
  mutable std::mutex damaged_mutex_;
  mutable std::set<std::string> damaged_;  // guarded by damaged_mutex_: ids, to be made anew

  std::mutex recent_mutex_;
  std::vector<Prepared> recent_;  // guarded by recent_mutex_: objects read last, a ring
  size_t next_recent_ = 0;        // guarded by recent_mutex_

  std::mutex write_mutex_;             // one writer from commit to publication
  std::optional<WriterState> writer_;  // guarded by write_mutex_; set by Load
  int restored_ = 0;                   // guarded by write_mutex_: how often all was replaced
  WriteIdentity seen_;  // guarded by write_mutex_: the last write of which anything is published
  RestsOn rests_on_ = nullptr;  // guarded by write_mutex_: of the write under way, if shared
  mutable std::mutex published_mutex_;
  std::shared_ptr<const PublishedCatalog> published_;  // guarded by published_mutex_

  mutable std::condition_variable published_changed_;  // with published_mutex_

  std::condition_variable has_pending_;  // with write_mutex_
  std::atomic<bool> closing_ = false;
  std::thread preparing_;                  // none unless objects are prepared beside what is served
  std::thread following_;                  // none unless the catalog is shared
  std::thread covering_;                   // of a catalog larger than max_resident: makes segments
  std::atomic<int64_t> caught_up_ns_ = 0;  // of the steady clock
};

}  // namespace horopter
