#include "db/copy_database.h"

#include <fcntl.h>
#include <unistd.h>

#include <cerrno>
#include <cstring>
#include <filesystem>
#include <system_error>

#include "absl/strings/str_cat.h"
#include "db/file_state.h"
#include "server/base/status_macros.h"

namespace horopter {
namespace {

// Pages copied between two looks at the stop flag: 1 MiB.
constexpr int kPagesPerStep = 256;
// Steps of SQLite's machine between two looks: well below a millisecond.
constexpr int kMachineSteps = 2000;

absl::Status FileError(const std::string& path, std::string_view what, int error) {
  const std::string message =
      absl::StrCat("backup ", path, ": ", std::string(what), ": ", std::strerror(error));
  if (error == EEXIST) return absl::AlreadyExistsError(message);
  if (error == EACCES || error == EROFS) return absl::PermissionDeniedError(message);
  if (error == ENOSPC || error == EDQUOT) return absl::ResourceExhaustedError(message);
  return absl::FailedPreconditionError(message);
}

// Makes what was written, or a new name in a folder, survive a power cut.
absl::Status Sync(const std::string& path) {
  const int file = open(path.c_str(), O_RDONLY | O_CLOEXEC);
  if (file < 0) return FileError(path, "cannot be opened", errno);
  const int result = fsync(file), error = errno;
  close(file);
  return result == 0 ? absl::OkStatus() : FileError(path, "cannot be synced", error);
}

// Removes the unfinished copy, which link() has given its name by then if all went well.
class UnfinishedFile {
 public:
  explicit UnfinishedFile(std::string path) : path_(std::move(path)) {}
  ~UnfinishedFile() {
    std::error_code ignored;
    std::filesystem::remove(path_, ignored);
  }
  UnfinishedFile(const UnfinishedFile&) = delete;
  UnfinishedFile& operator=(const UnfinishedFile&) = delete;

 private:
  std::string path_;
};

}  // namespace

Interruptible::Interruptible(sqlite3* db, const StopRequested& stop) : db_(db) {
  if (!stop) return;
  sqlite3_progress_handler(
      db,
      kMachineSteps,
      [](void* flag) { return (*static_cast<const StopRequested*>(flag))() ? 1 : 0; },
      const_cast<StopRequested*>(&stop));
}

Interruptible::~Interruptible() {
  sqlite3_progress_handler(db_, 0, nullptr, nullptr);
}

absl::Status CopyPages(sqlite3* from, sqlite3* to, const StopRequested& stop) {
  sqlite3_backup* backup = sqlite3_backup_init(to, "main", from, "main");
  if (backup == nullptr) return SqliteError(to, "start the copy");
  int step = SQLITE_OK;
  bool stopped = false;
  while (step == SQLITE_OK && !stopped) {
    step = sqlite3_backup_step(backup, kPagesPerStep);
    stopped = IsStopRequested(stop);
  }
  sqlite3_backup_finish(backup);
  if (step == SQLITE_DONE) return absl::OkStatus();
  return stopped ? absl::CancelledError("stopped") : SqliteError(to, "write the copy");
}

absl::Status CopyToFile(sqlite3* from, const std::string& path, const StopRequested& stop) {
  std::error_code error;
  if (std::filesystem::exists(path, error)) return FileError(path, "is there already", EEXIST);
  const std::string unfinished = absl::StrCat(path, ".", getpid(), ".unfinished");
  // Ours alone from the start: a name that another backup uses is refused.
  const int made = open(unfinished.c_str(), O_CREAT | O_EXCL | O_WRONLY | O_CLOEXEC, 0600);
  if (made < 0) return FileError(path, "cannot be created", errno);
  close(made);
  const UnfinishedFile file(unfinished);

  sqlite3* raw = nullptr;
  const int opened = sqlite3_open_v2(
      unfinished.c_str(), &raw, SQLITE_OPEN_READWRITE | SQLITE_OPEN_NOMUTEX, nullptr);
  SqliteHandle copy(raw);
  if (opened != SQLITE_OK) return SqliteError(raw, "open the backup");
  HOROPTER_RETURN_IF_ERROR(CopyPages(from, raw, stop));
  // A copy is one file: without the log of the original.
  HOROPTER_RETURN_IF_ERROR(QueryText(raw, "PRAGMA journal_mode=DELETE").status());
  MarkClosed(raw);
  {
    const Interruptible interruptible(raw, stop);
    const absl::StatusOr<std::string> check = QueryText(raw, "PRAGMA quick_check(1)");
    if (IsStopRequested(stop)) return absl::CancelledError("stopped");
    HOROPTER_RETURN_IF_ERROR(check.status());
    if (*check != "ok") return absl::DataLossError(absl::StrCat("backup ", path, ": ", *check));
  }
  copy.reset();
  HOROPTER_RETURN_IF_ERROR(Sync(unfinished));
  // link() and not rename(): a file that has appeared meanwhile is not replaced.
  if (link(unfinished.c_str(), path.c_str()) != 0) {
    return FileError(path, "cannot be named", errno);
  }
  const std::string folder = std::filesystem::path(path).parent_path().string();
  return Sync(folder.empty() ? "." : folder);
}

std::string NewCopyName(const std::string& path, const std::string& why) {
  std::error_code error;
  std::string name = absl::StrCat(path, ".", why, ".bak");
  for (int i = 2; std::filesystem::exists(name, error); ++i) {
    name = absl::StrCat(path, ".", why, "-", i, ".bak");
  }
  return name;
}

}  // namespace horopter
