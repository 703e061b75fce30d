// What is printed on an object.
#include <nlohmann/json.hpp>

#include "absl/strings/str_cat.h"
#include "client/commands.h"
#include "client/convert.h"
#include "client/output.h"
#include "client/recording.h"
#include "server/base/status_macros.h"

namespace horopter {

absl::Status ObjectLearnPrint(HoropterClient& client,
                              const std::string& id,
                              const std::vector<std::string>& recordings,
                              bool remove,
                              const std::string& if_match) {
  if (remove) {
    HOROPTER_ASSIGN_OR_RETURN(const v1::Object now, client.RemovePrint(id, if_match));
    Say("%s has no print; that is revision %lld\n",
        id.c_str(),
        static_cast<long long>(now.revision()));
    SayJson({{"id", id}, {"revision", now.revision()}, {"places", 0}, {"views", 0}});
    return absl::OkStatus();
  }
  v1::LearnPrintRequest request;
  request.set_name(ResourceName(id));
  request.set_if_match(if_match);
  for (const std::string& path : recordings) {
    HOROPTER_ASSIGN_OR_RETURN(Recorded recorded, ReadRecording(path));
    if (!recorded.response)
      return absl::InvalidArgumentError(absl::StrCat(path, ": the request was not answered"));
    v1::AnsweredScene& scene = *request.add_scenes();
    *scene.mutable_request() = std::move(recorded.request);
    *scene.mutable_response() = *std::move(recorded.response);
  }
  HOROPTER_ASSIGN_OR_RETURN(const v1::Object now, client.LearnPrint(request));
  Say("%s: print of %d places from %d views; that is revision %lld\n",
      id.c_str(),
      now.print().place_count(),
      now.print().view_count(),
      static_cast<long long>(now.revision()));
  SayJson({{"id", id},
           {"revision", now.revision()},
           {"places", now.print().place_count()},
           {"views", now.print().view_count()}});
  return absl::OkStatus();
}

}  // namespace horopter
