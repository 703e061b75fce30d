#include "db/file_state.h"

#include <filesystem>

#include "absl/strings/str_cat.h"
#include "server/base/status_macros.h"

namespace horopter {
namespace {

absl::StatusOr<bool> HasMarker(sqlite3* db) {
  HOROPTER_ASSIGN_OR_RETURN(
      const int64_t tables,
      QueryInt(db, "SELECT count(*) FROM sqlite_schema WHERE name = 'file_state'"));
  return tables > 0;
}

}  // namespace

bool LogIsThere(const std::string& path) {
  // SQLite puts the log beside the file that a link leads to.
  std::error_code error;
  const std::filesystem::path file = std::filesystem::weakly_canonical(path, error);
  return std::filesystem::exists((error ? path : file.string()) + "-wal", error);
}

absl::Status CheckFileState(sqlite3* db,
                            const std::string& path,
                            bool log_was_there,
                            bool accept_unclosed) {
  HOROPTER_ASSIGN_OR_RETURN(const bool has_marker, HasMarker(db));
  if (!has_marker) return absl::OkStatus();
  HOROPTER_ASSIGN_OR_RETURN(const int64_t closed, QueryInt(db, "SELECT closed FROM file_state"));
  if (closed == 0 && !log_was_there && !accept_unclosed) {
    return absl::DataLossError(
        absl::StrCat("database ",
                     path,
                     " was not closed and its log ",
                     path,
                     "-wal is not there: it was copied while a server had it open, and what was "
                     "written last may be missing. Copy both files of a server that is stopped, or "
                     "use `horopter catalog backup`; to go on with what is there, start once with "
                     "--accept-unclosed-db"));
  }
  HOROPTER_ASSIGN_OR_RETURN(const int64_t expected,
                            QueryInt(db, "SELECT object_count FROM file_state"));
  HOROPTER_ASSIGN_OR_RETURN(const int64_t found, QueryInt(db, "SELECT count(*) FROM object"));
  if (expected == found || accept_unclosed) return absl::OkStatus();
  return absl::DataLossError(absl::StrCat("database ",
                                          path,
                                          " holds ",
                                          found,
                                          " objects where ",
                                          expected,
                                          " were written; restore a backup, or go on with what is "
                                          "there: start once with --accept-unclosed-db"));
}

absl::Status MarkOpen(sqlite3* db) {
  absl::Status marked = RunInTransaction(db, [&] {
    return Execute(
        db, "UPDATE file_state SET closed = 0, object_count = (SELECT count(*) FROM object)");
  });
  if (marked.ok()) marked = QueryInt(db, "PRAGMA wal_checkpoint(TRUNCATE)").status();
  return absl::IsResourceExhausted(marked) ? absl::OkStatus() : marked;
}

void MarkClosed(sqlite3* db) {
  const absl::StatusOr<bool> has_marker = HasMarker(db);
  // Where it cannot be written the file stays marked as open, which is true of its log as well.
  if (has_marker.ok() && *has_marker) (void)Execute(db, "UPDATE file_state SET closed = 1");
}

}  // namespace horopter
