#include "db/catalog_writes.h"

#include "absl/strings/cord.h"
#include "absl/strings/str_cat.h"
#include "server/base/status_macros.h"

namespace horopter {
namespace {

constexpr char kOvertakenPayload[] = "horopter/overtaken";
constexpr char kOtherHistoryPayload[] = "horopter/other-history";

absl::Status Aborted(const std::string& message, const char* payload) {
  absl::Status status = absl::AbortedError(message);
  status.SetPayload(payload, absl::Cord("1"));
  return status;
}

}  // namespace

bool IsOvertaken(const absl::Status& status) {
  return status.GetPayload(kOvertakenPayload).has_value();
}

bool IsOtherHistory(const absl::Status& status) {
  return status.GetPayload(kOtherHistoryPayload).has_value();
}

absl::StatusOr<WriteIdentity> LastWriteAfter(Database* db, const WriteIdentity& seen) {
  Statement select(db,
                   "SELECT s.generation, w.token, (SELECT count(*) FROM catalog_write WHERE "
                   "generation = ? AND token = ?) FROM catalog_state s LEFT JOIN catalog_write w "
                   "ON w.generation = s.generation");
  select.Bind(seen.generation).Bind(std::string_view(seen.token));
  HOROPTER_ASSIGN_OR_RETURN(const bool row, select.Step());
  if (!row) return absl::DataLossError("the catalog has lost its generation");
  WriteIdentity last{select.Int(0), select.Text(1)};
  if (seen.token.empty() || select.Int(2) > 0) return last;
  return Aborted(absl::StrCat("the catalog, of generation ",
                              last.generation,
                              ", does not follow from what was generation ",
                              seen.generation,
                              " here: it was put back"),
                 kOtherHistoryPayload);
}

absl::StatusOr<WriteIdentity> CountGeneration(Database* db, RestsOn rests_on) {
  HOROPTER_RETURN_IF_ERROR(Execute(db, "UPDATE catalog_state SET generation = generation + 1"));
  const absl::StatusOr<WriteIdentity> written =
      LastWriteAfter(db, rests_on != nullptr ? *rests_on : WriteIdentity());
  const bool other = IsOtherHistory(written.status());
  if (!other && !written.ok()) return written;
  if (!other && (rests_on == nullptr || written->generation == rests_on->generation + 1))
    return written;
  return Aborted("another server wrote to the catalog meanwhile", kOvertakenPayload);
}

}  // namespace horopter
