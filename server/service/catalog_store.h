// The catalog as the service uses it: SQLite behind, an immutable snapshot in front.
#pragma once

#include <functional>
#include <memory>
#include <mutex>
#include <optional>
#include <string>
#include <vector>

#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "db/catalog.h"
#include "server/pipeline/pipeline.h"

namespace horopter {

// What a request works on. ids[i] names snapshot.objects[i]; ordered.
struct PublishedCatalog {
  CatalogSnapshot snapshot;
  std::vector<std::string> ids;

  bool Contains(const std::string& id) const;
};

// What Load did.
struct LoadReport {
  int restored = 0;  // objects whose derived data were there
  int prepared = 0;  // objects that had to be prepared anew: no data, another version, damaged
  std::vector<std::string> failures;  // one message per object that cannot be prepared
  absl::Status stored;                // whether the new derived data could be written
};

// A write is committed to SQLite first, the derived data with it, and published then; only the
// object that changed is prepared anew. Thread-safe; readers hold a shared_ptr and wait for nobody.
class CatalogStore {
 public:
  // Loads all objects on `threads` threads from their derived data, and prepares and stores anew
  // what is out of date. An object that cannot be prepared stays in the catalog and is left out of
  // the snapshot. Errors: as Catalog::LoadObjects.
  static absl::StatusOr<std::unique_ptr<CatalogStore>> Load(std::unique_ptr<Catalog> catalog,
                                                            ObjectPreparer preparer,
                                                            int threads);

  std::shared_ptr<const PublishedCatalog> Published() const;

  // Errors: INVALID_ARGUMENT, ALREADY_EXISTS.
  absl::Status Create(const CatalogRecord& record);

  // Reads the object, lets `merge` change it and writes the parts, with no other write in between.
  // Errors: NOT_FOUND, INVALID_ARGUMENT, those of `merge`.
  using MergeFunction = std::function<absl::StatusOr<CatalogRecord>(CatalogRecord current)>;
  absl::Status Update(const std::string& id, const UpdateParts& parts, const MergeFunction& merge);

  // Errors: NOT_FOUND.
  absl::Status Delete(const std::string& id);

  // Prepares the object anew, stores its derived data when they differ from those in the catalog,
  // and publishes it. True: they differed. Errors: NOT_FOUND, INVALID_ARGUMENT.
  absl::StatusOr<bool> Rebuild(const std::string& id);

  // Whether the stored derived data are those of the object's geometry; `recompute` also makes them
  // anew and compares. Errors: NOT_FOUND; otherwise the answer, FAILED_PRECONDITION or DATA_LOSS.
  absl::Status CheckDerived(const std::string& id, bool recompute);

  // Reads go straight to the database.
  Catalog& catalog() { return *catalog_; }

  const ObjectModel& ModelOf(const PreparedObject& object) const {
    return preparer_.model_of(object);
  }

  const LoadReport& load_report() const { return load_report_; }

  // Whether the published index holds the keys of exactly the published objects. Errors: INTERNAL.
  absl::Status CheckIndex() const;

 private:
  CatalogStore(std::unique_ptr<Catalog> catalog, ObjectPreparer preparer);

  // The index over all published objects, built at once. Errors: INTERNAL.
  absl::Status BuildIndex(PublishedCatalog* published);

  // Replaces (prepared set) or removes (prepared empty) one object. Needs write_mutex_.
  void Publish(const std::string& id, std::shared_ptr<const PreparedObject> prepared);

  const std::unique_ptr<Catalog> catalog_;
  const ObjectPreparer preparer_;
  LoadReport load_report_;

  std::mutex write_mutex_;         // one writer from commit to publication
  std::optional<KeyIndex> index_;  // guarded by write_mutex_; set by Load
  std::vector<int> free_slots_;    // guarded by write_mutex_
  mutable std::mutex published_mutex_;
  std::shared_ptr<const PublishedCatalog> published_;  // guarded by published_mutex_
};

}  // namespace horopter
