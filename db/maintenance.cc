// Backup and verification of the catalog.
#include <fcntl.h>
#include <unistd.h>

#include <cerrno>
#include <cstring>
#include <filesystem>
#include <system_error>

#include "absl/strings/str_cat.h"
#include "db/catalog.h"
#include "db/connection.h"
#include "db/object_rows.h"
#include "db/open_database.h"
#include "db/sqlite.h"
#include "server/base/status_macros.h"

namespace horopter {
namespace {

// Pages copied before other calls get their turn: 4 MiB.
constexpr int kPagesPerStep = 1024;

absl::Status FileError(const std::string& path, std::string_view what, int error) {
  const std::string message =
      absl::StrCat("backup ", path, ": ", std::string(what), ": ", std::strerror(error));
  if (error == EEXIST) return absl::AlreadyExistsError(message);
  if (error == EACCES || error == EROFS) return absl::PermissionDeniedError(message);
  if (error == ENOSPC || error == EDQUOT) return absl::ResourceExhaustedError(message);
  return absl::FailedPreconditionError(message);
}

// Makes what was written, or a new name in a folder, survive a power cut.
absl::Status Sync(const std::string& path) {
  const int file = open(path.c_str(), O_RDONLY | O_CLOEXEC);
  if (file < 0) return FileError(path, "cannot be opened", errno);
  const int result = fsync(file), error = errno;
  close(file);
  return result == 0 ? absl::OkStatus() : FileError(path, "cannot be synced", error);
}

// Removes the unfinished copy unless it was released.
class UnfinishedFile {
 public:
  explicit UnfinishedFile(std::string path) : path_(std::move(path)) {}
  ~UnfinishedFile() {
    std::error_code ignored;
    if (!path_.empty()) std::filesystem::remove(path_, ignored);
  }
  void Release() { path_.clear(); }

 private:
  std::string path_;
};

}  // namespace

absl::Status Catalog::Backup(const std::string& path) {
  std::error_code error;
  if (std::filesystem::exists(path, error)) return FileError(path, "is there already", EEXIST);
  const std::string unfinished = absl::StrCat(path, ".", getpid(), ".unfinished");
  // Ours alone from the start: a name that another backup uses is refused.
  const int made = open(unfinished.c_str(), O_CREAT | O_EXCL | O_WRONLY | O_CLOEXEC, 0600);
  if (made < 0) return FileError(path, "cannot be created", errno);
  close(made);
  UnfinishedFile file(unfinished);

  sqlite3* raw = nullptr;
  const int opened = sqlite3_open_v2(
      unfinished.c_str(), &raw, SQLITE_OPEN_READWRITE | SQLITE_OPEN_NOMUTEX, nullptr);
  SqliteHandle copy(raw);
  if (opened != SQLITE_OK) return SqliteError(raw, "open the backup");
  sqlite3_backup* backup = nullptr;
  {
    const std::lock_guard lock(mutex_);
    backup = sqlite3_backup_init(raw, "main", connection_->handle.get(), "main");
    if (backup == nullptr) return SqliteError(raw, "start the backup");
  }
  int step = SQLITE_OK;
  while (step == SQLITE_OK) {
    // The lock is let go between steps; what this process writes meanwhile SQLite carries over.
    const std::lock_guard lock(mutex_);
    step = sqlite3_backup_step(backup, kPagesPerStep);
  }
  {
    const std::lock_guard lock(mutex_);
    sqlite3_backup_finish(backup);
  }
  if (step != SQLITE_DONE) return SqliteError(raw, "write the backup");
  // A copy is one file: without the log of the original.
  HOROPTER_RETURN_IF_ERROR(QueryText(raw, "PRAGMA journal_mode=DELETE").status());
  HOROPTER_ASSIGN_OR_RETURN(const std::string check, QueryText(raw, "PRAGMA quick_check(1)"));
  if (check != "ok") return absl::DataLossError(absl::StrCat("backup ", path, ": ", check));
  copy.reset();
  HOROPTER_RETURN_IF_ERROR(Sync(unfinished));
  // link() and not rename(): a file that has appeared meanwhile is not replaced.
  if (link(unfinished.c_str(), path.c_str()) != 0) {
    return FileError(path, "cannot be named", errno);
  }
  const std::string folder = std::filesystem::path(path).parent_path().string();
  return Sync(folder.empty() ? "." : folder);
}

absl::StatusOr<std::vector<Catalog::Problem>> Catalog::Verify() {
  std::vector<Problem> problems;
  std::vector<std::string> ids;
  {
    const std::lock_guard lock(mutex_);
    sqlite3* db = connection_->handle.get();
    Statement integrity(db, "PRAGMA integrity_check(20)");
    while (true) {
      HOROPTER_ASSIGN_OR_RETURN(const bool row, integrity.Step());
      if (!row) break;
      if (integrity.Bytes(0) != "ok") problems.push_back({"", integrity.Text(0)});
    }
    Statement keys(db, "PRAGMA foreign_key_check");
    while (true) {
      HOROPTER_ASSIGN_OR_RETURN(const bool row, keys.Step());
      if (!row) break;
      problems.push_back({"", absl::StrCat("table ", keys.Text(0), " refers to a missing row")});
    }
    Statement select(db, "SELECT object_id FROM object ORDER BY object_id");
    while (true) {
      HOROPTER_ASSIGN_OR_RETURN(const bool row, select.Step());
      if (!row) break;
      ids.push_back(select.Text(0));
    }
  }
  for (const std::string& id : ids) {
    const absl::StatusOr<CatalogRecord> record = GetObject(id);
    if (absl::IsNotFound(record.status())) continue;  // removed meanwhile
    const auto report = [&](const absl::Status& status) {
      if (!status.ok()) problems.push_back({id, std::string(status.message())});
    };
    report(record.status());
    if (!record.ok()) continue;
    report(ValidateModel(record->model));
    if (record->source.size_bytes > 0) {
      if (const auto file = GetCadFile(id); !absl::IsNotFound(file.status())) report(file.status());
    }
    const absl::StatusOr<ObjectSummary> summary = GetSummary(id);
    if (summary.ok() &&
        (summary->vertex_count != static_cast<int>(record->model.vertices.size()) ||
         summary->edge_count != static_cast<int>(record->model.edges.size()) ||
         summary->triangle_count != static_cast<int>(record->model.mesh.triangles.size()))) {
      problems.push_back({id, "the stored counts differ from the geometry"});
    }
  }
  return problems;
}

}  // namespace horopter
