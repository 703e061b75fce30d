// The vertices of a PLY file as they are written, before any welding.
#pragma once

#include <Eigen/Core>
#include <string>
#include <vector>

#include "absl/status/statusor.h"

namespace horopter {

// Vertices of a PLY file, in the file's unit, all finite. Errors: NOT_FOUND, INVALID_ARGUMENT
// naming the file (client/ply_file.h; not finite).
absl::StatusOr<std::vector<Eigen::Vector3d>> ReadPlyVertices(const std::string& path);

}  // namespace horopter
