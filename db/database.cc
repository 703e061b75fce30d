#include "db/database.h"

#include "absl/strings/str_cat.h"
#include "server/base/status_macros.h"

namespace horopter {

Statement& Statement::Bind(int64_t value) {
  driver_->BindInt(next_++, value);
  return *this;
}

Statement& Statement::Bind(double value) {
  driver_->BindDouble(next_++, value);
  return *this;
}

Statement& Statement::Bind(std::string_view text) {
  driver_->BindText(next_++, text);
  return *this;
}

Statement& Statement::BindBlob(std::string_view bytes) {
  driver_->BindBlob(next_++, bytes);
  return *this;
}

Statement& Statement::BindNull() {
  driver_->BindNull(next_++);
  return *this;
}

absl::Status Statement::Run() {
  HOROPTER_RETURN_IF_ERROR(driver_->Run());
  driver_->Reset();
  next_ = 1;
  return absl::OkStatus();
}

absl::Status Execute(Database* db, const std::string& sql) {
  return db->Execute(sql);
}

absl::Status RunInTransaction(Database* db, const Database::Body& body) {
  return db->RunInTransaction(body);
}

absl::StatusOr<int64_t> QueryInt(Database* db, std::string_view sql) {
  Statement statement(db, sql);
  HOROPTER_ASSIGN_OR_RETURN(const bool row, statement.Step());
  if (!row) return absl::InternalError(absl::StrCat("no row: ", std::string(sql)));
  return statement.Int(0);
}

absl::StatusOr<std::string> QueryText(Database* db, std::string_view sql) {
  Statement statement(db, sql);
  HOROPTER_ASSIGN_OR_RETURN(const bool row, statement.Step());
  if (!row) return absl::InternalError(absl::StrCat("no row: ", std::string(sql)));
  return statement.Text(0);
}

}  // namespace horopter
