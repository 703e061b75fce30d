// The catalog of known parts: the source of truth of every object. It lies in a SQLite file of one
// server, or in a PostgreSQL database that several share.
#pragma once

#include <chrono>
#include <functional>
#include <memory>
#include <mutex>
#include <optional>
#include <span>
#include <string>
#include <utility>
#include <vector>

#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "db/catalog_record.h"
#include "db/copy_report.h"
#include "db/station_record.h"
#include "server/base/stop_token.h"

namespace horopter {

class Database;

// Of an object the newest so many former versions are kept, and no more bytes of them.
inline constexpr int kKeptVersions = 20;
inline constexpr int64_t kKeptVersionBytes = int64_t{256} << 20;

struct CatalogOptions {
  int busy_timeout_ms =
      1000;  // waits this long for a file another process has locked; larger: later refusal
  // Takes a file that a server had open when it was copied without its log, with what is there.
  bool accept_unclosed = false;
  // Keeps room on the disk, PATH-reserve, so that objects can be removed when it is full.
  bool disk_reserve = true;
  int64_t kept_version_bytes = kKeptVersionBytes;  // of an object; larger: a larger file
};

// Which parts of a record UpdateObject writes; the others stay as they are.
struct UpdateParts {
  bool display_name = false;
  bool geometry = false;  // diameter, vertices, edges, mesh
  bool symmetries = false;
  bool grasps = false;
  bool source = false;
  bool labels = false;
  bool print = false;
};

// Which write of which history: generations are counted again after a database was put back to an
// earlier day, tokens are random.
struct WriteIdentity {
  int64_t generation = 0;
  std::string token = {};  // empty: whichever
};
// A read of a later moment than a write that is not in the catalog's history (any more).
bool IsOtherHistory(const absl::Status& status);

// The write that a write builds on, and then the write itself: where another one came in between,
// or that one was undone, it is refused, with an error for which IsOvertaken is true, and changes
// nothing. Null: on whatever is there.
using RestsOn = WriteIdentity*;
bool IsOvertaken(const absl::Status& status);

// What was written to a catalog since some generation.
struct CatalogChanges {
  WriteIdentity last;
  std::vector<std::string> written;  // objects that were made or changed, ordered
  std::vector<std::string> removed;
};

// What an object is or was.
struct ObjectVersion {
  ObjectSummary summary;  // revision, update_time and changed_by are of the write that made it so
  // What that write changed; none: what was before is not known.
  std::optional<UpdateParts> changed;
};

// A creation that its client may repeat. Empty id: it may not.
struct RepeatableRequest {
  std::string id;
  std::string digest;  // tells apart what was asked under the same id
};
// What a repeatable request made.
struct MadeObjects {
  std::string digest;
  std::vector<std::string> object_ids;
};
// The catalog remembers this many repeatable requests; the oldest are forgotten first.
inline constexpr int kRememberedRequests = 10'000;

// The source with its hash filled in. Errors: INVALID_ARGUMENT (a field, a hash that differs).
absl::StatusOr<CadSource> WithHash(CadSource source);

// Of a file it is the one writer: a second server on it is refused. A write that returned OK is on
// disk (WAL, synchronous=FULL; synchronous_commit); one that did not has changed nothing.
// Thread-safe: calls are serialised, but for Backup and Verify, which read by connections of their
// own. An object whose rows are not those that were written (its digest differs) is DATA_LOSS for
// whoever reads it.
//
//   HOROPTER_ASSIGN_OR_RETURN(std::unique_ptr<Catalog> catalog, Catalog::Open("parts.db"));
//   HOROPTER_RETURN_IF_ERROR(catalog->CreateObject(record));
//
// Every call may also return DATA_LOSS (a stored blob or page is damaged), RESOURCE_EXHAUSTED (disk
// full) or INTERNAL.
class Catalog {
 public:
  // Creates the file when it is not there; ":memory:" for tests. postgresql://... opens a schema of
  // PostgreSQL instead, the first of its search_path, and makes the tables there. Errors, each
  // naming the file:
  // UNAVAILABLE (locked), PERMISSION_DENIED (read-only), FAILED_PRECONDITION (cannot be opened, not
  // a database, not a catalog, from a newer version), DATA_LOSS (damaged, or a copy without the log
  // of a file that was open).
  static absl::StatusOr<std::unique_ptr<Catalog>> Open(const std::string& path,
                                                       const CatalogOptions& options = {});
  // Fills an empty catalog with all that another one holds, as of one moment; a broken-off copy is
  // gone on with. Neither side may be a file that a server has open. Errors: NOT_FOUND (no file
  // `from`), those of Open and FillCatalog.
  static absl::StatusOr<CopyReport> Migrate(const std::string& from,
                                            const std::string& to,
                                            const StopRequested& stop = {},
                                            const CopyProgress& progress = {});
  ~Catalog();
  Catalog(const Catalog&) = delete;
  Catalog& operator=(const Catalog&) = delete;

