// The marker in a catalog file that says whether it was closed (ADR 73); internal to db/.
#pragma once

#include <string>

#include "absl/status/status.h"
#include "db/sqlite.h"

namespace horopter {

// Whether SQLite's log lies beside the file. To be asked before the file is opened.
bool LogIsThere(const std::string& path);

// Errors: DATA_LOSS naming the file: a server had it open when it was copied and its log is not
// beside it, or it does not hold as many objects as it should. Files from before the marker, and
// new ones, are fine. accept_unclosed: the first of these is none.
absl::Status CheckFileState(sqlite3* db,
                            const std::string& path,
                            bool log_was_there,
                            bool accept_unclosed);

// In the file itself, not in its log alone. A full disk is no error: the file then stays marked as
// it was.
absl::Status MarkOpen(sqlite3* db);

// For the last who has the file open. Does nothing to files from before the marker.
void MarkClosed(sqlite3* db);

}  // namespace horopter
