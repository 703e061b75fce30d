// Thin owner of a SQLite connection and its statements; internal to db/.
#pragma once

#include <sqlite3.h>

#include <cstdint>
#include <functional>
#include <memory>
#include <string>
#include <string_view>

#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "db/database.h"

namespace horopter {

struct SqliteCloser {
  std::shared_ptr<const void> held;  // let go after the connection is closed; may be null
  void operator()(sqlite3* db) const { sqlite3_close_v2(db); }
};
using SqliteHandle = std::unique_ptr<sqlite3, SqliteCloser>;

// The last error of the connection as a status. UNAVAILABLE: locked by another process;
// PERMISSION_DENIED: read-only; FAILED_PRECONDITION: not a database or cannot be opened; DATA_LOSS:
// damaged; RESOURCE_EXHAUSTED: disk full; ALREADY_EXISTS: primary key taken; INTERNAL: the rest.
// `what` says what was tried.
absl::Status SqliteError(sqlite3* db, std::string_view what);

// A prepared statement of SQLite.
class SqliteStatement final : public StatementDriver {
 public:
  SqliteStatement(sqlite3* db, std::string_view sql);
  ~SqliteStatement() override { sqlite3_finalize(statement_); }
  SqliteStatement(const SqliteStatement&) = delete;
  SqliteStatement& operator=(const SqliteStatement&) = delete;

  void BindInt(int position, int64_t value) override;
  void BindDouble(int position, double value) override;
  void BindText(int position, std::string_view text) override;
  void BindBlob(int position, std::string_view bytes) override;
  void BindNull(int position) override;
  absl::StatusOr<bool> Step() override;
  // Steps to the end.
  absl::Status Run() override;
  void Reset() override;

  int64_t Int(int column) const override { return sqlite3_column_int64(statement_, column); }
  double Double(int column) const override { return sqlite3_column_double(statement_, column); }
  bool IsNull(int column) const override {
    return sqlite3_column_type(statement_, column) == SQLITE_NULL;
  }
  // Valid until the next Step or Reset.
  std::string_view Bytes(int column) const override;
  int ColumnCount() const override { return sqlite3_column_count(statement_); }
  ValueKind KindOf(int column) const override;
  std::string Text(int column) const { return std::string(Bytes(column)); }

 private:
  sqlite3* db_;
  std::string sql_;
  sqlite3_stmt* statement_ = nullptr;
  int error_ = SQLITE_OK;
};

// Runs one or more statements without parameters or rows.
absl::Status Execute(sqlite3* db, const std::string& sql);

// First column of the first row. Errors: see SqliteError; INTERNAL when there is no row.
absl::StatusOr<int64_t> QueryInt(sqlite3* db, std::string_view sql);
absl::StatusOr<std::string> QueryText(sqlite3* db, std::string_view sql);

// As Database::RunInTransaction.
absl::Status RunInTransaction(sqlite3* db, const std::function<absl::Status()>& body);

}  // namespace horopter
