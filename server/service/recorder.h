// Keeps requests with their answers as files, bounded by size and age.
#pragma once

#include <chrono>
#include <cstdint>
#include <memory>
#include <mutex>
#include <random>
#include <string>

#include "absl/status/statusor.h"
#include "server/service/request_record.h"

namespace horopter {

struct RecorderOptions {
  std::string folder;     // empty: nothing is recorded
  bool failed = true;     // requests that end with an error or without a recognised object
  double sample = 0.0;    // share of the others, 0..1; 1: all
  int64_t max_mb = 1024;  // oldest recordings go first; raising it keeps more
  double max_age_hours = 24.0 * 7;
};

// Files TIME-REQUEST_ID.horec (recording_file.h), written whole or not at all. Thread-safe. Calls
// that were refused before they were read (queue full, stopping) are not recorded.
class Recorder {
 public:
  enum class Outcome { kNotWanted, kWritten, kFailed };

  // Makes the folder. Errors: PERMISSION_DENIED, INVALID_ARGUMENT (options).
  static absl::StatusOr<std::unique_ptr<Recorder>> Open(const RecorderOptions& options,
                                                        const std::string& server_version,
                                                        const std::string& settings);

  Outcome Record(const RequestRecord& record);

 private:
  Recorder(const RecorderOptions& options, std::string version, std::string settings);
  bool Wanted(const RequestRecord& record);
  // Removes what is too old (a clock that is set makes nothing older), and the oldest until `room`
  // more bytes fit.
  void MakeRoom(int64_t room);

  const RecorderOptions options_;
  const std::string version_, settings_;
  // When it was opened, by both clocks.
  const std::chrono::file_clock::time_point opened_;
  const std::chrono::steady_clock::time_point opened_steady_;
  std::mutex mutex_;
  std::mt19937_64 random_;  // guarded by mutex_
};

}  // namespace horopter
