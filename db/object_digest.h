// Fingerprints of an object: of all that a robot uses of it, and of its shape.
#pragma once

#include <string>

#include "absl/status/status.h"
#include "db/database.h"
#include "server/vision/geometry/object_model.h"

namespace horopter {

// SHA-256 over, in this order: "HDIG" and version 1 as u32; the id; diameter; vertices; edges
// (kind, ends, dihedral, polyline as its blob); mesh as its blob; symmetries; grasps (name, pose,
// opening, width, quality, pre-grasp or a mark that there is none). Numbers little-endian (i64,
// f64, -0 as 0, which SQLite does not keep apart), lists and texts after their length as u64.
std::string DigestOf(const ObjectModel& model);

// SHA-256 of what is derived from: "HSHP" and version 1 as u32, then diameter to symmetries as
// above. No id: two objects of one shape have one digest.
std::string ShapeDigestOf(const ObjectModel& model);

// Under which what a version of the program derives of a shape is kept: SHA-256 of the shape's
// digest, a blank and the version in decimal digits.
std::string DerivedAddress(const ObjectModel& model, int version);

// Stores the digest of a model whose rows were written. Inside the caller's transaction.
absl::Status WriteDigest(Database* db, const ObjectModel& model);

// Errors: DATA_LOSS: the model that was read is not the one that was written.
absl::Status CheckDigest(Database* db, const ObjectModel& model);

}  // namespace horopter
