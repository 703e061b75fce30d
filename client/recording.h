// A recorded request as the program reads it.
#pragma once

#include <optional>
#include <string>

#include "absl/status/statusor.h"
#include "horopter/v1/recognition.pb.h"

namespace horopter {

struct Recorded {
  v1::RecognizeSceneRequest request;
  std::optional<v1::RecognizeSceneResponse> response;  // empty: it failed
  std::string code, server_version;
};

// Errors: NOT_FOUND, INVALID_ARGUMENT (no recording, damaged), each naming the file.
absl::StatusOr<Recorded> ReadRecording(const std::string& path);

}  // namespace horopter
