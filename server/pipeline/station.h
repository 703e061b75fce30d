// A request whose cameras are a station's: what is known of them for recognition, and what the
// request made of it (ADR 30).
#pragma once

#include <optional>
#include <string>
#include <vector>

#include "server/vision/station/base_filter.h"
#include "server/vision/station/station_adjustment.h"

namespace horopter {

struct SceneRequest;

struct StationRequest {
  StationState state;
  StationViews views;  // one per image
  // Per camera of the state: where it is in the robot's base frame, when that is known.
  std::vector<std::optional<CameraBase>> bases;
};

struct StationOutcome {
  StationTest test;
  bool prior_used = false;
  CameraEvidence evidence;  // to learn from; empty: nothing was recognised
  // By references in the robot's base frame, one per image; empty: none was seen.
  std::vector<std::optional<CameraBase>> bases_seen = {};
};

// Whether the test says that the images fit the cameras in another order.
bool IsSwapped(const StationTest& test);

// Whether the test says that the camera may have moved.
bool HasMoved(const StationTest& test, int camera);

// The request with what is known of its cameras as hints, for recognition: lenses where the caller
// says nothing of them, and places in the rig. The same request where nothing is known.
SceneRequest WithStationHints(const SceneRequest& request);

// The request with the cameras' places in the robot's base frame, where the caller says nothing of
// them: by their hand-eye calibrations and, for the others, through the rig. Cameras that the test
// says have moved are nowhere, and all are when it says that they are swapped.
SceneRequest WithStationBase(const SceneRequest& request, const StationTest& test);

// That references put the robot's base elsewhere than is known of the station's fixed cameras.
struct BaseChange {
  std::vector<int> cameras;  // of the state
  double turn_rad = 0.0;     // how far, of the first
  double shift_m = 0.0;
  bool given = false;  // people said where one of them is
};
std::optional<BaseChange> BaseMoved(const StationRequest& station,
                                    const StationOutcome& outcome,
                                    const StationOptions& options);

}  // namespace horopter
