// Opens the catalog's SQLite file, refuses what is not ours and brings the schema up to date;
// internal to db/.
#pragma once

#include <string>
#include <vector>

#include "absl/status/statusor.h"
#include "db/sqlite.h"

namespace horopter {

// "HORO" in ASCII; stored in the file's header, so that foreign databases are told apart.
inline constexpr int kCatalogApplicationId = 0x484F524F;

// Opens `path` (":memory:" allowed) with the given migrations; element i brings user_version i to i
// + 1; a file of an older version is copied first, to PATH.schema-VERSION.bak. The process is the
// one that writes to the file until the handle is closed. Nothing is written to a file that is
// refused. Errors, each naming the file: UNAVAILABLE (locked), PERMISSION_DENIED
// (read-only), FAILED_PRECONDITION (cannot be opened, not a database, not a catalog, from a newer
// version), DATA_LOSS (fails its integrity check, or see CheckFileState), INTERNAL (a migration
// failed; rolled back).
absl::StatusOr<SqliteHandle> OpenDatabase(const std::string& path,
                                          int busy_timeout_ms,
                                          const std::vector<std::string>& migrations,
                                          bool accept_unclosed = false);

// A second connection to a file that OpenDatabase has open, for reading. Errors: as OpenDatabase.
absl::StatusOr<SqliteHandle> OpenReadOnly(const std::string& path);

}  // namespace horopter
