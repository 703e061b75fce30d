// The catalog as the service uses it: SQLite behind, an immutable snapshot in front.
#pragma once

#include <functional>
#include <memory>
#include <mutex>
#include <string>
#include <vector>

#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "db/catalog.h"
#include "server/pipeline/pipeline.h"

namespace horopter {

using PrepareFunction =
    std::function<absl::StatusOr<std::shared_ptr<const PreparedObject>>(ObjectModel)>;

// What a request works on. ids[i] names snapshot.objects[i]; ordered.
struct PublishedCatalog {
  CatalogSnapshot snapshot;
  std::vector<std::string> ids;

  bool Contains(const std::string& id) const;
};

// A write is committed to SQLite first and published then; only the object that changed is prepared
// anew. Thread-safe; readers hold a shared_ptr and wait for nobody.
class CatalogStore {
 public:
  // Loads and prepares all objects on `threads` threads. An object that cannot be prepared stays in
  // the catalog and is left out of the snapshot; see failures(). Errors: as Catalog::LoadAll.
  static absl::StatusOr<std::unique_ptr<CatalogStore>> Load(std::unique_ptr<Catalog> catalog,
                                                            PrepareFunction prepare,
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

  // Reads go straight to the database.
  Catalog& catalog() { return *catalog_; }

  // One message per object that could not be prepared at start.
  const std::vector<std::string>& failures() const { return failures_; }

 private:
  CatalogStore(std::unique_ptr<Catalog> catalog, PrepareFunction prepare);

  // Replaces (prepared set) or removes (prepared empty) one object. Needs write_mutex_.
  void Publish(const std::string& id, std::shared_ptr<const PreparedObject> prepared);

  const std::unique_ptr<Catalog> catalog_;
  const PrepareFunction prepare_;
  std::vector<std::string> failures_;

  std::mutex write_mutex_;  // one writer from commit to publication
  mutable std::mutex published_mutex_;
  std::shared_ptr<const PublishedCatalog> published_;  // guarded by published_mutex_
};

}  // namespace horopter
