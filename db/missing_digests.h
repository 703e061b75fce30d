// Digests and addresses that a catalog of an older schema lacks; internal to db/.
#pragma once

#include <string>

#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "db/catalog_record.h"
#include "db/database.h"

namespace horopter {

// The one object of that id, its digest not compared. Errors: NOT_FOUND, DATA_LOSS (damaged blob).
absl::StatusOr<CatalogRecord> ReadUnchecked(Database* db, const std::string& id);

// Digests of objects that were enrolled before there were any. What cannot be read gets none and
// stays damaged.
absl::Status FillDigests(Database* db);

// Addresses of what was derived before there were any. What cannot be read gets none.
absl::Status FillAddresses(Database* db);

}  // namespace horopter
