#include "db/file_lock.h"

#include <fcntl.h>
#include <sys/file.h>
#include <unistd.h>

#include <cerrno>
#include <cstring>
#include <filesystem>

#include "absl/strings/str_cat.h"

namespace horopter {

absl::StatusOr<std::shared_ptr<const FileLock>> FileLock::Take(const std::string& path,
                                                               int timeout_ms) {
  // Whoever comes by a symbolic link finds the same lock.
  std::error_code error;
  const std::filesystem::path real = std::filesystem::weakly_canonical(path, error);
  const std::string name = (error ? path : real.string()) + ".lock";
  const int file = open(name.c_str(), O_RDWR | O_CREAT | O_CLOEXEC, 0600);
  if (file < 0) {
    const std::string message = absl::StrCat(name, ": ", std::strerror(errno));
    return errno == EACCES || errno == EROFS ? absl::PermissionDeniedError(message)
                                             : absl::FailedPreconditionError(message);
  }
  std::shared_ptr<const FileLock> lock(new FileLock(file));
  constexpr int kStepMs = 10;
  for (int waited = 0; flock(file, LOCK_EX | LOCK_NB) != 0; waited += kStepMs) {
    if (waited >= timeout_ms) return absl::UnavailableError(absl::StrCat(name, " is locked"));
    usleep(1000 * kStepMs);
  }
  return lock;
}

FileLock::~FileLock() {
  close(file_);
}

}  // namespace horopter
