// Backup, restoring and verification of the catalog.
#include <mutex>

#include "absl/strings/str_cat.h"
#include "db/catalog.h"
#include "db/copy_database.h"
#include "db/database.h"
#include "db/object_digest.h"
#include "db/object_rows.h"
#include "db/object_versions.h"
#include "server/base/sha256.h"
#include "server/base/status_macros.h"
#include "server/vision/geometry/station_blob.h"

namespace horopter {
namespace {

constexpr size_t kHashedAtOnce = size_t{1} << 20;

using Problems = std::vector<Catalog::Problem>;

absl::Status Stopped() {
  return absl::CancelledError("stopped");
}

absl::Status CheckPages(Database* db, Problems* problems) {
  std::vector<std::string> found;
  HOROPTER_RETURN_IF_ERROR(db->CheckStorage(&found));
  for (std::string& what : found) problems->push_back({"", std::move(what)});
  return absl::OkStatus();
}

absl::StatusOr<std::vector<std::string>> AllIds(Database* db) {
  std::vector<std::string> ids;
  Statement select(db, "SELECT object_id FROM object ORDER BY object_id");
  while (true) {
    HOROPTER_ASSIGN_OR_RETURN(const bool row, select.Step());
    if (!row) return ids;
    ids.push_back(select.Text(0));
  }
}

absl::Status CheckCadFile(Database* db, const std::string& id, const StopRequested& stop) {
  Statement select(db, "SELECT content, sha256 FROM cad_source WHERE object_id = ?");
  select.Bind(std::string_view(id));
  HOROPTER_ASSIGN_OR_RETURN(const bool row, select.Step());
  if (!row || select.Bytes(0).empty()) return absl::OkStatus();
  Sha256 sha;
  for (std::string_view left = select.Bytes(0); !left.empty();) {
    const std::string_view piece = left.substr(0, kHashedAtOnce);
    sha.Add(piece);
    left.remove_prefix(piece.size());
    if (IsStopRequested(stop)) return Stopped();
  }
  if (sha.Hex() == select.Bytes(1)) return absl::OkStatus();
  return absl::DataLossError(
      absl::StrCat("object ", id, ": the stored CAD file differs from its SHA-256"));
}

// Everything about one object that can be wrong. Errors: CANCELLED.
absl::Status CheckObject(Database* db,
                         const std::string& id,
                         const StopRequested& stop,
                         Problems* problems) {
  const auto report = [&](const absl::Status& status) {
    if (!status.ok()) problems->push_back({id, std::string(status.message())});
  };
  auto found = ReadSummaries(db, id, /*exactly=*/true, 1);
  report(found.status());
  if (!found.ok() || found->empty()) return absl::OkStatus();
  ObjectSummary& summary = found->front();
  CatalogRecord& record = summary.record;
  const absl::Status read = ReadGeometry(db, record.model);
  report(read);
  if (!read.ok()) return absl::OkStatus();
  if (IsStopRequested(stop)) return Stopped();
  report(ValidateModel(record.model));
  if (IsStopRequested(stop)) return Stopped();
  report(CheckDigest(db, record.model));
  const absl::Status file = CheckCadFile(db, id, stop);
  if (absl::IsCancelled(file)) return file;
  report(file);
  if (summary.vertex_count != static_cast<int>(record.model.vertices.size()) ||
      summary.edge_count != static_cast<int>(record.model.edges.size()) ||
      summary.triangle_count != static_cast<int>(record.model.mesh.triangles.size())) {
    problems->push_back({id, "the stored counts differ from the geometry"});
  }
  if (IsStopRequested(stop)) return Stopped();
  for (std::string& what : CheckVersions(db, id)) problems->push_back({id, std::move(what)});
  return absl::OkStatus();
}

absl::Status CheckStations(Database* db, Problems* problems) {
  Statement select(db, "SELECT station_id, state FROM station ORDER BY station_id");
  while (true) {
    HOROPTER_ASSIGN_OR_RETURN(const bool row, select.Step());
    if (!row) return absl::OkStatus();
    if (const auto state = DecodeStationState(select.Bytes(1)); !state.ok()) {
      problems->push_back(
          {"",
           absl::StrCat("station ", select.Text(0), ": ", std::string(state.status().message()))});
    }
  }
}

absl::StatusOr<Problems> VerifyDatabase(Database* db,
                                        const StopRequested& stop,
                                        const Catalog::Progress& progress) {
  const std::shared_ptr<const void> interruptible = db->Interruptible(stop);
  Problems problems;
  absl::Status status = CheckPages(db, &problems);
  if (status.ok()) status = CheckStations(db, &problems);
  absl::StatusOr<std::vector<std::string>> ids;
  if (status.ok()) status = (ids = AllIds(db)).status();
  for (size_t i = 0; status.ok() && i < ids->size(); ++i) {
    if (progress) progress(static_cast<int>(i), static_cast<int>(ids->size()));
    status = IsStopRequested(stop) ? Stopped() : CheckObject(db, (*ids)[i], stop, &problems);
  }
  if (IsStopRequested(stop)) return Stopped();
  HOROPTER_RETURN_IF_ERROR(status);
  if (progress) progress(static_cast<int>(ids->size()), static_cast<int>(ids->size()));
  return problems;
}

}  // namespace

// A database in memory has one connection, which is then locked.
struct Catalog::Reader {
  std::unique_ptr<Database> own;
  std::unique_lock<std::mutex> lock;
  Database* db = nullptr;
};

absl::StatusOr<Catalog::Reader> Catalog::OpenReader() {
  Reader reader;
  HOROPTER_ASSIGN_OR_RETURN(reader.own, database_->OpenSnapshot());
  reader.db = reader.own.get();
  if (reader.own == nullptr) {
    reader.lock = std::unique_lock(mutex_);
    reader.db = database_.get();
  }
  return reader;
}

absl::Status Catalog::Backup(const std::string& path, const StopRequested& stop) {
  HOROPTER_ASSIGN_OR_RETURN(const Reader reader, OpenReader());
  return reader.db->CopyToFile(path, stop);
}

absl::StatusOr<std::vector<Catalog::Problem>> Catalog::Verify(const StopRequested& stop,
                                                              const Progress& progress) {
  HOROPTER_ASSIGN_OR_RETURN(const Reader reader, OpenReader());
  return VerifyDatabase(reader.db, stop, progress);
}

absl::Status Catalog::Restore(const std::string& path) {
  // Refuses what is no catalog, is newer or damaged, and brings it up to date.
  HOROPTER_ASSIGN_OR_RETURN(const std::unique_ptr<Catalog> backup,
                            Open(path, {.disk_reserve = false}));
  HOROPTER_ASSIGN_OR_RETURN(const Problems problems, backup->Verify());
  if (!problems.empty()) {
    return absl::DataLossError(absl::StrCat("the backup is damaged: ",
                                            problems[0].object_id,
                                            problems[0].object_id.empty() ? "" : ": ",
                                            problems[0].what));
  }
  if (path_ != ":memory:" && !IsShared())
    HOROPTER_RETURN_IF_ERROR(Backup(NewCopyName(path_, "before-restore")));
  const std::lock_guard lock(mutex_);
  Database* db = database_.get();
  // Numbers of writes do not come twice, and what was read before is not what is there now.
  HOROPTER_ASSIGN_OR_RETURN(const int64_t before,
                            QueryInt(db, "SELECT generation FROM catalog_state"));
  HOROPTER_ASSIGN_OR_RETURN(const int64_t station_writes,
                            QueryInt(db, "SELECT writes FROM station_writes"));
  return db->ReplaceBy(backup->database_.get(), [&]() -> absl::Status {
    Statement count(db,
                    "UPDATE catalog_state SET generation = "
                    "CASE WHEN generation > ?1 THEN generation ELSE ?1 END + 1");
    HOROPTER_RETURN_IF_ERROR(count.Bind(before).Run());
    Statement of_stations(db,
                          "UPDATE station_writes SET writes = "
                          "CASE WHEN writes > ?1 THEN writes ELSE ?1 END + 1");
    HOROPTER_RETURN_IF_ERROR(of_stations.Bind(station_writes).Run());
    HOROPTER_RETURN_IF_ERROR(
        Execute(db, "UPDATE station SET revision = (SELECT writes FROM station_writes)"));
    return Execute(db, "UPDATE object SET revision = (SELECT generation FROM catalog_state)");
  });
}

}  // namespace horopter
