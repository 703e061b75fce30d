// Binary glTF 2.0 (GLB): positions, faces, base colours.
#pragma once

#include <string_view>

#include "absl/status/statusor.h"
#include "client/mesh_file.h"

namespace horopter {

// The triangles of the default scene, moved by their nodes; usual_unit is "m", as the norm has it.
// Lines and points are left out and told; textures, skins and morph targets are not looked at.
// Errors: INVALID_ARGUMENT (no GLB of version 2, cut short, an index or a range that does not fit,
// compressed or sparse geometry, buffers in other files, no triangles).
absl::StatusOr<MeshFile> ParseGlb(std::string_view bytes);

}  // namespace horopter
