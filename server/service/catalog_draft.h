// The next state of the published catalog, made beside the present one: whatever can fail has
// failed before it takes the other's place.
#pragma once

#include <map>
#include <memory>
#include <set>
#include <string>
#include <vector>

#include "absl/status/status.h"
#include "server/pipeline/pipeline.h"

namespace horopter {

// What a request works on. ids[i] names snapshot.objects[i]; ordered.
struct PublishedCatalog {
  CatalogSnapshot snapshot;
  std::vector<std::string> ids;
  // Of what is derived of each object (db/object_digest.h), where objects are read when they are
  // asked for: such a catalog has no index of keys in memory (key_segments.h). Else empty.
  std::vector<std::string> addresses;
  // Objects of the catalog that are left out, and why: damaged (their digest differs), or of a
  // geometry that cannot be prepared.
  std::map<std::string, std::string> unusable;
  // Objects that are left out until they are prepared again.
  std::set<std::string> pending;

  bool Contains(const std::string& id) const;
};

// What a writer changes: the published state, the index behind it, and the index's free slots.
struct WriterState {
  std::shared_ptr<const PublishedCatalog> published;
  KeyIndex index;
  std::vector<int> free_slots;
};

// Changes a copy; copies share all but what is touched. Not thread-safe.
class CatalogDraft {
 public:
  using Prepared = std::shared_ptr<const PreparedObject>;
  using Handle = std::shared_ptr<const StoredObject>;

  CatalogDraft(const WriterState& from, const ObjectPreparer& preparer);

  // Adds or replaces one object. `handle`: of a catalog whose objects are read when they are asked
  // for; else null. Errors: INVALID_ARGUMENT (its keys).
  absl::Status Put(const std::string& id, const Prepared& prepared, Handle handle);
  // The same of a catalog whose objects are read when they are asked for.
  void PutStored(const std::string& id, std::string address, Handle handle);
  // Nothing happens when there is none.
  void Remove(const std::string& id);
  // Of one that was pending.
  void LeaveOut(const std::string& id, const std::string& why);
  // It is left out until it is prepared.
  void Postpone(const std::string& id);

  // The state to adopt. Errors: those of the index.
  absl::StatusOr<WriterState> Finish(int64_t generation) &&;

 private:
  // Of a catalog whose objects are in memory.
  absl::Status PutResident(const std::string& id, const Prepared& prepared, std::ptrdiff_t at);
  // Takes the object's keys out of the index.
  void EraseKeys(int at);

  const ObjectPreparer& preparer_;
  std::shared_ptr<PublishedCatalog> next_;
  KeyIndex index_;
  std::vector<int> free_slots_;
};

}  // namespace horopter
