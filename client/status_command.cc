#include <google/protobuf/util/time_util.h>

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
    HOROPTER_ASSIGN_OR_RETURN(const v1::ServerInfo info, client.GetServerInfo());
    const v1::ServerLimits& limits = info.limits();
    const v1::ServerLoad& load = info.load();
    constexpr double kMb = 1e6;
    Say("version     %s, since %s\n",
        info.version().c_str(),
        google::protobuf::util::TimeUtil::ToString(info.start_time()).c_str());
    Say("catalog     %d objects, generation %lld\n",
        info.object_count(),
        static_cast<long long>(info.catalog_generation()));
    if (info.unusable_object_count() > 0) {
      Say("            %d objects left out; horopter catalog verify says why\n",
          info.unusable_object_count());
    }
    if (info.pending_object_count() > 0) {
      Say("            %d objects are being prepared, and left out until then\n",
          info.pending_object_count());
    }
    Say("load        %d of %d scenes running, %d of %d waiting, %.0f of %.0f MB reserved\n",
        load.running(),
        limits.workers(),
        load.waiting(),
        limits.queue(),
        static_cast<double>(load.reserved_bytes()) / kMb,
        static_cast<double>(limits.memory_bytes()) / kMb);
    Say("limits      %d images, %.0f million pixels each, %.0f MB a request\n",
        limits.max_images(),
        static_cast<double>(limits.max_image_pixels()) / kMb,
        static_cast<double>(limits.max_recognize_bytes()) / kMb);
    json["version"] = info.version();
    json["objects"] = info.object_count();
    json["unusable_objects"] = info.unusable_object_count();
    json["pending_objects"] = info.pending_object_count();
    json["catalog_generation"] = info.catalog_generation();
    json["load"] = {{"running", load.running()},
                    {"waiting", load.waiting()},
                    {"reserved_bytes", load.reserved_bytes()}};
    json["limits"] = {{"workers", limits.workers()},
                      {"queue", limits.queue()},
                      {"memory_bytes", limits.memory_bytes()},
                      {"max_images", limits.max_images()},
                      {"max_image_pixels", limits.max_image_pixels()},
                      {"max_recognize_bytes", limits.max_recognize_bytes()}};
  }
  SayJson(json);
  return serving ? absl::OkStatus() : absl::UnavailableError("the server is stopping");
}

}  // namespace horopter
