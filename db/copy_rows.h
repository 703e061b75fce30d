// Copies of a catalog row by row, from one kind of database to another; internal to db/.
#pragma once

#include <functional>
#include <string>
#include <vector>

#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "db/copy_report.h"
#include "db/database.h"
#include "server/base/stop_token.h"

namespace horopter {

// A table that belongs to the catalog's content, the same in every database. Parents come first.
struct CatalogTable {
  std::string name;
  std::string key;         // columns that order its rows
  bool of_object = false;  // has rows of single objects, in object_id
};
const std::vector<CatalogTable>& CatalogTables();

// SHA-256 over all rows of all of these, equal for equal content whatever database it lies in: of
// each table its name and the SHA-256 of its values in the order of its key, each as a letter of
// its kind and its bytes (numbers as i64 and f64 little-endian, -0 as 0, texts and blobs after
// their length). Errors: also CANCELLED.
absl::StatusOr<std::string> DigestOfRows(Database* db, const StopRequested& stop = {});

// Replaces all rows of `to` by those of `from`. Inside a transaction of `to`.
absl::Status ReplaceRows(Database* from, Database* to, const StopRequested& stop = {});

// The same by transactions of some objects each, so that what was broken off is taken up where it
// ended: objects whose rows are the same already are left alone. `to` is empty, or was begun to be
// filled, which its generation says: it is kUnfinishedCopy until the last row is there and the
// digests agree. Errors: also ALREADY_EXISTS (`to` holds something else), DATA_LOSS (the digests
// differ), CANCELLED.
inline constexpr int64_t kUnfinishedCopy = -1;
absl::StatusOr<CopyReport> FillCatalog(Database* from,
                                       Database* to,
                                       const StopRequested& stop = {},
                                       const CopyProgress& progress = {});

// All rows as a new SQLite file (Database::CopyToFile).
absl::Status CopyRowsToFile(Database* from, const std::string& path, const StopRequested& stop);

}  // namespace horopter
