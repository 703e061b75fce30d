// What every write of an object has in common.
#pragma once

#include <string>

#include "absl/status/status.h"
#include "db/catalog_record.h"
#include "server/service/unary_call.h"

namespace horopter::v1 {
class Object;
}

namespace horopter {

// Who writes, and when.
void Sign(const CallInfo& info, CatalogRecord* record);

// Errors: ABORTED (if_match is given and not what `current` has).
absl::Status CheckEtag(const std::string& if_match, const CatalogRecord& current);

// The answer to a write: what is about to be written, ready for recognition.
void ReadyToProto(const CatalogRecord& written, v1::Object* proto);

}  // namespace horopter
