#include <google/protobuf/util/message_differencer.h>

#include <nlohmann/json.hpp>
#include <optional>

#include "absl/strings/str_cat.h"
#include "client/commands.h"
#include "client/interrupt.h"
#include "client/output.h"
#include "client/progress.h"
#include "client/recording.h"
#include "server/base/status_macros.h"

namespace horopter {
namespace {

// Without what differs from call to call.
v1::RecognizeSceneResponse Lasting(v1::RecognizeSceneResponse response) {
  response.clear_stages();
  response.clear_request_id();
  response.clear_catalog_generation();
  return response;
}

// Empty: the same.
std::string Difference(const Recorded& recorded,
                       const absl::StatusOr<v1::RecognizeSceneResponse>& now) {
  const std::string code = absl::StatusCodeToString(now.status().code());
  if (code != recorded.code) return absl::StrCat(recorded.code, " became ", code, "\n");
  if (!now.ok()) return "";
  const v1::RecognizeSceneResponse before = Lasting(*recorded.response), after = Lasting(*now);
  if (before.SerializeAsString() == after.SerializeAsString()) return "";
  std::string text;
  google::protobuf::util::MessageDifferencer differencer;
  differencer.ReportDifferencesToString(&text);
  // Equal by value but not by bits, e.g. -0 and 0.
  if (differencer.Compare(before, after)) text = "the same values in other bits\n";
  return text;
}

}  // namespace

absl::Status Replay(HoropterClient& client, const std::vector<std::string>& files) {
  int different = 0;
  HOROPTER_ASSIGN_OR_RETURN(const v1::ServerInfo server, client.GetServerInfo());
  Progress progress("replay", static_cast<int64_t>(files.size()));
  for (size_t i = 0; i < files.size(); ++i) {
    HOROPTER_ASSIGN_OR_RETURN(const Recorded recorded, ReadRecording(files[i]));
    const auto response = client.RecognizeScene(recorded.request);
    if (Interrupted()) return absl::CancelledError("interrupted");
    if (absl::IsUnavailable(response.status())) return response.status();
    const std::string difference = Difference(recorded, response);
    progress.Clear();
    if (!difference.empty()) {
      ++different;
      Say("%s: differs\n%s", files[i].c_str(), difference.c_str());
      if (recorded.server_version != server.version()) {
        Say("  it was recorded by version %s, this server is version %s\n",
            recorded.server_version.c_str(),
            server.version().c_str());
      }
    }
    SayJson({{"file", files[i]},
             {"same", difference.empty()},
             {"difference", difference},
             {"recorded_version", recorded.server_version},
             {"server_version", server.version()}});
    progress.Update(static_cast<int64_t>(i) + 1);
  }
  progress.Clear();
  Say("%zu recordings, %d answers differ\n", files.size(), different);
  if (different == 0) return absl::OkStatus();
  return absl::AbortedError(
      absl::StrCat(different, " of ", files.size(), " answers differ from the recorded ones"));
}

}  // namespace horopter
