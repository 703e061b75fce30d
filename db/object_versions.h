// What objects were before their writes; internal to db/. Callers open the transaction.
#pragma once

#include <string>
#include <vector>

#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "db/catalog.h"
#include "db/catalog_record.h"
#include "db/database.h"

namespace horopter {

// An object before a write, with what the write may change.
struct FormerState {
  ObjectSummary summary;
  std::string geometry;  // as version_blob.h has it; empty: the write leaves it
  std::string cad_file;
};

// Errors: NOT_FOUND, DATA_LOSS.
absl::StatusOr<FormerState> ReadState(Database* db,
                                      const std::string& id,
                                      const UpdateParts& parts);

// After the write: keeps what was, unless the write changed nothing, and lets the oldest go that
// are beyond kKeptVersions and most_bytes.
absl::Status KeepVersion(Database* db,
                         const FormerState& former,
                         const UpdateParts& parts,
                         int64_t most_bytes);

// Newest first, what the object is before them. Errors: NOT_FOUND, DATA_LOSS.
absl::StatusOr<std::vector<ObjectVersion>> ReadVersions(Database* db, const std::string& id);

// With geometry and the bytes of its CAD file. Errors: NOT_FOUND, DATA_LOSS.
absl::StatusOr<CatalogRecord> ReadVersion(Database* db, const std::string& id, int64_t revision);

// Of all versions of an object: what is damaged, in words.
std::vector<std::string> CheckVersions(Database* db, const std::string& id);

}  // namespace horopter
