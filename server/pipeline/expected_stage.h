// What became of the parts that a request expects.
#pragma once

#include "absl/status/status.h"
#include "server/pipeline/pipeline.h"

namespace horopter {

// Fills answer->expected; nothing to do for a request that expects none. Errors: those of reading
// an object of a catalog that is not in memory.
absl::Status TellExpected(const SceneRequest& request,
                          const CatalogSnapshot& catalog,
                          SceneAnswer* answer);

}  // namespace horopter
