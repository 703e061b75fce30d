// One owner of a file at a time; internal to db/.
#pragma once

#include <memory>
#include <string>

#include "absl/status/statusor.h"

namespace horopter {

// A lock on PATH.lock, kept by this process until the object goes; the system takes it back when
// the process dies. Not on the file itself: SQLite's own locks on it go when any descriptor of it
// is closed.
class FileLock {
 public:
  // Waits at most `timeout_ms`. Errors: UNAVAILABLE (somebody else has it), PERMISSION_DENIED and
  // FAILED_PRECONDITION (the file cannot be made).
  static absl::StatusOr<std::shared_ptr<const FileLock>> Take(const std::string& path,
                                                              int timeout_ms);
  ~FileLock();
  FileLock(const FileLock&) = delete;
  FileLock& operator=(const FileLock&) = delete;

 private:
  explicit FileLock(int file) : file_(file) {}
  const int file_;
};

}  // namespace horopter
