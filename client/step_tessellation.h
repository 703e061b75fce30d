// Parts of STEP files that are triangles instead of surfaces.
#pragma once

#include <string>
#include <vector>

#include "absl/status/statusor.h"
#include "client/step_text.h"
#include "server/vision/geometry/object_model.h"

namespace horopter {

// Whether the file has tessellated faces at all.
bool HoldsTessellation(const StepText& step);

// All triangles of a file that places none of its parts, in its unit: triangulated faces and
// surface sets, complex ones (strips and fans) too. Errors: INVALID_ARGUMENT with the entity (a
// coordinate that is not there, parts that are placed, nothing).
absl::StatusOr<TriangleMesh> TessellationOf(const StepText& step);

}  // namespace horopter
