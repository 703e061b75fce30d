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

// A prepared statement; bound positions and columns count from 1 and 0 as in SQLite. Errors of Bind
// are kept and returned by the next Step.
class Statement {
 public:
  Statement(sqlite3* db, std::string_view sql);
  ~Statement() { sqlite3_finalize(statement_); }
  Statement(const Statement&) = delete;
  Statement& operator=(const Statement&) = delete;

  // Bound text and blobs must live until the next Step has returned.
  Statement& Bind(int64_t value);
  Statement& Bind(double value);
  Statement& Bind(std::string_view text);
  Statement& BindBlob(std::string_view bytes);
  Statement& BindNull();

  // True: a row is there. False: done. Errors: see SqliteError.
  absl::StatusOr<bool> Step();
  // For statements without rows: steps to the end and makes the statement ready to be bound again.
  absl::Status Run();
  void Reset();

  int64_t Int(int column) const { return sqlite3_column_int64(statement_, column); }
  double Double(int column) const { return sqlite3_column_double(statement_, column); }
  bool IsNull(int column) const { return sqlite3_column_type(statement_, column) == SQLITE_NULL; }
  // Valid until the next Step or Reset.
  std::string_view Bytes(int column) const;
  std::string Text(int column) const { return std::string(Bytes(column)); }

 private:
  sqlite3* db_;
  std::string sql_;
  sqlite3_stmt* statement_ = nullptr;
  int next_ = 1;
  int error_ = SQLITE_OK;
};

// Runs one or more statements without parameters or rows.
absl::Status Execute(sqlite3* db, const std::string& sql);

// First column of the first row. Errors: see SqliteError; INTERNAL when there is no row.
absl::StatusOr<int64_t> QueryInt(sqlite3* db, std::string_view sql);
absl::StatusOr<std::string> QueryText(sqlite3* db, std::string_view sql);

// The one transaction of the project: begins, runs `body`, commits when it returns OK and the
// commit succeeds, rolls back otherwise, also when it throws.
absl::Status RunInTransaction(sqlite3* db, const std::function<absl::Status()>& body);

}  // namespace horopter
