// A recorded request as bytes: what was asked, what was answered, and by which server.
//
// Layout, little endian: "HOROREC1"; three parts, each a 64-bit length and its bytes: `about`
// (JSON), request, response (serialized horopter.v1 messages); a 64-bit FNV-1a sum of all before
// it.
#pragma once

#include <string>
#include <string_view>

#include "absl/status/statusor.h"

namespace horopter {

struct RecordingFile {
  // Keys: request_id, time, server_version, settings, code, message, catalog_generation,
  // state.
  std::string about;
  std::string request;
  std::string response;  // empty: the request failed
};

inline constexpr char kRecordingExtension[] = ".horec";

std::string EncodeRecording(const RecordingFile& recording);

// Errors: INVALID_ARGUMENT (no recording, or of another version), DATA_LOSS (cut off or damaged).
absl::StatusOr<RecordingFile> DecodeRecording(std::string_view bytes);

}  // namespace horopter
