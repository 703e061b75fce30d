// What was derived of objects in a local folder, so that a server that shares its catalog reads it
// over the network once.
//
// FOLDER/ab/abcd...: one entry, named by its address (db/object_digest.h): "HDCE", u32 layout,
// u32 version, u32 zero, u64 bytes of the data, u64 bytes of the keys, then data and keys, then the
// SHA-256 of the address and all that, 64 hex digits. FOLDER/quarantine/: entries that were not
// what they should be, the first kKeptInQuarantine of them.
#pragma once

#include <atomic>
#include <cstdint>
#include <mutex>
#include <optional>
#include <string>

#include "absl/status/statusor.h"
#include "db/catalog_record.h"

namespace horopter {

inline constexpr int kKeptInQuarantine = 16;

// Whether a text may be the address of derived data: 64 lower-case hex digits. Nothing else becomes
// a file's name.
bool IsDerivedAddress(const std::string& text);

// The whole of a file, or none. Errors: NOT_FOUND, UNAVAILABLE (cannot be read).
absl::StatusOr<std::string> ReadWholeFile(const std::string& path);
// Writes beside it and gives it its name at once; several writers of one content do no harm.
// Errors: RESOURCE_EXHAUSTED (disk full), UNAVAILABLE (cannot be written).
absl::Status WriteWholeFile(const std::string& path, std::string_view bytes);
// Moves a file to FOLDER/quarantine while there is room, else removes it. `why`: for the log.
void QuarantineFile(const std::string& folder, const std::string& path, const absl::Status& why);

struct DerivedCacheFigures {
  int64_t hits = 0;
  int64_t misses = 0;
  int64_t quarantined = 0;  // damaged entries
  int64_t unwritten = 0;    // entries that could not be stored: disk full, folder read-only
};

// Nothing that is wrong with the folder is an error for a caller: what is not there is derived or
// read from the catalog as without a cache, and the log and the figures say so. Thread-safe;
// several servers may share a folder.
class DerivedCache {
 public:
  // max_bytes: of the entries together; those used least lately go.
  DerivedCache(std::string folder, int64_t max_bytes);

  // The entry with its address and version; checked.
  std::optional<DerivedData> Get(const std::string& address);
  // Of data with an address.
  void Put(const DerivedData& data);
  // An entry that passed the check and is of no use all the same.
  void Quarantine(const std::string& address, const absl::Status& why);

  DerivedCacheFigures figures() const;

 private:
  std::string PathOf(const std::string& address) const;
  // Removes what was used least lately. Needs mutex_.
  void MakeRoom(int64_t for_bytes);

  const std::string folder_;
  const int64_t max_bytes_;
  std::mutex mutex_;
  int64_t bytes_ = -1;  // guarded by mutex_: of all entries; negative: not counted yet
  std::atomic<int64_t> hits_ = 0, misses_ = 0, quarantined_ = 0, unwritten_ = 0;
};

}  // namespace horopter
