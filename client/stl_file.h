// STL, as text and as bytes.
#pragma once

#include <string_view>

#include "absl/status/statusor.h"
#include "client/mesh_file.h"

namespace horopter {

// Facets by their corners; normals are not looked at. Binary is what has the size of the facets its
// header counts, whatever the header's words; else text that holds facets is text (words in any
// case, names of any words, several solids, polygons). A count of 0 or 0xFFFFFFFF, as programs
// write that do not go back, gives way to what is there, and so do facets behind the counted ones;
// other bytes behind are read over and told. Colours as Materialise's programs write them. Errors:
// INVALID_ARGUMENT (cut short, a facet without three corners, no number, nothing of either kind).
absl::StatusOr<MeshFile> ParseStl(std::string_view bytes);

}  // namespace horopter
