// Copies of the catalog that clients are reading, so that a broken-off backup can be read on.
#pragma once

#include <cstdint>
#include <deque>
#include <memory>
#include <mutex>
#include <string>

#include "absl/status/statusor.h"
#include "db/catalog.h"
#include "server/base/stop_token.h"

namespace horopter {

// One copy as of one moment: an open file without a name, so that nothing is left over, whatever
// happens. Read from any thread.
class BackupCopy {
 public:
  BackupCopy(int file, std::string id) : file_(file), id_(std::move(id)) {}
  ~BackupCopy();
  BackupCopy(const BackupCopy&) = delete;
  BackupCopy& operator=(const BackupCopy&) = delete;

  const std::string& id() const { return id_; }
  int64_t bytes() const { return bytes_; }
  const std::string& sha256() const { return sha256_; }

  // At most `most` bytes from there; fewer only at the end. Errors: INTERNAL.
  absl::StatusOr<std::string> Read(int64_t offset, size_t most) const;
  // Reads size and fingerprint. Errors: CANCELLED, INTERNAL.
  absl::Status Measure(const StopRequested& stop);

 private:
  const int file_;
  const std::string id_;
  int64_t bytes_ = 0;
  std::string sha256_;
};

// Thread-safe.
class BackupShelf {
 public:
  // Copies the catalog. Errors: those of Catalog::Backup.
  absl::StatusOr<std::shared_ptr<const BackupCopy>> Make(Catalog& catalog,
                                                         const StopRequested& stop);
  // Errors: NOT_FOUND.
  absl::StatusOr<std::shared_ptr<const BackupCopy>> Find(const std::string& id) const;
  // Keeps it for reading on; of more than two the oldest goes.
  void Keep(std::shared_ptr<const BackupCopy> copy);
  // It was read to its end.
  void Forget(const std::string& id);

 private:
  mutable std::mutex mutex_;
  std::deque<std::shared_ptr<const BackupCopy>> copies_;  // guarded by mutex_, oldest first
};

// A path for a file beside the catalog's, or for a catalog that is no file among temporary files.
// What: one of those that RemoveLeftovers knows.
std::string BesideCatalog(const Catalog& catalog, const std::string& what);

// Removes what a server that was killed left beside its catalog: copies that were being made or
// restored, CAD files that were being read. Only who has the catalog open may call it; each is told
// in the log.
void RemoveLeftovers(const Catalog& catalog);

}  // namespace horopter
