#include "server/service/derived_cache.h"

#include <fcntl.h>
#include <spdlog/spdlog.h>
#include <sys/stat.h>
#include <unistd.h>

#include <algorithm>
#include <cerrno>
#include <cstring>
#include <filesystem>
#include <utility>
#include <vector>

#include "absl/strings/str_cat.h"
#include "server/base/checked_blob.h"
#include "server/base/sha256.h"
#include "server/base/status_macros.h"

namespace horopter {
namespace {

namespace fs = std::filesystem;

constexpr std::string_view kMagic = "HDCE";
constexpr std::uint32_t kLayout = 1;
constexpr std::size_t kDigestBytes = 64;
// After making room so much of it is used: one scan of the folder is for many entries.
constexpr double kUsedAfter = 0.9;

absl::Status Failed(const std::string& path, const char* what, int error) {
  const std::string text = absl::StrCat(path, ": ", what, ": ", std::strerror(error));
  if (error == ENOENT) return absl::NotFoundError(text);
  if (error == ENOSPC || error == EDQUOT || error == EFBIG)
    return absl::ResourceExhaustedError(text);
  return absl::UnavailableError(text);
}

class CacheFile {
 public:
  explicit CacheFile(int fd) : fd_(fd) {}
  ~CacheFile() {
    if (fd_ >= 0) ::close(fd_);
  }
  CacheFile(const CacheFile&) = delete;
  CacheFile& operator=(const CacheFile&) = delete;
  int get() const { return fd_; }

