// Byte layout of what an object was before a write. All numbers little-endian, no padding; texts
// after their length as u32; rigid transforms as R row by row, then t, f64.
//
// Details                               Geometry
//   0  4  magic "HVER"                    0  4  magic "HGEO"
//   4  2  version, 1                      4  2  version, 1
//   6  2  zero                            6  2  zero
//   8     display name, create time       8     diameter, f64, metres
//         diameter, f64, metres                 u32 n, n x vertex (x, y, z as f64)
//         vertices, edges, triangles: i64       u32 n, n x edge: kind, start and end vertex as
//         u32 n, n x symmetry                   i32, dihedral as f64, polyline as in blob.h as
//         u32 n, n x grasp: name,               a text
//         object_from_gripper, opening,         mesh as in blob.h as a text
//         width, quality as f64, u8 1 and
//         object_from_pregrasp, or u8 0
//         u32 n, n x label: key, value
//         CAD file: name, format, unit,
//         SHA-256; size as i64
//         layout 2: the print as in blob.h as a text
#pragma once

#include <string>
#include <string_view>

#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "db/catalog_record.h"

namespace horopter {

std::string EncodeDetails(const ObjectSummary& summary);
std::string EncodeGeometry(const ObjectModel& model);

// The id is for the caller to fill in, as times, revision and writer. Errors: DATA_LOSS.
absl::StatusOr<ObjectSummary> DecodeDetails(std::string_view blob);
// Fills vertices, edges, mesh and diameter. Errors: DATA_LOSS.
absl::Status DecodeGeometry(std::string_view blob, ObjectModel* model);

}  // namespace horopter
