// The metric scene of a request whose cameras are a station's: adjusted by the images alone,
// tested, and, where both agree, adjusted under what is known of the station.
#pragma once

#include "server/vision/euclidean/euclidean.h"
#include "server/vision/station/station_filter.h"

namespace horopter {

struct StationScene {
  MetricScene metric;  // under the prior when it was used, else by the images alone
  StationTest test;    // of the images against the prior
  bool prior_used = false;
  CameraEvidence evidence;  // to learn from
};

// The prior stands when the evidence of a scene that is adjusted with no more than loose focal
// lengths agrees with it. Where it does not, it stands when the evidence of the scene that was
// adjusted under it does, and no edges were lost by it: the optimum of weak scenes is far from the
// truth. Then `test` is the latter. Where it does not stand the scene is the images' alone.
// input.hints: of the request alone, not drawn from the station.
// Errors: those of RefineMetricScene, INVALID_ARGUMENT (views: one per image).
absl::StatusOr<StationScene> RefineUnderStation(const RecognitionInput& input,
                                                const RecognitionResult& recognition,
                                                const StationState& state,
                                                const StationViews& views,
                                                const StationOptions& station,
                                                EuclideanOptions options,
                                                const StopRequested& stop = {});

}  // namespace horopter
