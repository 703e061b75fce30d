#include "server/pipeline/catalog_decoys.h"

#include "server/base/status_macros.h"

namespace horopter {

absl::StatusOr<std::vector<UntoldDecoy>> UntoldDecoysOf(const CatalogSnapshot& catalog, int index) {
  HOROPTER_ASSIGN_OR_RETURN(const auto object, ObjectAt(catalog, index));
  return FindUntoldDecoys(*object);
}

}  // namespace horopter