 private:
  const int fd_;
};

std::string DigestOfEntry(const std::string& address, std::string_view entry) {
  Sha256 sha;
  sha.Add(address);
  sha.Add(entry);
  return sha.Hex();
}

std::string EncodeEntry(const DerivedData& data) {
  std::string out(kMagic);
  AppendNumber(out, kLayout);
  AppendNumber(out, static_cast<std::int32_t>(data.version));
  AppendNumber(out, std::uint32_t{0});
  AppendNumber(out, static_cast<std::uint64_t>(data.data.size()));
  AppendNumber(out, static_cast<std::uint64_t>(data.keys.size()));
  out += data.data;
  out += data.keys;
  out += DigestOfEntry(data.address, out);
  return out;
}

// Errors: DATA_LOSS.
absl::StatusOr<DerivedData> DecodeEntry(const std::string& address, std::string_view bytes) {
  if (bytes.size() < kDigestBytes) return absl::DataLossError("cut short");
  const std::string_view body = bytes.substr(0, bytes.size() - kDigestBytes);
  if (DigestOfEntry(address, body) != bytes.substr(body.size()))
    return absl::DataLossError("wrong digest");
  BlobReader reader(body);
  const bool ours = reader.TakeBytes(kMagic.size()) == kMagic;
  const auto layout = reader.Take<std::uint32_t>();
  DerivedData data;
  data.version = reader.Take<std::int32_t>();
  data.address = address;
  reader.Take<std::uint32_t>();
  const auto of_data = reader.Take<std::uint64_t>(), of_keys = reader.Take<std::uint64_t>();
  data.data = std::string(reader.TakeBytes(of_data));
  data.keys = std::string(reader.TakeBytes(of_keys));
  if (!ours || layout != kLayout || !reader.ok() || reader.left() > 0)
    return absl::DataLossError("not an entry of this layout");
  return data;
}

}  // namespace

bool IsDerivedAddress(const std::string& text) {
  return text.size() == 64 && std::all_of(text.begin(), text.end(), [](char c) {
           return (c >= '0' && c <= '9') || (c >= 'a' && c <= 'f');
         });
}

absl::StatusOr<std::string> ReadWholeFile(const std::string& path) {
  const CacheFile file(::open(path.c_str(), O_RDONLY | O_CLOEXEC));
  if (file.get() < 0) return Failed(path, "open", errno);
  struct stat status = {};
  if (::fstat(file.get(), &status) != 0) return Failed(path, "stat", errno);
  std::string bytes(static_cast<std::size_t>(status.st_size), '\0');
  for (std::size_t at = 0; at < bytes.size();) {
    const ssize_t n = ::read(file.get(), bytes.data() + at, bytes.size() - at);
    if (n < 0 && errno == EINTR) continue;
    if (n < 0) return Failed(path, "read", errno);
    if (n == 0) bytes.resize(at);  // cut while it was read
    at += static_cast<std::size_t>(n);
  }
  return bytes;
}

absl::Status WriteWholeFile(const std::string& path, std::string_view bytes) {
  std::error_code error;
  fs::create_directories(fs::path(path).parent_path(), error);
  if (error) return Failed(path, "make folder", error.value());
  static std::atomic<int> number = 0;
  const std::string unnamed = absl::StrCat(path, ".", ::getpid(), ".", ++number, ".unfinished");
  const auto write = [&]() -> absl::Status {
    const CacheFile file(::open(
        unnamed.c_str(), O_WRONLY | O_CREAT | O_TRUNC | O_CLOEXEC, S_IRUSR | S_IWUSR | S_IRGRP));
    if (file.get() < 0) return Failed(path, "create", errno);
    while (!bytes.empty()) {
      const ssize_t n = ::write(file.get(), bytes.data(), bytes.size());
      if (n < 0 && errno == EINTR) continue;
      if (n < 0) return Failed(path, "write", errno);
      bytes.remove_prefix(static_cast<std::size_t>(n));
    }
    return absl::OkStatus();
  };
  absl::Status written = write();
  // Not synced: what a power failure leaves is found by its digest.
  if (written.ok() && ::rename(unnamed.c_str(), path.c_str()) != 0)
    written = Failed(path, "rename", errno);
  if (!written.ok()) ::unlink(unnamed.c_str());
  return written;
}

void QuarantineFile(const std::string& folder, const std::string& path, const absl::Status& why) {
  const fs::path cage = fs::path(folder) / "quarantine";
  std::error_code ignored;
  fs::create_directories(cage, ignored);
  int kept = 0;
  for (auto at = fs::directory_iterator(cage, ignored); at != fs::directory_iterator(); ++at)
    ++kept;
  const fs::path to = cage / fs::path(path).filename();
  const bool moved = kept < kKeptInQuarantine && ::rename(path.c_str(), to.string().c_str()) == 0;
  if (!moved) ::unlink(path.c_str());
  spdlog::error("{} is damaged and {}: {}",
                path,
                moved ? "was put into quarantine" : "was removed",
                std::string(why.message()));
}

DerivedCache::DerivedCache(std::string folder, int64_t max_bytes)
    : folder_(std::move(folder)), max_bytes_(max_bytes) {}

std::string DerivedCache::PathOf(const std::string& address) const {
  return absl::StrCat(folder_, "/", address.substr(0, 2), "/", address);
}

std::optional<DerivedData> DerivedCache::Get(const std::string& address) {
  if (!IsDerivedAddress(address)) return std::nullopt;
  const std::string path = PathOf(address);
  absl::StatusOr<std::string> bytes = ReadWholeFile(path);
  if (!bytes.ok()) {
    ++misses_;
    return std::nullopt;
  }
  absl::StatusOr<DerivedData> data = DecodeEntry(address, *bytes);
  if (!data.ok()) {
    Quarantine(address, data.status());
    ++misses_;
    return std::nullopt;
  }
  ++hits_;
  // The time of its last use.
  ::utimensat(AT_FDCWD, path.c_str(), nullptr, 0);
  return *std::move(data);
}

void DerivedCache::Put(const DerivedData& data) {
  if (!IsDerivedAddress(data.address) || data.data.empty()) return;
  const std::string entry = EncodeEntry(data);
  const auto size = static_cast<int64_t>(entry.size());
  const std::lock_guard lock(mutex_);
  if (size > max_bytes_) return;
  MakeRoom(size);
  const absl::Status written = WriteWholeFile(PathOf(data.address), entry);
  if (written.ok()) {
    bytes_ += size;
    return;
  }
  if (unwritten_++ == 0) {
    spdlog::warn("derived data cannot be kept in the cache, they are read from the catalog: {}",
                 std::string(written.message()));
  }
}

void DerivedCache::Quarantine(const std::string& address, const absl::Status& why) {
  if (!IsDerivedAddress(address)) return;
  ++quarantined_;
  QuarantineFile(folder_, PathOf(address), why);
}

DerivedCacheFigures DerivedCache::figures() const {
  return {hits_, misses_, quarantined_, unwritten_};
}

void DerivedCache::MakeRoom(int64_t for_bytes) {
  if (bytes_ >= 0 && bytes_ + for_bytes <= max_bytes_) return;
  struct Entry {
    fs::file_time_type used;
    int64_t bytes;
    fs::path path;
  };
  std::vector<Entry> entries;
  bytes_ = 0;
  std::error_code error;
  for (auto bin = fs::directory_iterator(folder_, error); bin != fs::directory_iterator();
       bin.increment(error)) {
    if (bin->path().filename().string().size() != 2) continue;
    std::error_code of_bin;
    for (auto at = fs::directory_iterator(bin->path(), of_bin); at != fs::directory_iterator();
         at.increment(of_bin)) {
      std::error_code gone;  // another server may be at work on it
      Entry entry{at->last_write_time(gone), static_cast<int64_t>(at->file_size(gone)), at->path()};
      if (gone) continue;
      bytes_ += entry.bytes;
      entries.push_back(std::move(entry));
    }
  }
  if (bytes_ + for_bytes <= max_bytes_) return;
  std::sort(entries.begin(), entries.end(), [](const Entry& a, const Entry& b) {
    return a.used < b.used;
  });
  const auto wanted = static_cast<int64_t>(kUsedAfter * static_cast<double>(max_bytes_));
  for (const Entry& entry : entries) {
    if (bytes_ + for_bytes <= wanted) break;
    std::error_code ignored;
    fs::remove(entry.path, ignored);
    bytes_ -= entry.bytes;
  }
}

}  // namespace horopter
