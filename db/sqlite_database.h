// A catalog in a SQLite file: one process, one writer; internal to db/.
#pragma once

#include <memory>
#include <string>
#include <vector>

#include "db/catalog.h"
#include "db/database.h"
#include "db/disk_reserve.h"
#include "db/sqlite.h"

namespace horopter {

class SqliteDatabase final : public Database {
 public:
  // Errors: those of Catalog::Open.
  static absl::StatusOr<std::unique_ptr<SqliteDatabase>> Open(const std::string& path,
                                                              const CatalogOptions& options);
  // Marks the file as closed.
  ~SqliteDatabase() override;

  // From here on the file is marked as open, and room is kept beside it.
  absl::Status BeginServing(bool disk_reserve);
  sqlite3* handle() const { return handle_.get(); }

  std::unique_ptr<StatementDriver> Prepare(std::string_view sql) override;
  absl::Status Execute(const std::string& sql) override;
  absl::Status RunInTransaction(const Body& body) override;
  // Where the disk is full the reserve is given for it. Then the log is merged if there is room for
  // all of it, so that it begins anew.
  absl::Status RunFreeing(const Body& body) override;
  absl::Status ReadAtOneMoment(const Body& body) override;
  absl::StatusOr<std::unique_ptr<Database>> OpenReader() override;
  absl::StatusOr<std::unique_ptr<Database>> OpenSnapshot() override;
  std::shared_ptr<const void> Interruptible(const StopRequested& stop) override;
  absl::Status CheckStorage(std::vector<std::string>* problems) override;
  absl::Status CopyToFile(const std::string& path, const StopRequested& stop) override;
  // The other one is a SqliteDatabase, too; `after` runs in a transaction that follows.
  absl::Status ReplaceBy(Database* other, const Body& after) override;

 private:
  SqliteDatabase(std::string path, SqliteHandle handle)
      : path_(std::move(path)), handle_(std::move(handle)) {}
  bool InMemory() const { return path_ == ":memory:"; }

  const std::string path_;
  SqliteHandle handle_;
  bool serving_ = false;
  std::unique_ptr<DiskReserve> reserve_;  // none of a database in memory
};

}  // namespace horopter
