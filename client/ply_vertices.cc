#include "client/ply_vertices.h"

#include "absl/strings/str_cat.h"
#include "client/mesh_file.h"
#include "client/ply_file.h"
#include "server/base/status_macros.h"

namespace horopter {

absl::StatusOr<std::vector<Eigen::Vector3d>> ReadPlyVertices(const std::string& path) {
  HOROPTER_ASSIGN_OR_RETURN(const std::string bytes, ReadBytes(path));
  absl::StatusOr<MeshFile> file = ParsePly(bytes);
  if (!file.ok()) {
    return absl::InvalidArgumentError(
        absl::StrCat(path, ": ", std::string(file.status().message())));
  }
  for (size_t i = 0; i < file->mesh.vertices.size(); ++i) {
    if (!file->mesh.vertices[i].allFinite()) {
      return absl::InvalidArgumentError(absl::StrCat(path, ": vertex ", i, " is not finite"));
    }
  }
  return std::move(file->mesh.vertices);
}

}  // namespace horopter
