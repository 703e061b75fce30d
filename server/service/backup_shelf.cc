#include "server/service/backup_shelf.h"

#include <fcntl.h>
#include <spdlog/spdlog.h>
#include <unistd.h>

#include <algorithm>
#include <atomic>
#include <filesystem>
#include <random>
#include <regex>

#include "absl/strings/str_cat.h"
#include "absl/strings/str_format.h"
#include "server/base/sha256.h"
#include "server/base/status_macros.h"

namespace horopter {
namespace {

constexpr size_t kMostCopies = 2;
constexpr size_t kHashedAtOnce = size_t{1} << 20;

std::string NewId() {
  std::random_device random;
  return absl::StrFormat("%08x%08x", random(), random());
}

}  // namespace

BackupCopy::~BackupCopy() {
  close(file_);
}

absl::StatusOr<std::string> BackupCopy::Read(int64_t offset, size_t most) const {
  std::string chunk(most, '\0');
  size_t have = 0;
  while (have < most) {
    const ssize_t got =
        pread(file_, chunk.data() + have, most - have, offset + static_cast<int64_t>(have));
    if (got < 0) return absl::InternalError("the backup cannot be read");
    if (got == 0) break;
    have += static_cast<size_t>(got);
  }
  chunk.resize(have);
  return chunk;
}

absl::Status BackupCopy::Measure(const StopRequested& stop) {
  Sha256 sha;
  for (int64_t offset = 0;;) {
    HOROPTER_ASSIGN_OR_RETURN(const std::string piece, Read(offset, kHashedAtOnce));
    if (piece.empty()) break;
    sha.Add(piece);
    offset += static_cast<int64_t>(piece.size());
    bytes_ = offset;
    if (IsStopRequested(stop)) return absl::CancelledError("stopped");
  }
  sha256_ = sha.Hex();
  return absl::OkStatus();
}

absl::StatusOr<std::shared_ptr<const BackupCopy>> BackupShelf::Make(Catalog& catalog,
                                                                    const StopRequested& stop) {
  const std::string path = BesideCatalog(catalog, "backup");
  HOROPTER_RETURN_IF_ERROR(catalog.Backup(path, stop));
  const int file = open(path.c_str(), O_RDONLY | O_CLOEXEC);
  std::error_code error;
  std::filesystem::remove(path, error);
  if (file < 0) return absl::InternalError("the backup cannot be read");
  const auto copy = std::make_shared<BackupCopy>(file, NewId());
  HOROPTER_RETURN_IF_ERROR(copy->Measure(stop));
  return copy;
}

absl::StatusOr<std::shared_ptr<const BackupCopy>> BackupShelf::Find(const std::string& id) const {
  const std::lock_guard lock(mutex_);
  for (const auto& copy : copies_) {
    if (copy->id() == id) return copy;
  }
  return absl::NotFoundError("backup_id: the server has no such backup any more; begin again");
}

void BackupShelf::Keep(std::shared_ptr<const BackupCopy> copy) {
  const std::lock_guard lock(mutex_);
  if (std::find(copies_.begin(), copies_.end(), copy) != copies_.end()) return;
  copies_.push_back(std::move(copy));
  if (copies_.size() > kMostCopies) copies_.pop_front();
}

void BackupShelf::Forget(const std::string& id) {
  const std::lock_guard lock(mutex_);
  copies_.erase(
      std::remove_if(
          copies_.begin(), copies_.end(), [&](const auto& copy) { return copy->id() == id; }),
      copies_.end());
}

std::string BesideCatalog(const Catalog& catalog, const std::string& what) {
  static std::atomic<int> next{0};
  const std::string beside = catalog.path() == ":memory:" || catalog.IsShared()
                                 ? (std::filesystem::temp_directory_path() / "horopter").string()
                                 : catalog.path();
  return absl::StrCat(beside, ".", getpid(), ".", next++, ".", what);
}

void RemoveLeftovers(const Catalog& catalog) {
  namespace fs = std::filesystem;
  if (catalog.path() == ":memory:" || catalog.IsShared()) return;
  // Those of BesideCatalog, and copies that CopyToFile had not given their name yet.
  static const std::regex leftover(
      R"((\.\d+\.\d+\.(backup|restore|import)(\.\d+\.unfinished(-\w+)?)?)|)"
      R"((\.(before-restore|schema-\d+)(-\d+)?\.bak\.\d+\.unfinished(-\w+)?))");
  const fs::path path(catalog.path());
  const std::string name = path.filename().string();
  const fs::path folder = path.has_parent_path() ? path.parent_path() : fs::path(".");
  std::error_code error;
  for (const fs::directory_entry& entry : fs::directory_iterator(folder, error)) {
    const std::string found = entry.path().filename().string();
    if (found.compare(0, name.size(), name) != 0) continue;
    if (!std::regex_match(found.substr(name.size()), leftover)) continue;
    std::error_code failed;
    fs::remove_all(entry.path(), failed);
    if (failed) {
      spdlog::warn("{} was left over when the server was killed, and cannot be removed: {}",
                   entry.path().string(),
                   failed.message());
    } else {
      spdlog::info("{} was left over when the server was killed, and is removed",
                   entry.path().string());
    }
  }
}

}  // namespace horopter
