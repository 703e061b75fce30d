// Mesh files as the world writes them: positions and faces, every one of them or an error.
#pragma once

#include <cstdint>
#include <string>
#include <string_view>
#include <vector>

#include "absl/status/statusor.h"
#include "server/vision/geometry/object_model.h"

namespace horopter {

// What a file holds, in its own unit.
struct MeshFile {
  TriangleMesh mesh;               // vertices that no face uses are among it
  std::int64_t faces = 0;          // of the file, each of them in the mesh but for flat ones
  std::vector<std::string> notes;  // what is odd, and what was left out
  std::string unit;                // mm, m, in ...: the file's word; empty: it has none
  std::string usual_unit = "mm";   // of its format, where the file has no word
};

// Reads an OBJ, STL, PLY, GLB or 3MF file by its extension. Every face of the file is in the mesh.
// Errors: NOT_FOUND, INVALID_ARGUMENT naming the file and what is wrong where (cut short, a face
// that names no vertex, a vertex of a face without finite coordinates, what is not read).
absl::StatusOr<MeshFile> ReadMeshFile(const std::string& path);

// The whole file as it is. Errors: NOT_FOUND (cannot be opened), RESOURCE_EXHAUSTED (over 2 GB).
absl::StatusOr<std::string> ReadBytes(const std::string& path);

// INVALID_ARGUMENT with the first corner of a triangle that is not finite.
absl::Status CheckCorners(const TriangleMesh& mesh);

}  // namespace horopter
