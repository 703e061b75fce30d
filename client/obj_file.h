// Wavefront OBJ: positions, faces and the colours of materials and vertices.
#pragma once

#include <functional>
#include <string>
#include <string_view>

#include "absl/status/statusor.h"
#include "client/mesh_file.h"

namespace horopter {

// The text of a material file by the name that the OBJ file gives it, or nothing where it cannot be
// had.
using ReadMaterialFile = std::function<std::string(const std::string& name)>;

// Vertices (the fourth number, a weight of free-form curves, does not move them; six and more carry
// a colour) and polygons by the first number of each corner, from the start or (negative) back from
// the last vertex so far. Lines may be continued by a backslash, comments may stand anywhere and
// end with their line. Texture, normals, lines and points are left out. Errors: INVALID_ARGUMENT
// with the line (no number, a corner that names no vertex, free-form surfaces, no faces).
absl::StatusOr<MeshFile> ParseObj(std::string_view text, const ReadMaterialFile& read_material);

}  // namespace horopter
