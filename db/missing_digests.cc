#include "db/missing_digests.h"

#include <cstdint>
#include <memory>
#include <utility>
#include <vector>

#include "absl/strings/str_cat.h"
#include "db/object_digest.h"
#include "db/object_rows.h"
#include "server/base/status_macros.h"

namespace horopter {

absl::StatusOr<CatalogRecord> ReadUnchecked(Database* db, const std::string& id) {
  HOROPTER_ASSIGN_OR_RETURN(std::vector<ObjectSummary> found,
                            ReadSummaries(db, id, /*exactly=*/true, 1));
  if (found.empty()) {
    return absl::NotFoundError(absl::StrCat("object '", id, "' is not in the catalog"));
  }
  HOROPTER_RETURN_IF_ERROR(ReadGeometry(db, found.front().record.model));
  return std::move(found.front().record);
}

absl::Status FillDigests(Database* db) {
  std::vector<std::string> ids;
  Statement select(db, "SELECT object_id FROM object_digest WHERE sha256 = ''");
  while (true) {
    HOROPTER_ASSIGN_OR_RETURN(const bool row, select.Step());
    if (!row) break;
    ids.push_back(select.Text(0));
  }
  if (ids.empty()) return absl::OkStatus();
  return RunInTransaction(db, [&]() -> absl::Status {
    for (const std::string& id : ids) {
      const absl::StatusOr<CatalogRecord> record = ReadUnchecked(db, id);
      if (absl::IsDataLoss(record.status())) continue;
      HOROPTER_RETURN_IF_ERROR(record.status());
      HOROPTER_RETURN_IF_ERROR(WriteDigest(db, record->model));
    }
    return absl::OkStatus();
  });
}

absl::Status FillAddresses(Database* db) {
  constexpr int kAtOnce = 256;  // objects: a start that is broken off goes on there
  std::string after;
  while (true) {
    std::vector<std::pair<std::string, int>> without;
    Statement select(db,
                     "SELECT object_id, version FROM derived WHERE address = '' AND object_id > ? "
                     "ORDER BY object_id, version LIMIT ?");
    select.Bind(std::string_view(after)).Bind(int64_t{kAtOnce});
    while (true) {
      HOROPTER_ASSIGN_OR_RETURN(const bool row, select.Step());
      if (!row) break;
      without.emplace_back(select.Text(0), static_cast<int>(select.Int(1)));
    }
    if (without.empty()) return absl::OkStatus();
    after = without.back().first;
    const absl::Status filled = RunInTransaction(db, [&]() -> absl::Status {
      for (const auto& [id, version] : without) {
        const absl::StatusOr<CatalogRecord> record = ReadUnchecked(db, id);
        if (absl::IsDataLoss(record.status()) || absl::IsNotFound(record.status())) continue;
        HOROPTER_RETURN_IF_ERROR(record.status());
        Statement name(db, "UPDATE derived SET address = ? WHERE object_id = ? AND version = ?");
        const std::string address = DerivedAddress(record->model, version);
        name.Bind(std::string_view(address))
            .Bind(std::string_view(id))
            .Bind(static_cast<int64_t>(version));
        HOROPTER_RETURN_IF_ERROR(name.Run());
      }
      return absl::OkStatus();
    });
    HOROPTER_RETURN_IF_ERROR(filled);
  }
}

}  // namespace horopter
