// Stations as the service uses them: from the catalog's file to requests, and what they learnt
// back.
#pragma once

#include <string>
#include <vector>

#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "db/catalog.h"
#include "server/pipeline/scene.h"

namespace horopter {

// "stations/{id}" <-> id, and "stations/{id}/cameras/{camera}". Errors: INVALID_ARGUMENT naming
// `field`.
std::string StationName(const std::string& id);
std::string StationCameraName(const std::string& id, const std::string& camera);
absl::StatusOr<std::string> StationIdFromName(const std::string& name, const std::string& field);
struct StationCameraId {
  std::string station;
  std::string camera;
};
absl::StatusOr<StationCameraId> StationCameraFromName(const std::string& name,
                                                      const std::string& field);

// Changes with every write.
std::string EtagOf(const StationRecord& record);

// RFC 3339, UTC.
std::string StationTime();

// The station of a request as it begins.
struct StationStart {
  std::string id;
  StationRequest request;
  std::string state;                 // as bytes, for a recording
  std::vector<std::string> resized;  // cameras whose images have another size than before
  std::string agreed_request_id, agreed_time;
  bool learns = true;  // false: the request brought its state, or only uses what is known
};

// What a request of a station brings with it.
struct StationUse {
  std::string state;  // empty: the stored one
  // One per image.
  std::vector<std::string> camera_ids;
  // Nothing is learnt: the request says so, or its caller may not teach.
  bool read_only = false;
};

// Errors: NOT_FOUND, INVALID_ARGUMENT (a camera id, one of a camera that stands still for two
// images, more than 16 cameras, a state that is none), each naming its field; those of
// Catalog::GetStation.
absl::StatusOr<StationStart> BeginStation(Catalog& catalog,
                                          const std::string& id,
                                          const StationUse& use,
                                          const std::vector<cv::Mat>& images);

// Adds what the request says to the state that is stored now: other requests may have taught it
// meanwhile, so that the evidence is tested again. False: nothing was learnt (nothing was
// recognised, the cameras are swapped, the station is gone). Errors: those of
// Catalog::WriteStation.
absl::StatusOr<bool> TeachStation(Catalog& catalog,
                                  const StationStart& start,
                                  const StationOutcome& outcome,
                                  const std::string& request_id);

// Text of a change, for people.
std::string DescribeChange(const StationState& state, const StationChange& change);
std::string DescribeBaseChange(const BaseChange& change);
// StationEvent.Kind and StationFinding.Kind of a change, which have the same numbers.
int KindOf(const StationChange& change);

}  // namespace horopter
