// What must hold of whatever a reader makes of any bytes.
#pragma once

#include <cstdlib>
#include <string_view>

#include "absl/status/statusor.h"
#include "client/mesh_file.h"

namespace horopter {

inline void Require(bool holds) {
  if (!holds) std::abort();
}

// A mesh whose triangles name its vertices, which are finite; or an error of the caller's input
// with words.
inline void CheckMesh(const absl::StatusOr<MeshFile>& file) {
  if (!file.ok()) {
    Require(file.status().code() == absl::StatusCode::kInvalidArgument ||
            file.status().code() == absl::StatusCode::kResourceExhausted);
    Require(!file.status().message().empty());
    return;
  }
  const TriangleMesh& mesh = file->mesh;
  Require(!mesh.vertices.empty());
  Require(mesh.colors.empty() || mesh.colors.size() == mesh.triangles.size());
  for (const Eigen::Vector3i& t : mesh.triangles) {
    Require(t.minCoeff() >= 0 && t.maxCoeff() < static_cast<int>(mesh.vertices.size()));
  }
  Require(CheckCorners(mesh).ok());
}

}  // namespace horopter
