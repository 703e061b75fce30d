// A station as it is stored.
#pragma once

#include <cstdint>
#include <map>
#include <string>
#include <vector>

#include "server/vision/geometry/camera_base.h"
#include "server/vision/geometry/station_state.h"

namespace horopter {

struct StationRecord {
  std::string id;
  std::string display_name;
  std::string create_time;  // RFC 3339, UTC
  std::string update_time;
  std::int64_t revision = 0;
  std::string agreed_request_id;  // the last request that agreed with what was known; empty: none
  std::string agreed_time;
  std::map<std::string, CameraBase> bases;  // by camera id
  StationState state;
};

// kind: StationEvent.Kind of the wire.
struct StationEventRecord {
  int kind = 0;
  std::string time;
  std::string request_id;
  std::vector<std::string> camera_ids;
  std::string detail;
};

inline constexpr int kKeptStationEvents = 200;  // of a station

}  // namespace horopter