  // As given to Open; an address may hold a password.
  const std::string& path() const { return path_; }
  // The same for people: an address without what is secret in it.
  static std::string ShownPath(const std::string& path);
  // Whether that is the address of a database, which servers can share, and no file.
  static bool IsSharedPath(const std::string& path);
  // Whether other servers write to it, too.
  bool IsShared() const;

  // The hash is computed; a given one must agree. Errors: INVALID_ARGUMENT (names the field),
  // ALREADY_EXISTS.
  absl::Status CreateObject(const CatalogRecord& record, const DerivedData& derived = {});

  // The same for many, in one transaction: all of them or none. Errors: as CreateObject.
  struct NewObject {
    CatalogRecord record;
    DerivedData derived;
  };
  absl::Status CreateObjects(const std::vector<NewObject>& objects,
                             const RepeatableRequest& request = {},
                             RestsOn rests_on = nullptr);

  // Errors: NOT_FOUND.
  absl::StatusOr<MadeObjects> FindRequest(const std::string& request_id);

  // Writes the chosen parts, update_time, changed_by and revision; create_time stays. With new
  // geometry or symmetries the derived data are replaced by `derived`, else they stay. What changes
  // is kept as a former version. Errors: as CreateObject, NOT_FOUND.
  absl::Status UpdateObject(const CatalogRecord& record,
                            const UpdateParts& parts,
                            const DerivedData& derived = {},
                            RestsOn rests_on = nullptr);

  // Writes the derived data of objects that are in the catalog, all in one transaction, beside
  // those of one other version; ids that are not there any more are passed over. `counts`: as a
  // write of the catalog (see Generation).
  absl::Status StoreDerived(const std::vector<std::pair<std::string, DerivedData>>& derived,
                            bool counts = false,
                            RestsOn rests_on = nullptr);

  // Empty data when there are none. Errors: NOT_FOUND.
  absl::StatusOr<DerivedData> GetDerived(const std::string& id, const DerivedWanted& wanted = {});

  // Works on a full disk as well: room for it is kept beside the file. Errors: NOT_FOUND.
  absl::Status DeleteObject(const std::string& id, RestsOn rests_on = nullptr);

  // source.content stays empty (see GetCadFile). Errors: NOT_FOUND.
  absl::StatusOr<CatalogRecord> GetObject(const std::string& id);

  // Errors: NOT_FOUND.
  absl::StatusOr<ObjectSummary> GetSummary(const std::string& id);

  // Newest first, what the object is before them. Errors: NOT_FOUND.
  absl::StatusOr<std::vector<ObjectVersion>> ListVersions(const std::string& id);

  // As the object is or was, with the bytes of its CAD file. Errors: NOT_FOUND.
  absl::StatusOr<CatalogRecord> GetVersion(const std::string& id, int64_t revision);

  // The CAD file's bytes; empty when the object was not made from a file. Errors: NOT_FOUND,
  // DATA_LOSS (hash differs).
  absl::StatusOr<std::string> GetCadFile(const std::string& id);

  // At most `limit` objects with id > after_id, ordered by id. Errors: INVALID_ARGUMENT (limit <
  // 1).
  absl::StatusOr<std::vector<ObjectSummary>> ListObjects(const std::string& after_id, int limit);

  absl::StatusOr<int> CountObjects();

  // Number of writes so far. Objects that a write made or changed have its number as revision.
  absl::StatusOr<int64_t> Generation();
  // Errors: UNAVAILABLE.
  absl::StatusOr<WriteIdentity> LastWrite();

  // What others have written since that generation, `known` being the objects there were then,
  // ordered, and `seen` the last write of which anything is known. By a connection of its own, one
  // thread at a time. Errors: UNAVAILABLE, one of IsOtherHistory.
  absl::StatusOr<CatalogChanges> ChangesSince(int64_t generation,
                                              const WriteIdentity& seen,
                                              const std::vector<std::string>& known);
  // Returns when another server may have written, and after `most` at the latest; of a catalog that
  // is not shared, at once. By a connection of its own, one thread at a time. Errors: UNAVAILABLE.
  absl::Status AwaitWrite(std::chrono::milliseconds most);

