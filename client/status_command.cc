#include <chrono>
#include <nlohmann/json.hpp>

#include "client/commands.h"
#include "client/output.h"
#include "server/base/status_macros.h"

namespace horopter {

absl::Status ServerStatus(HoropterClient& client) {
  const auto start = std::chrono::steady_clock::now();
  HOROPTER_ASSIGN_OR_RETURN(const bool serving, client.CheckHealth());
  const double ms =
      std::chrono::duration<double, std::milli>(std::chrono::steady_clock::now() - start).count();
  nlohmann::json json = {{"server", client.address()}, {"serving", serving}, {"round_trip_ms", ms}};
  Say("server      %s\nhealth      %s, %.1f ms\n",
      client.address().c_str(),
      serving ? "serving" : "stopping",
      ms);
  if (serving) {
    HOROPTER_ASSIGN_OR_RETURN(const std::vector<v1::Object> objects, client.ListObjects());
    size_t with_grasps = 0;
    for (const v1::Object& o : objects) with_grasps += o.grasps_size() > 0 ? 1 : 0;
    Say("catalog     %zu objects, %zu with grasps\n", objects.size(), with_grasps);
    json["objects"] = objects.size();
    json["objects_with_grasps"] = with_grasps;
  }
  SayJson(json);
  return serving ? absl::OkStatus() : absl::UnavailableError("the server is stopping");
}

}  // namespace horopter
