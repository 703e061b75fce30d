#include "server/service/recorder.h"

#include <google/protobuf/message.h>
#include <unistd.h>

#include <algorithm>
#include <chrono>
#include <filesystem>
#include <fstream>
#include <nlohmann/json.hpp>
#include <system_error>
#include <vector>

#include "absl/strings/str_cat.h"
#include "absl/strings/str_format.h"
#include "server/base/recording_file.h"

namespace horopter {
namespace {

namespace fs = std::filesystem;

// A file that is younger by more than that was written before the clock was set back.
constexpr auto kClocksDiffer = std::chrono::minutes(1);

struct Kept {
  fs::path path;
  fs::file_time_type time;
  int64_t bytes = 0;
};

// Those of the future come before all others: the clock was set back since, and they would drive
// out what is newer.
std::vector<Kept> OldestFirst(const fs::path& folder) {
  std::vector<Kept> kept;
  std::error_code error;
  for (fs::directory_iterator it(folder, error), end; !error && it != end; it.increment(error)) {
    std::error_code gone;
    if (it->path().extension() != kRecordingExtension) continue;
    const auto time = it->last_write_time(gone);
    const auto bytes = static_cast<int64_t>(it->file_size(gone));
    if (!gone) kept.push_back({it->path(), time, bytes});
  }
  const auto future = fs::file_time_type::clock::now() + kClocksDiffer;
  std::sort(kept.begin(), kept.end(), [&](const Kept& a, const Kept& b) {
    const bool a_is_past = a.time <= future, b_is_past = b.time <= future;
    return std::tie(a_is_past, a.time, a.path) < std::tie(b_is_past, b.time, b.path);
  });
  return kept;
}

std::string AboutOf(const RequestRecord& record,
                    const std::string& version,
                    const std::string& settings) {
  const nlohmann::json about = {
      {"request_id", record.request_id},
      {"time", std::chrono::duration<double>(record.arrival.time_since_epoch()).count()},
      {"server_version", version},
      {"settings", settings},
      {"code", absl::StatusCodeToString(record.status.code())},
      {"message", std::string(record.status.message())},
      {"state", record.state},
      {"catalog_generation", record.catalog_generation}};
  return about.dump(-1, ' ', false, nlohmann::json::error_handler_t::replace);
}

}  // namespace

Recorder::Recorder(const RecorderOptions& options, std::string version, std::string settings)
    : options_(options),
      version_(std::move(version)),
      settings_(std::move(settings)),
      opened_(fs::file_time_type::clock::now()),
      opened_steady_(std::chrono::steady_clock::now()),
      random_(std::random_device{}()) {}

absl::StatusOr<std::unique_ptr<Recorder>> Recorder::Open(const RecorderOptions& options,
                                                         const std::string& server_version,
                                                         const std::string& settings) {
  if (!(options.sample >= 0.0 && options.sample <= 1.0)) {
    return absl::InvalidArgumentError("record sample: must be 0 to 1");
  }
  if (options.max_mb < 1 || !(options.max_age_hours > 0.0)) {
    return absl::InvalidArgumentError("record size and age: must be positive");
  }
  std::error_code error;
  fs::create_directories(options.folder, error);
  if (!fs::is_directory(options.folder, error) || ::access(options.folder.c_str(), W_OK) != 0) {
    return absl::PermissionDeniedError(absl::StrCat(options.folder, ": cannot be written"));
  }
  return std::unique_ptr<Recorder>(new Recorder(options, server_version, settings));
}

bool Recorder::Wanted(const RequestRecord& record) {
  if (record.request == nullptr || record.busy || absl::IsUnavailable(record.status)) {
    return false;
  }
  const bool failed = !record.status.ok() || record.objects == 0;
  if (failed && options_.failed) return true;
  const std::lock_guard lock(mutex_);
  return static_cast<double>(random_() >> 11) * 0x1p-53 < options_.sample;
}

void Recorder::MakeRoom(int64_t room) {
  const std::vector<Kept> kept = OldestFirst(options_.folder);
  int64_t bytes = room;
  for (const Kept& k : kept) bytes += k.bytes;
  const auto by_steady_clock = opened_ + std::chrono::duration_cast<fs::file_time_type::duration>(
                                             std::chrono::steady_clock::now() - opened_steady_);
  const auto oldest = std::min(fs::file_time_type::clock::now(), by_steady_clock) -
                      std::chrono::duration_cast<fs::file_time_type::duration>(
                          std::chrono::duration<double, std::ratio<3600>>(options_.max_age_hours));
  for (const Kept& k : kept) {
    if (bytes <= options_.max_mb * 1'000'000 && k.time >= oldest) continue;
    std::error_code error;
    fs::remove(k.path, error);
    bytes -= k.bytes;
  }
}

Recorder::Outcome Recorder::Record(const RequestRecord& record) {
  if (!Wanted(record)) return Outcome::kNotWanted;
  RecordingFile recording;
  recording.about = AboutOf(record, version_, settings_);
  // Fields that follow a serialized message are merged into it when it is read.
  recording.request = record.request->SerializeAsString() + record.request_supplement;
  if (record.status.ok() && record.response != nullptr) {
    recording.response = record.response->SerializeAsString();
  }
  const std::string bytes = EncodeRecording(recording);
  if (static_cast<int64_t>(bytes.size()) > options_.max_mb * 1'000'000) return Outcome::kFailed;
  const auto ms =
      std::chrono::duration_cast<std::chrono::milliseconds>(record.arrival.time_since_epoch())
          .count();
  const fs::path path = fs::path(options_.folder) /
                        absl::StrFormat("%013d-%s%s", ms, record.request_id, kRecordingExtension);
  const fs::path unfinished = path.string() + ".unfinished";
  const std::lock_guard lock(mutex_);
  MakeRoom(static_cast<int64_t>(bytes.size()));
  std::error_code error;
  std::ofstream file(unfinished, std::ios::binary | std::ios::trunc);
  file.write(bytes.data(), static_cast<std::streamsize>(bytes.size()));
  file.close();
  if (file) fs::rename(unfinished, path, error);
  if (!file || error) {
    fs::remove(unfinished, error);
    return Outcome::kFailed;
  }
  return Outcome::kWritten;
}

}  // namespace horopter