  // At most `limit` models with their derived data, id > after_id, ordered by id; of a damaged one
  // its id and what is wrong. `seen`: what is read follows from that write, which becomes the last
  // one there was. Errors: INVALID_ARGUMENT (limit < 1), one of IsOtherHistory.
  absl::StatusOr<std::vector<LoadedObject>> LoadObjects(const std::string& after_id,
                                                        int limit,
                                                        const DerivedWanted& wanted = {},
                                                        WriteIdentity* seen = nullptr);
  // The same of those of these objects that are there.
  absl::StatusOr<std::vector<LoadedObject>> LoadObjects(std::span<const std::string> ids,
                                                        const DerivedWanted& wanted,
                                                        WriteIdentity* seen = nullptr);

  // One of them. Errors: NOT_FOUND, DATA_LOSS.
  absl::StatusOr<LoadedObject> LoadObject(const std::string& id, const DerivedWanted& wanted = {});

  // At most `limit` objects' keys, id > after_id, ordered by id: objects without keys too. Errors:
  // INVALID_ARGUMENT (limit < 1).
  absl::StatusOr<std::vector<StoredKeys>> LoadKeys(const std::string& after_id,
                                                   int limit,
                                                   int version = kNewestVersion);

  // What is stored of the derived data of at most `limit` objects, id > after_id, ordered by id:
  // reads no data. `since`: of objects of a higher revision. `seen`: as for LoadObjects. Errors:
  // INVALID_ARGUMENT (limit < 1), one of IsOtherHistory.
  absl::StatusOr<std::vector<DerivedEntry>> ListDerived(const std::string& after_id,
                                                        int limit,
                                                        int version = kNewestVersion,
                                                        int64_t since = -1,
                                                        WriteIdentity* seen = nullptr);

  // Stations lie in the same file, with the same guarantees; their writes are counted apart from
  // the catalog's. Errors: NOT_FOUND, DATA_LOSS (its state is damaged).
  absl::StatusOr<StationRecord> GetStation(const std::string& id);
  // At most `limit` stations with id > after_id, ordered by id. Errors: INVALID_ARGUMENT (limit <
  // 1), DATA_LOSS.
  absl::StatusOr<std::vector<StationRecord>> ListStations(const std::string& after_id, int limit);
  // Latest first, kKeptStationEvents at most; empty when there is no such station.
  absl::StatusOr<std::vector<StationEventRecord>> StationEvents(const std::string& id);
  // Reads the station (null: there is none), lets `change` make its next state and adds the events,
  // with no other write in between. Id and revision are set here. Errors: those of `change`,
  // DATA_LOSS.
  using StationChangeFunction = std::function<absl::StatusOr<StationRecord>(
      const StationRecord* current, std::vector<StationEventRecord>* events)>;
  absl::StatusOr<StationRecord> WriteStation(const std::string& id,
                                             const StationChangeFunction& change);
  // `check` sees the station as it is; its error ends the call. Errors: NOT_FOUND, DATA_LOSS, those
  // of `check`.
  absl::Status DeleteStation(
      const std::string& id,
      const std::function<absl::Status(const StationRecord& current)>& check = {});

  // Writes a copy of the whole catalog, as of one moment, to a new file while other calls go on.
  // The copy is checked, synced and only then given its name; a failure leaves nothing behind.
  // Errors: ALREADY_EXISTS (the file is there), PERMISSION_DENIED (its folder is read-only),
  // CANCELLED.
  absl::Status Backup(const std::string& path, const StopRequested& stop = {});

  // Reads everything there is, as of one moment: pages, indexes, foreign keys, and every object as
  // if it were to be enrolled again (geometry, digest, counts, the CAD file's hash). Empty: all is
  // well. `progress` is told how many objects of how many are done. Errors: CANCELLED.
  struct Problem {
    std::string object_id;  // empty: of the file as a whole
    std::string what;
  };
  using Progress = std::function<void(int done, int total)>;
  absl::StatusOr<std::vector<Problem>> Verify(const StopRequested& stop = {},
                                              const Progress& progress = {});

  // Replaces everything by what another catalog file holds, in one transaction, after verifying it.
  // That file is brought up to date where it is older. What was there before is kept as
  // PATH.before-restore.bak. Errors: those of Open for the other file, DATA_LOSS (it is damaged).
  absl::Status Restore(const std::string& path);

 private:
  struct Reader;
  // As of this moment. Errors: those of Database::OpenSnapshot.
  absl::StatusOr<Reader> OpenReader();
  // Needs mutex_. Runs `read`; with `seen` at one moment that follows from it.
  absl::Status ReadAfter(WriteIdentity* seen, const std::function<absl::Status()>& read);
  Catalog(std::string path, std::unique_ptr<Database> database);

  const std::string path_;
  std::mutex mutex_;
  std::unique_ptr<Database> database_;              // guarded by mutex_
  std::unique_ptr<Database> reader_, listener_;     // of ChangesSince and of AwaitWrite
  int64_t kept_version_bytes_ = kKeptVersionBytes;  // set by Open
};

}  // namespace horopter
