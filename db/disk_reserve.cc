#include "db/disk_reserve.h"

#include <fcntl.h>
#include <sys/stat.h>
#include <sys/statvfs.h>
#include <unistd.h>

#include <algorithm>
#include <cstdint>
#include <filesystem>

namespace horopter {
namespace {

// The log up to SQLite's own checkpoint (4 MiB) and the pages of a removal.
constexpr int64_t kMostBytes = int64_t{8} << 20;
constexpr int64_t kLeastBytes = int64_t{64} << 10;
// Of what is free: others want to write as well.
constexpr int64_t kShare = 4;

int64_t FreeBytes(const std::string& path) {
  const std::string folder = std::filesystem::path(path).parent_path().string();
  struct statvfs disk {};
  if (::statvfs(folder.empty() ? "." : folder.c_str(), &disk) != 0) return 0;
  return static_cast<int64_t>(disk.f_bavail) * static_cast<int64_t>(disk.f_frsize);
}

int64_t FileBytes(const std::string& path) {
  struct stat file {};
  return ::stat(path.c_str(), &file) == 0 ? int64_t{file.st_size} : 0;
}

// Its blocks may be fewer than its size where somebody has copied it.
bool IsWhole(const std::string& path) {
  struct stat file {};
  return ::stat(path.c_str(), &file) == 0 && file.st_size >= kLeastBytes &&
         int64_t{file.st_blocks} * 512 >= file.st_size;
}

}  // namespace

DiskReserve::DiskReserve(const std::string& database)
    : database_(database), path_(database + "-reserve") {
  held_ = IsWhole(path_);  // left by a server that was killed, or by a full disk
  if (held_) {
    bytes_ = FileBytes(path_);
  } else {
    ::unlink(path_.c_str());
    Take(FreeBytes(path_) / kShare);
  }
}

DiskReserve::~DiskReserve() {
  if (FreeBytes(path_) > kShare * kMostBytes) Release();
}

bool DiskReserve::Release() {
  if (!held_) return false;
  held_ = false;
  return ::unlink(path_.c_str()) == 0;
}

void DiskReserve::TakeBack() {
  if (!held_) Take(std::min(bytes_, FreeBytes(path_)));
}

bool DiskReserve::HasRoomForLog() const {
  return FreeBytes(path_) > FileBytes(database_ + "-wal");
}

void DiskReserve::Take(int64_t bytes) {
  bytes = std::min(bytes, kMostBytes);
  if (bytes < kLeastBytes) return;
  const int file = ::open(path_.c_str(), O_CREAT | O_EXCL | O_WRONLY | O_CLOEXEC, 0600);
  if (file < 0) return;
  held_ = ::posix_fallocate(file, 0, bytes) == 0;
  ::close(file);
  if (held_) {
    bytes_ = bytes;
  } else {
    ::unlink(path_.c_str());
  }
}

}  // namespace horopter
