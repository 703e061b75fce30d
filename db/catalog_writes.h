// Which write of a catalog is which; internal to db/.
#pragma once

#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "db/catalog.h"
#include "db/database.h"

namespace horopter {

// Counts the write that this transaction is. With `rests_on` the last write before it has to be
// that one. Errors: one of IsOvertaken.
absl::StatusOr<WriteIdentity> CountGeneration(Database* db, RestsOn rests_on);

// The last write. Errors: one of IsOtherHistory: `seen` does not lead to it. A `seen` without a
// token leads to every write.
absl::StatusOr<WriteIdentity> LastWriteAfter(Database* db, const WriteIdentity& seen);

}  // namespace horopter
