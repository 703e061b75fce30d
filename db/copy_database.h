// Copies of a whole database; internal to db/.
#pragma once

#include <string>

#include "absl/status/status.h"
#include "db/sqlite.h"
#include "server/base/stop_token.h"

namespace horopter {

// Lets a statement of the connection be stopped while it runs: it then ends with an error.
class Interruptible {
 public:
  // Both must outlive this.
  Interruptible(sqlite3* db, const StopRequested& stop);
  ~Interruptible();
  Interruptible(const Interruptible&) = delete;
  Interruptible& operator=(const Interruptible&) = delete;

 private:
  sqlite3* const db_;
};

// Copies all pages of one open database over those of another. Errors: CANCELLED, those of SQLite.
absl::Status CopyPages(sqlite3* from, sqlite3* to, const StopRequested& stop);

// Writes a copy to a new file: checked, synced and only then given its name; a failure leaves
// nothing behind. Errors: ALREADY_EXISTS (the file is there), PERMISSION_DENIED (its folder is
// read-only), CANCELLED.
absl::Status CopyToFile(sqlite3* from, const std::string& path, const StopRequested& stop);

// PATH.WHY.bak, or with a number before .bak when that is there.
std::string NewCopyName(const std::string& path, const std::string& why);

}  // namespace horopter
