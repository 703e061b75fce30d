#include "db/open_database.h"

#include <fcntl.h>
#include <unistd.h>

#include <cerrno>
#include <filesystem>

#include "absl/strings/str_cat.h"
#include "db/copy_database.h"
#include "db/file_lock.h"
#include "db/file_state.h"
#include "server/base/status_macros.h"

namespace horopter {
namespace {

constexpr char kRestoreAdvice[] =
    "; restore a backup (made by `horopter catalog backup`) or enrol the objects again into a new "
    "file";

// Adds the file and, for the codes an operator meets, what to do about it.
absl::Status Explain(const absl::Status& status, const std::string& path) {
  std::string advice;
  if (absl::IsUnavailable(status)) {
    advice = "is locked by another process (is a horopterd already running on it?)";
  } else if (absl::IsPermissionDenied(status)) {
    advice = "is read-only";
  } else if (absl::IsFailedPrecondition(status)) {
    advice = "cannot be opened as a database";
  } else if (absl::IsDataLoss(status)) {
    return absl::DataLossError(absl::StrCat(
        "database ", path, " is damaged: ", std::string(status.message()), kRestoreAdvice));
  } else {
    advice = "cannot be used";
  }
  return absl::Status(
      status.code(),
      absl::StrCat("database ", path, " ", advice, ": ", std::string(status.message())));
}

// SQLite reports a WAL file it may not write in several ways; asking first gives one answer. The
// folder counts too: the log lies beside the file.
absl::Status CheckWritable(const std::string& path) {
  if (path == ":memory:") return absl::OkStatus();
  const auto refused = [](const std::string& what, int mode) {
    return faccessat(AT_FDCWD, what.c_str(), mode, AT_EACCESS) != 0 &&
           (errno == EACCES || errno == EROFS);
  };
  const std::string folder = std::filesystem::path(path).parent_path().string();
  if (refused(path, R_OK | W_OK)) {
    return absl::PermissionDeniedError(absl::StrCat("database ", path, " is read-only"));
  }
  if (refused(folder.empty() ? "." : folder, W_OK | X_OK)) {
    return absl::PermissionDeniedError(
        absl::StrCat("database ", path, ": its folder is read-only"));
  }
  return absl::OkStatus();
}

// Refuses foreign and newer files. Reads only.
absl::Status CheckOwnership(sqlite3* db, const std::string& path, int newest_version) {
  HOROPTER_ASSIGN_OR_RETURN(const int64_t application, QueryInt(db, "PRAGMA application_id"));
  HOROPTER_ASSIGN_OR_RETURN(const int64_t version, QueryInt(db, "PRAGMA user_version"));
  HOROPTER_ASSIGN_OR_RETURN(const int64_t tables,
                            QueryInt(db, "SELECT count(*) FROM sqlite_schema"));
  const bool empty = application == 0 && version == 0 && tables == 0;
  if (!empty && application != kCatalogApplicationId) {
    return absl::FailedPreconditionError(absl::StrCat("database ",
                                                      path,
                                                      " is not a horopter catalog: application_id ",
                                                      application,
                                                      ", expected ",
                                                      kCatalogApplicationId));
  }
  if (version > newest_version) {
    return absl::FailedPreconditionError(absl::StrCat("database ",
                                                      path,
                                                      " has schema version ",
                                                      version,
                                                      ", this program knows up to ",
                                                      newest_version,
                                                      "; use a newer horopterd"));
  }
  return absl::OkStatus();
}

absl::Status Configure(sqlite3* db) {
  HOROPTER_RETURN_IF_ERROR(Execute(db, "PRAGMA foreign_keys=ON"));
  HOROPTER_RETURN_IF_ERROR(Execute(db, "PRAGMA trusted_schema=OFF"));
  HOROPTER_ASSIGN_OR_RETURN(const std::string mode, QueryText(db, "PRAGMA journal_mode=WAL"));
  if (mode != "wal" && mode != "memory") {
    return absl::InternalError(absl::StrCat("journal mode is '", mode, "', not WAL"));
  }
  return Execute(db, "PRAGMA synchronous=FULL");
}

absl::Status CheckIntegrity(sqlite3* db, const std::string& path) {
  const absl::StatusOr<std::string> result = QueryText(db, "PRAGMA quick_check(1)");
  if (!result.ok()) return Explain(result.status(), path);
  if (*result != "ok") {
    return absl::DataLossError(
        absl::StrCat("database ", path, " is damaged: ", *result, kRestoreAdvice));
  }
  return absl::OkStatus();
}

absl::Status Migrate(sqlite3* db,
                     const std::string& path,
                     const std::vector<std::string>& migrations) {
  HOROPTER_ASSIGN_OR_RETURN(const int64_t version, QueryInt(db, "PRAGMA user_version"));
  const bool older = version > 0 && version < static_cast<int64_t>(migrations.size());
  if (older && path != ":memory:") {
    const std::string copy = NewCopyName(path, absl::StrCat("schema-", version));
    HOROPTER_RETURN_IF_ERROR(CopyToFile(db, copy, {}));
  }
  for (size_t i = version; i < migrations.size(); ++i) {
    const absl::Status migrated = RunInTransaction(db, [&]() -> absl::Status {
      HOROPTER_RETURN_IF_ERROR(Execute(db, migrations[i]));
      HOROPTER_RETURN_IF_ERROR(
          Execute(db, absl::StrCat("PRAGMA application_id=", kCatalogApplicationId)));
      return Execute(db, absl::StrCat("PRAGMA user_version=", i + 1));
    });
    if (!migrated.ok()) return migrated;
  }
  return absl::OkStatus();
}

// An empty write transaction meets whoever has the file locked by other means than ours.
absl::Status TryToWrite(sqlite3* db) {
  HOROPTER_RETURN_IF_ERROR(Execute(db, "BEGIN EXCLUSIVE"));
  return Execute(db, "COMMIT");
}

absl::StatusOr<SqliteHandle> OpenConnection(const std::string& path, int flags, int timeout_ms) {
  sqlite3* raw = nullptr;
  const int opened = sqlite3_open_v2(path.c_str(), &raw, flags | SQLITE_OPEN_NOMUTEX, nullptr);
  SqliteHandle handle(raw);
  if (raw == nullptr) return absl::ResourceExhaustedError("out of memory");
  if (opened != SQLITE_OK) return Explain(SqliteError(raw, "open"), path);
  sqlite3_extended_result_codes(raw, 1);
  sqlite3_busy_timeout(raw, timeout_ms);
  return handle;
}

}  // namespace

absl::StatusOr<SqliteHandle> OpenDatabase(const std::string& path,
                                          int busy_timeout_ms,
                                          const std::vector<std::string>& migrations,
                                          bool accept_unclosed) {
  HOROPTER_RETURN_IF_ERROR(CheckWritable(path));
  const bool log_was_there = LogIsThere(path);
  HOROPTER_ASSIGN_OR_RETURN(
      SqliteHandle handle,
      OpenConnection(path, SQLITE_OPEN_READWRITE | SQLITE_OPEN_CREATE, busy_timeout_ms));
  sqlite3* const raw = handle.get();
  // Touches the file for the first time: locked files and files that are no database are noticed
  // here.
  if (const auto tables = QueryInt(raw, "SELECT count(*) FROM sqlite_schema"); !tables.ok()) {
    return Explain(tables.status(), path);
  }
  HOROPTER_RETURN_IF_ERROR(CheckOwnership(raw, path, static_cast<int>(migrations.size())));
  if (sqlite3_db_readonly(raw, "main") == 1) {
    return absl::PermissionDeniedError(absl::StrCat("database ", path, " is read-only"));
  }
  if (path != ":memory:") {
    const auto lock = FileLock::Take(path, busy_timeout_ms);
    if (!lock.ok()) return Explain(lock.status(), path);
    handle.get_deleter().held = *lock;
  }
  HOROPTER_RETURN_IF_ERROR(CheckIntegrity(raw, path));
  if (path != ":memory:") {
    HOROPTER_RETURN_IF_ERROR(CheckFileState(raw, path, log_was_there, accept_unclosed));
  }
  for (const auto& step : {Configure, TryToWrite}) {
    if (const absl::Status status = step(raw); !status.ok()) return Explain(status, path);
  }
  if (const absl::Status status = Migrate(raw, path, migrations); !status.ok())
    return Explain(status, path);
  return handle;
}

absl::StatusOr<SqliteHandle> OpenReadOnly(const std::string& path) {
  constexpr int kTimeoutMs = 1000;
  HOROPTER_ASSIGN_OR_RETURN(SqliteHandle handle,
                            OpenConnection(path, SQLITE_OPEN_READONLY, kTimeoutMs));
  HOROPTER_RETURN_IF_ERROR(Execute(handle.get(), "PRAGMA trusted_schema=OFF"));
  return handle;
}

}  // namespace horopter
