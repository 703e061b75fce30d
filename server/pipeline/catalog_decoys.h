// What need not be in the catalog to be taken for one of its parts.
#pragma once

#include <vector>

#include "server/vision/recognition/object/untold_decoys.h"

namespace horopter {

std::vector<UntoldDecoy> UntoldDecoysOf(const ObjectModel& model);

}  // namespace horopter
