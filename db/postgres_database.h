// A catalog in a schema of PostgreSQL, which several servers share; internal to db/.
#pragma once

#include <memory>
#include <string>
#include <vector>

#include "db/database.h"
#include "db/postgres_connection.h"

namespace horopter {

// Connects again where the connection broke: a read outside a transaction is asked once more, a
// transaction is run again as long as it cannot have been committed.
class PostgresDatabase final : public Database {
 public:
  // Connects and brings the schema up to date, one server at a time. Errors: UNAVAILABLE (out of
  // reach), PERMISSION_DENIED, FAILED_PRECONDITION (no such database or schema, tables of somebody
  // else, of a newer version), INTERNAL (a migration failed; rolled back).
  static absl::StatusOr<std::unique_ptr<PostgresDatabase>> Open(
      const std::string& address, const std::vector<std::string>& migrations);

  // The version of the schema and the oldest version of a program that may use it.
  struct SchemaVersion {
    int64_t version = 0;
    int64_t usable_from = 0;
  };
  absl::StatusOr<SchemaVersion> ReadSchemaVersion();

  std::unique_ptr<StatementDriver> Prepare(std::string_view sql) override;
  absl::Status Execute(const std::string& sql) override;
  absl::Status RunInTransaction(const Body& body) override;
  absl::Status ReadAtOneMoment(const Body& body) override;
  absl::StatusOr<std::unique_ptr<Database>> OpenReader() override;
  absl::StatusOr<std::unique_ptr<Database>> OpenSnapshot() override;
  // Its statements are short.
  std::shared_ptr<const void> Interruptible(const StopRequested&) override { return nullptr; }
  // PostgreSQL's own tools look below the tables.
  absl::Status CheckStorage(std::vector<std::string>*) override { return absl::OkStatus(); }
  absl::Status CopyToFile(const std::string& path, const StopRequested& stop) override;
  absl::Status ReplaceBy(Database* other, const Body& after) override;
  absl::Status AfterCopy() override;
  bool IsShared() const override { return true; }
  absl::Status AwaitWrite(std::chrono::milliseconds timeout) override;

  // For the statements.
  PostgresConnection& connection() { return connection_; }
  bool InTransaction() const { return in_transaction_; }

 private:
  explicit PostgresDatabase(std::string address) : address_(address), connection_(address) {}
  absl::Status Migrate(const std::vector<std::string>& migrations);
  struct Attempt {
    absl::Status status;
    bool again = false;  // nothing was committed, and the next attempt may succeed
  };
  Attempt TryTransaction(const Body& body);
  absl::Status BeginWriting(std::string* transaction_id);
  // After a connection that broke while it committed.
  Attempt AskWhetherCommitted(const std::string& transaction_id, const absl::Status& broke);
  void RollBack();

  const std::string address_;
  PostgresConnection connection_;
  bool in_transaction_ = false;
  bool listening_ = false;
};

}  // namespace horopter
