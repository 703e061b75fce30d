// 3MF: an archive of XML models.
#pragma once

#include <string_view>

#include "absl/status/statusor.h"
#include "client/mesh_file.h"

namespace horopter {

// The objects that are to be built, each where it is placed, with their components, in the unit
// that the file names (else mm, as the norm has it); objects of support are left out and told.
// Colours are not read. Errors: INVALID_ARGUMENT (no archive, damaged, an object or vertex that is
// not there, no triangles), RESOURCE_EXHAUSTED (over 1 GB unpacked).
absl::StatusOr<MeshFile> ParseThreeMf(std::string_view bytes);

}  // namespace horopter
