// PLY, as its header declares it.
#pragma once

#include <string_view>

#include "absl/status/statusor.h"
#include "client/mesh_file.h"

namespace horopter {

// Vertices and faces of a PLY file: elements and properties in any order and of any type, others
// between them passed by, text or bytes of either order, lines that end with LF, CR or both, text
// whose numbers stand on lines of their own. Faces are lists of vertex numbers, or strips. Colours
// of faces, else the mean of their corners'. A file without faces is a point cloud: its points
// without finite coordinates are left out and counted in the notes. Errors: INVALID_ARGUMENT (not
// PLY, cut short, more or less than the header declares, a face that names no vertex).
absl::StatusOr<MeshFile> ParsePly(std::string_view bytes);

}  // namespace horopter
