#include "db/sqlite_database.h"

#include <utility>

#include "absl/strings/str_cat.h"
#include "db/copy_database.h"
#include "db/file_state.h"
#include "db/migrations.h"
#include "db/open_database.h"
#include "server/base/status_macros.h"

namespace horopter {

absl::StatusOr<std::unique_ptr<SqliteDatabase>> SqliteDatabase::Open(
    const std::string& path, const CatalogOptions& options) {
  HOROPTER_ASSIGN_OR_RETURN(
      SqliteHandle handle,
      OpenDatabase(path, options.busy_timeout_ms, CatalogMigrations(), options.accept_unclosed));
  return std::unique_ptr<SqliteDatabase>(new SqliteDatabase(path, std::move(handle)));
}

SqliteDatabase::~SqliteDatabase() {
  if (serving_) MarkClosed(handle_.get());
}

absl::Status SqliteDatabase::BeginServing(bool disk_reserve) {
  if (InMemory()) return absl::OkStatus();
  serving_ = true;
  HOROPTER_RETURN_IF_ERROR(MarkOpen(handle_.get()));
  if (disk_reserve) reserve_ = std::make_unique<DiskReserve>(path_);
  return absl::OkStatus();
}

std::unique_ptr<StatementDriver> SqliteDatabase::Prepare(std::string_view sql) {
  return std::make_unique<SqliteStatement>(handle_.get(), sql);
}

absl::Status SqliteDatabase::Execute(const std::string& sql) {
  return horopter::Execute(handle_.get(), sql);
}

absl::Status SqliteDatabase::RunInTransaction(const Body& body) {
  return horopter::RunInTransaction(handle_.get(), body);
}

absl::Status SqliteDatabase::RunFreeing(const Body& body) {
  const absl::Status status = RunInTransaction(body);
  if (!absl::IsResourceExhausted(status) || reserve_ == nullptr) return status;
  if (!reserve_->Release()) return status;
  const absl::Status again = RunInTransaction(body);
  if (reserve_->HasRoomForLog()) (void)QueryInt(handle_.get(), "PRAGMA wal_checkpoint(RESTART)");
  reserve_->TakeBack();
  return again;
}

absl::Status SqliteDatabase::ReadAtOneMoment(const Body& body) {
  HOROPTER_RETURN_IF_ERROR(Execute("BEGIN"));
  const absl::Status status = body();
  HOROPTER_RETURN_IF_ERROR(Execute("ROLLBACK"));
  return status;
}

absl::StatusOr<std::unique_ptr<Database>> SqliteDatabase::OpenReader() {
  if (InMemory()) return std::unique_ptr<Database>();
  HOROPTER_ASSIGN_OR_RETURN(SqliteHandle handle, OpenReadOnly(path_));
  return std::unique_ptr<Database>(new SqliteDatabase(path_, std::move(handle)));
}

absl::StatusOr<std::unique_ptr<Database>> SqliteDatabase::OpenSnapshot() {
  HOROPTER_ASSIGN_OR_RETURN(std::unique_ptr<Database> reader, OpenReader());
  if (reader == nullptr) return reader;
  // What is read from here on is of one moment.
  HOROPTER_RETURN_IF_ERROR(reader->Execute("BEGIN"));
  HOROPTER_RETURN_IF_ERROR(QueryInt(reader.get(), "SELECT count(*) FROM sqlite_schema").status());
  return reader;
}

std::shared_ptr<const void> SqliteDatabase::Interruptible(const StopRequested& stop) {
  return std::make_shared<horopter::Interruptible>(handle_.get(), stop);
}

absl::Status SqliteDatabase::CheckStorage(std::vector<std::string>* problems) {
  SqliteStatement integrity(handle_.get(), "PRAGMA integrity_check(20)");
  while (true) {
    HOROPTER_ASSIGN_OR_RETURN(const bool row, integrity.Step());
    if (!row) break;
    if (integrity.Bytes(0) != "ok") problems->push_back(integrity.Text(0));
  }
  SqliteStatement keys(handle_.get(), "PRAGMA foreign_key_check");
  while (true) {
    HOROPTER_ASSIGN_OR_RETURN(const bool row, keys.Step());
    if (!row) return absl::OkStatus();
    problems->push_back(absl::StrCat("table ", keys.Text(0), " refers to a missing row"));
  }
}

absl::Status SqliteDatabase::CopyToFile(const std::string& path, const StopRequested& stop) {
  return horopter::CopyToFile(handle_.get(), path, stop);
}

absl::Status SqliteDatabase::ReplaceBy(Database* other, const Body& after) {
  auto* const file = dynamic_cast<SqliteDatabase*>(other);
  if (file == nullptr) return absl::InternalError("only a file can replace a file");
  HOROPTER_RETURN_IF_ERROR(CopyPages(file->handle_.get(), handle_.get(), {}));
  return RunInTransaction([&]() -> absl::Status {
    HOROPTER_RETURN_IF_ERROR(after());
    return Execute("UPDATE file_state SET closed = 0");
  });
}

}  // namespace horopter
