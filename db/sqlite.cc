#include "db/sqlite.h"

#include "absl/strings/str_cat.h"
#include "server/base/crash_point.h"
#include "server/base/status_macros.h"

namespace horopter {
namespace {

absl::StatusCode CodeOf(int extended) {
  if (extended == SQLITE_CONSTRAINT_PRIMARYKEY) return absl::StatusCode::kAlreadyExists;
  switch (extended & 0xff) {
    case SQLITE_BUSY:
    case SQLITE_LOCKED:
      return absl::StatusCode::kUnavailable;
    case SQLITE_READONLY:
    case SQLITE_PERM:
    case SQLITE_AUTH:
      return absl::StatusCode::kPermissionDenied;
    case SQLITE_CANTOPEN:
    case SQLITE_NOTADB:
      return absl::StatusCode::kFailedPrecondition;
    case SQLITE_CORRUPT:
      return absl::StatusCode::kDataLoss;
    case SQLITE_FULL:
    case SQLITE_NOMEM:
      return absl::StatusCode::kResourceExhausted;
    default:
      return absl::StatusCode::kInternal;
  }
}

}  // namespace

absl::Status SqliteError(sqlite3* db, std::string_view what) {
  return absl::Status(CodeOf(sqlite3_extended_errcode(db)),
                      absl::StrCat(std::string(what),
                                   ": ",
                                   sqlite3_errmsg(db),
                                   " (SQLite ",
                                   sqlite3_extended_errcode(db),
                                   ")"));
}

SqliteStatement::SqliteStatement(sqlite3* db, std::string_view sql) : db_(db), sql_(sql) {
  error_ =
      sqlite3_prepare_v2(db_, sql_.data(), static_cast<int>(sql_.size()), &statement_, nullptr);
}

void SqliteStatement::BindInt(int position, int64_t value) {
  if (error_ == SQLITE_OK) error_ = sqlite3_bind_int64(statement_, position, value);
}

void SqliteStatement::BindDouble(int position, double value) {
  if (error_ == SQLITE_OK) error_ = sqlite3_bind_double(statement_, position, value);
}

void SqliteStatement::BindText(int position, std::string_view text) {
  // A null pointer would bind NULL instead of the empty text.
  const char* data = text.empty() ? "" : text.data();
  if (error_ == SQLITE_OK) {
    error_ =
        sqlite3_bind_text64(statement_, position, data, text.size(), SQLITE_STATIC, SQLITE_UTF8);
  }
}

void SqliteStatement::BindBlob(int position, std::string_view bytes) {
  const char* data = bytes.empty() ? "" : bytes.data();
  if (error_ == SQLITE_OK) {
    error_ = sqlite3_bind_blob64(statement_, position, data, bytes.size(), SQLITE_STATIC);
  }
}

void SqliteStatement::BindNull(int position) {
  if (error_ == SQLITE_OK) error_ = sqlite3_bind_null(statement_, position);
}

absl::StatusOr<bool> SqliteStatement::Step() {
  if (error_ == SQLITE_OK) {
    const int result = sqlite3_step(statement_);
    if (result == SQLITE_ROW) return true;
    if (result == SQLITE_DONE) return false;
  }
  return SqliteError(db_, sql_);
}

void SqliteStatement::Reset() {
  sqlite3_reset(statement_);
  sqlite3_clear_bindings(statement_);
}

absl::Status SqliteStatement::Run() {
  HOROPTER_ASSIGN_OR_RETURN(bool row, Step());
  while (row) {
    HOROPTER_ASSIGN_OR_RETURN(row, Step());
  }
  return absl::OkStatus();
}

std::string_view SqliteStatement::Bytes(int column) const {
  const void* data = sqlite3_column_blob(statement_, column);
  const int size = sqlite3_column_bytes(statement_, column);
  return data == nullptr ? std::string_view()
                         : std::string_view(static_cast<const char*>(data), size);
}

ValueKind SqliteStatement::KindOf(int column) const {
  switch (sqlite3_column_type(statement_, column)) {
    case SQLITE_INTEGER:
      return ValueKind::kInt;
    case SQLITE_FLOAT:
      return ValueKind::kDouble;
    case SQLITE_TEXT:
      return ValueKind::kText;
    case SQLITE_BLOB:
      return ValueKind::kBlob;
    default:
      return ValueKind::kNull;
  }
}

absl::Status Execute(sqlite3* db, const std::string& sql) {
  if (sqlite3_exec(db, sql.c_str(), nullptr, nullptr, nullptr) != SQLITE_OK) {
    return SqliteError(db, sql.substr(0, 80));
  }
  return absl::OkStatus();
}

absl::StatusOr<int64_t> QueryInt(sqlite3* db, std::string_view sql) {
  SqliteStatement statement(db, sql);
  HOROPTER_ASSIGN_OR_RETURN(const bool row, statement.Step());
  if (!row) return absl::InternalError(absl::StrCat("no row: ", std::string(sql)));
  return statement.Int(0);
}

absl::StatusOr<std::string> QueryText(sqlite3* db, std::string_view sql) {
  SqliteStatement statement(db, sql);
  HOROPTER_ASSIGN_OR_RETURN(const bool row, statement.Step());
  if (!row) return absl::InternalError(absl::StrCat("no row: ", std::string(sql)));
  return statement.Text(0);
}

absl::Status RunInTransaction(sqlite3* db, const std::function<absl::Status()>& body) {
  HOROPTER_RETURN_IF_ERROR(Execute(db, "BEGIN IMMEDIATE"));
  CrashPoint("transaction.begun");
  absl::Status status;
  try {
    status = body();
  } catch (...) {  // memory was short: nothing of it may stay
    sqlite3_exec(db, "ROLLBACK", nullptr, nullptr, nullptr);
    throw;
  }
  CrashPoint("transaction.before_commit");
  if (status.ok()) status = Execute(db, "COMMIT");
  CrashPoint("transaction.after_commit");
  // Some errors (disk full) have rolled back already; a second rollback then fails and changes
  // nothing.
  if (!status.ok()) sqlite3_exec(db, "ROLLBACK", nullptr, nullptr, nullptr);
  return status;
}

}  // namespace horopter
