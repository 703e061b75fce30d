// How servers that share a catalog learn what the others wrote.
#include <algorithm>
#include <iterator>
#include <utility>

#include "db/catalog.h"
#include "db/catalog_writes.h"
#include "db/database.h"
#include "server/base/status_macros.h"

namespace horopter {
namespace {

absl::StatusOr<std::vector<std::string>> IdsOf(Statement select) {
  std::vector<std::string> ids;
  while (true) {
    HOROPTER_ASSIGN_OR_RETURN(const bool row, select.Step());
    if (!row) return ids;
    ids.push_back(select.Text(0));
  }
}

absl::Status ReadChanges(Database* db,
                         int64_t since,
                         const WriteIdentity& seen,
                         const std::vector<std::string>& known,
                         CatalogChanges* changes) {
  HOROPTER_ASSIGN_OR_RETURN(changes->last, LastWriteAfter(db, seen));
  if (changes->last.generation == since) return absl::OkStatus();
  Statement written(db, "SELECT object_id FROM object WHERE revision > ? ORDER BY object_id");
  written.Bind(since);
  HOROPTER_ASSIGN_OR_RETURN(changes->written, IdsOf(std::move(written)));
  // Objects that were made since are among those written: with these there are as many as there
  // should be, unless some were removed.
  std::vector<std::string> expected;
  std::set_union(known.begin(),
                 known.end(),
                 changes->written.begin(),
                 changes->written.end(),
                 std::back_inserter(expected));
  HOROPTER_ASSIGN_OR_RETURN(const int64_t objects, QueryInt(db, "SELECT count(*) FROM object"));
  if (objects == static_cast<int64_t>(expected.size())) return absl::OkStatus();
  HOROPTER_ASSIGN_OR_RETURN(
      const std::vector<std::string> all,
      IdsOf(Statement(db, "SELECT object_id FROM object ORDER BY object_id")));
  std::set_difference(
      known.begin(), known.end(), all.begin(), all.end(), std::back_inserter(changes->removed));
  return absl::OkStatus();
}

}  // namespace

absl::StatusOr<CatalogChanges> Catalog::ChangesSince(int64_t generation,
                                                     const WriteIdentity& seen,
                                                     const std::vector<std::string>& known) {
  CatalogChanges changes;
  if (!database_->IsShared()) {
    const std::lock_guard lock(mutex_);
    HOROPTER_RETURN_IF_ERROR(database_->ReadAtOneMoment(
        [&] { return ReadChanges(database_.get(), generation, seen, known, &changes); }));
    return changes;
  }
  if (reader_ == nullptr) {
    HOROPTER_ASSIGN_OR_RETURN(reader_, database_->OpenReader());
  }
  HOROPTER_RETURN_IF_ERROR(reader_->ReadAtOneMoment([&] {
    changes = {};
    return ReadChanges(reader_.get(), generation, seen, known, &changes);
  }));
  return changes;
}

absl::Status Catalog::AwaitWrite(std::chrono::milliseconds most) {
  if (!database_->IsShared()) return absl::OkStatus();
  if (listener_ == nullptr) {
    HOROPTER_ASSIGN_OR_RETURN(listener_, database_->OpenReader());
  }
  return listener_->AwaitWrite(most);
}

}  // namespace horopter
