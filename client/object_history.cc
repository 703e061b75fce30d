// What objects were, and going back to it.
#include <google/protobuf/util/time_util.h>

#include <algorithm>
#include <nlohmann/json.hpp>

#include "absl/strings/str_cat.h"
#include "absl/strings/str_join.h"
#include "client/commands.h"
#include "client/output.h"
#include "server/base/status_macros.h"

namespace horopter {
namespace {

constexpr char kGeometry[] = "mesh";  // stands for all fields of geometry, which change together

std::vector<std::string> Changes(const v1::ObjectVersion& version) {
  std::vector<std::string> changes;
  for (const std::string& path : version.changed_fields().paths()) {
    if (path == kGeometry) {
      changes.emplace_back("geometry");
    } else if (path == "object_from_symmetric_object") {
      changes.emplace_back("symmetries");
    } else if (path != "diameter_m" && path != "vertices_m" && path != "edges") {
      changes.push_back(path);
    }
  }
  return changes;
}

}  // namespace

absl::Status ObjectHistory(HoropterClient& client, const std::string& id) {
  HOROPTER_ASSIGN_OR_RETURN(const v1::ListObjectVersionsResponse history,
                            client.ListObjectVersions(id));
  Say("%10s  %-24s %-16s %-24s %7s  %s\n", "revision", "since", "by", "name", "grasps", "changed");
  nlohmann::json list = nlohmann::json::array();
  for (const v1::ObjectVersion& version : history.versions()) {
    const v1::Object& o = version.object();
    const std::string time = google::protobuf::util::TimeUtil::ToString(o.update_time());
    const std::vector<std::string> changes = Changes(version);
    Say("%10lld  %-24s %-16s %-24s %7d  %s\n",
        static_cast<long long>(o.revision()),
        time.c_str(),
        version.changed_by().empty() ? "-" : version.changed_by().c_str(),
        o.display_name().c_str(),
        o.grasps_size(),
        changes.empty() ? "-" : absl::StrJoin(changes, ", ").c_str());
    list.push_back({{"revision", o.revision()},
                    {"update_time", time},
                    {"changed_by", version.changed_by()},
                    {"name", o.display_name()},
                    {"grasps", o.grasps_size()},
                    {"changed", changes}});
  }
  SayJson({{"id", id}, {"versions", list}});
  return absl::OkStatus();
}

absl::Status ObjectRestore(HoropterClient& client,
                           const std::string& id,
                           int64_t revision,
                           const std::string& if_match) {
  std::string etag = if_match;
  if (revision == 0) {
    HOROPTER_ASSIGN_OR_RETURN(const v1::ListObjectVersionsResponse history,
                              client.ListObjectVersions(id));
    if (history.versions_size() < 2) {
      return absl::NotFoundError(absl::StrCat("object '", id, "' has no former version"));
    }
    revision = history.versions(1).object().revision();
    // Of what was looked at: a change that comes in between is not undone unseen.
    if (etag.empty()) etag = history.versions(0).object().etag();
  }
  HOROPTER_ASSIGN_OR_RETURN(const v1::Object now, client.RestoreObject(id, revision, etag));
  Say("%s is what it was at revision %lld; that is revision %lld now\n",
      id.c_str(),
      static_cast<long long>(revision),
      static_cast<long long>(now.revision()));
  SayJson({{"id", id}, {"verb", "restored"}, {"revision", now.revision()}});
  return absl::OkStatus();
}

}  // namespace horopter
