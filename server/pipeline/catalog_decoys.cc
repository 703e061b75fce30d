#include "server/pipeline/catalog_decoys.h"

namespace horopter {

std::vector<UntoldDecoy> UntoldDecoysOf(const ObjectModel& model) {
  return FindUntoldDecoys(model);
}

}  // namespace horopter
