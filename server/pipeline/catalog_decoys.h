// What need not be in the catalog to be taken for one of its parts.
#pragma once

#include <vector>

#include "absl/status/statusor.h"
#include "server/pipeline/pipeline.h"
#include "server/vision/recognition/object/untold_decoys.h"

namespace horopter {

// Of one object of the catalog. Errors: those of ObjectAt.
absl::StatusOr<std::vector<UntoldDecoy>> UntoldDecoysOf(const CatalogSnapshot& catalog, int index);

}  // namespace horopter
