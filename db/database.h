// What the catalog asks of a database: statements, transactions, snapshots. SQLite and PostgreSQL
// stand behind it (ADR 89); internal to db/.
//
// SQL is written once, in what both understand: `?` or `?N` for bound values, ON CONFLICT and not
// OR REPLACE, no scalar max(). Tables and columns have the same names in both.
#pragma once

#include <chrono>
#include <cstdint>
#include <functional>
#include <memory>
#include <string>
#include <string_view>
#include <utility>
#include <vector>

#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "server/base/stop_token.h"

namespace horopter {

enum class ValueKind { kNull, kInt, kDouble, kText, kBlob };

// A prepared statement of one of the databases. Positions count from 1, columns from 0. What is
// wrong with it or with a bound value is returned by the next Step. Bound text and blobs must live
// until then.
class StatementDriver {
 public:
  virtual ~StatementDriver() = default;
  virtual void BindInt(int position, int64_t value) = 0;
  virtual void BindDouble(int position, double value) = 0;
  virtual void BindText(int position, std::string_view text) = 0;
  virtual void BindBlob(int position, std::string_view bytes) = 0;
  virtual void BindNull(int position) = 0;
  // True: a row is there. False: done.
  virtual absl::StatusOr<bool> Step() = 0;
  // Of a statement without rows. Inside a transaction it may be carried out later, but before
  // whatever reads or commits, which then returns its error.
  virtual absl::Status Run() = 0;
  virtual void Reset() = 0;
  virtual int64_t Int(int column) const = 0;
  virtual double Double(int column) const = 0;
  virtual bool IsNull(int column) const = 0;
  virtual std::string_view Bytes(int column) const = 0;
  virtual int ColumnCount() const = 0;
  virtual ValueKind KindOf(int column) const = 0;
};

// One connection; not thread-safe. Errors of all calls: UNAVAILABLE (locked by another process, or
// out of reach), PERMISSION_DENIED, FAILED_PRECONDITION (no database, no catalog, of a newer
// version), DATA_LOSS (damaged), RESOURCE_EXHAUSTED (disk full), ALREADY_EXISTS (primary key
// taken), INTERNAL.
class Database {
 public:
  using Body = std::function<absl::Status()>;

  virtual ~Database() = default;
  virtual std::unique_ptr<StatementDriver> Prepare(std::string_view sql) = 0;
  // One or more statements without parameters or rows.
  virtual absl::Status Execute(const std::string& sql) = 0;

  // The one transaction of the project: begins, runs `body`, commits when it returns OK and the
  // commit succeeds, rolls back otherwise, also when it throws. One writer at a time: what the body
  // reads is what every transaction before it left, and stays until it commits. A shared database
  // may run the body again, after a failure that has left nothing behind.
  virtual absl::Status RunInTransaction(const Body& body) = 0;
  // The same for what frees room: works on a full disk where room was kept for it.
  virtual absl::Status RunFreeing(const Body& body) { return RunInTransaction(body); }

  // Runs `body`, which only reads, and all of it sees the same moment.
  virtual absl::Status ReadAtOneMoment(const Body& body) = 0;
  // Another connection, to read by beside this one; null: there can be none.
  virtual absl::StatusOr<std::unique_ptr<Database>> OpenReader() = 0;
  // Another connection that reads what is there at this moment; null: there can be none (a database
  // in memory), this one has to do.
  virtual absl::StatusOr<std::unique_ptr<Database>> OpenSnapshot() = 0;
  // Lets a long statement of this connection end early, with an error, while the result lives.
  virtual std::shared_ptr<const void> Interruptible(const StopRequested& stop) = 0;
  // What is wrong with the storage below the tables, one message each.
  virtual absl::Status CheckStorage(std::vector<std::string>* problems) = 0;

  // Writes all that this connection sees as a SQLite file: checked, synced and only then given its
  // name. Errors: also ALREADY_EXISTS (the file is there), CANCELLED.
  virtual absl::Status CopyToFile(const std::string& path, const StopRequested& stop) = 0;
  // Replaces all rows by those of another database of the present schema, then runs `after` in the
  // same transaction where the database can do that, else in the next one.
  virtual absl::Status ReplaceBy(Database* other, const Body& after) = 0;

  // After rows were copied into the tables, inside the transaction: what counts them up is set.
  virtual absl::Status AfterCopy() { return absl::OkStatus(); }

  // Whether other processes write to it, too.
  virtual bool IsShared() const { return false; }
  // Waits until another process may have written, or the time is over. Errors: UNAVAILABLE.
  virtual absl::Status AwaitWrite(std::chrono::milliseconds) { return absl::OkStatus(); }
};

// A prepared statement with its values bound one after the other. Errors of Bind are kept and
// returned by the next Step.
class Statement {
 public:
  Statement(Database* db, std::string_view sql) : driver_(db->Prepare(sql)) {}

  // Bound text and blobs must live until the next Step has returned.
  Statement& Bind(int64_t value);
  Statement& Bind(double value);
  Statement& Bind(std::string_view text);
  Statement& BindBlob(std::string_view bytes);
  Statement& BindNull();

  // True: a row is there. False: done.
  absl::StatusOr<bool> Step() { return driver_->Step(); }
  // For statements without rows: carries it out and makes it ready to be bound again.
  absl::Status Run();

  int64_t Int(int column) const { return driver_->Int(column); }
  double Double(int column) const { return driver_->Double(column); }
  bool IsNull(int column) const { return driver_->IsNull(column); }
  // Valid until the next Step.
  std::string_view Bytes(int column) const { return driver_->Bytes(column); }
  std::string Text(int column) const { return std::string(Bytes(column)); }
  int ColumnCount() const { return driver_->ColumnCount(); }
  ValueKind KindOf(int column) const { return driver_->KindOf(column); }

 private:
  std::unique_ptr<StatementDriver> driver_;
  int next_ = 1;
};

// As the members; so that code reads the same for a connection of SQLite alone.
absl::Status Execute(Database* db, const std::string& sql);
absl::Status RunInTransaction(Database* db, const Database::Body& body);

// First column of the first row. Errors: also INTERNAL when there is no row.
absl::StatusOr<int64_t> QueryInt(Database* db, std::string_view sql);
absl::StatusOr<std::string> QueryText(Database* db, std::string_view sql);

}  // namespace horopter
