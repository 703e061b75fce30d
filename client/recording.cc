#include "client/recording.h"

#include <nlohmann/json.hpp>

#include "absl/strings/str_cat.h"
#include "client/commands.h"
#include "server/base/recording_file.h"
#include "server/base/status_macros.h"

namespace horopter {

absl::StatusOr<Recorded> ReadRecording(const std::string& path) {
  HOROPTER_ASSIGN_OR_RETURN(const std::string bytes, ReadFileBytes(path));
  const absl::StatusOr<RecordingFile> file = DecodeRecording(bytes);
  if (!file.ok()) {
    return absl::InvalidArgumentError(
        absl::StrCat(path, ": ", std::string(file.status().message())));
  }
  Recorded recorded;
  const auto about = nlohmann::json::parse(file->about, nullptr, false);
  bool readable = about.is_object() && recorded.request.ParseFromString(file->request);
  if (readable) {
    recorded.code = about.value("code", "");
    recorded.server_version = about.value("server_version", "");
    if (recorded.code == "OK") {
      readable = recorded.response.emplace().ParseFromString(file->response);
    }
  }
  if (!readable) return absl::InvalidArgumentError(absl::StrCat(path, ": cannot be read"));
  return recorded;
}

}  // namespace horopter
