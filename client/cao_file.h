// ViSP's CAO model files ("V1"): points, lines, faces, cylinders, circles.
#pragma once

#include <string>

#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "server/vision/geometry/object_model.h"

namespace horopter {

// Faces (from lines and from points) and cylinders as a triangle soup in metres. Lines and circles
// alone bound no surface and are left out. Errors: NOT_FOUND, INVALID_ARGUMENT (names file and what
// is wrong: counts, indices, numbers, `load`, which would read other files, or no faces).
absl::StatusOr<TriangleMesh> ReadCao(const std::string& path, double metres_per_unit);

// The mesh as polygons: each plane region without holes is one face, others are their triangles.
// Metres, as ViSP has it. Errors: FAILED_PRECONDITION (cannot be written).
absl::Status WriteCao(const std::string& path, const ObjectModel& model);

}  // namespace horopter
