// A station's state as bytes, for the database and for recordings.
//
// Byte layout behind the header of checked_blob.h (magic "HSTA", version 1, fingerprint 0),
// little-endian, no padding: i64 requests; u32 n; n cameras: u8 length of the id and its bytes, u8
// flags (1 moving, 2 zooming, 4 posed), i32 width, i32 height, f64 focal_px cx cy k1, f64 R row by
// row and t of camera_from_rig, i64 requests; then the lower triangle of the covariance row by row,
// f64.
#pragma once

#include <string>
#include <string_view>

#include "absl/status/statusor.h"
#include "server/vision/geometry/station_state.h"

namespace horopter {

inline constexpr int kMostStationCameras = 16;  // as many as a station may have

std::string EncodeStationState(const StationState& state);

// Errors: DATA_LOSS (cut off, damaged, numbers that no state has), FAILED_PRECONDITION (another
// version).
absl::StatusOr<StationState> DecodeStationState(std::string_view bytes);

// [a-z0-9_-]{1,63}
bool IsStationId(std::string_view id);

}  // namespace horopter
