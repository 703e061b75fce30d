// Wire <-> domain of stations.
#pragma once

#include <string>
#include <vector>

#include "absl/status/statusor.h"
#include "server/service/station_store.h"

namespace horopter::v1 {
class CameraCalibration;
class Station;
class StationCamera;
class StationReport;
}  // namespace horopter::v1

namespace horopter {

void StationToProto(const StationRecord& record,
                    const std::vector<StationEventRecord>& events,
                    v1::Station* proto);

// Empty (default) where nothing is known of the camera yet.
void CalibrationToProto(const StationState& state, int camera, v1::CameraCalibration* proto);

// Errors: INVALID_ARGUMENT naming the field.
absl::StatusOr<KnownLens> LensFromCalibration(const v1::CameraCalibration& proto,
                                              const std::string& field);

// Where people say that the camera is in the base. Errors: INVALID_ARGUMENT naming the field.
absl::StatusOr<CameraBase> BaseFromProto(const v1::StationCamera& proto, const std::string& field);

void StationReportToProto(const StationStart& start,
                          const StationOutcome& outcome,
                          bool learnt,
                          v1::StationReport* proto);

}  // namespace horopter
