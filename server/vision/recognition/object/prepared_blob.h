// What is costly in a PreparedObject as bytes, so that a catalog of a thousand objects is ready in
// a second: resting poses, near symmetries, aspects and invariant keys. The samples follow from the
// model in microseconds and are recomputed.
//
// Byte layout, little-endian, no padding: the header of checked_blob.h (magic "HPRE", fingerprint
// of the model's geometry and of the options it was prepared with), then
//          resting poses: u32 count, then up (3 f64), height (f64), margin (f64), rolls (u8) each
//          near symmetries: u8 sphere, u32 count, then axis and point (3 f64 each), order (i32),
//          largest, mean, area share (f64 each), place (3 f64), size (f64) each
//          aspects: u32 bytes and the blob of aspect_blob.h, u32 bytes and that of fragment_blob.h;
//          both of no bytes when there are none; to the end
//
// The invariant keys are bytes of their own, which an index over a large catalog is made from: the
// same header with magic "HKEY", then as in server/vision/invariants/object_keys.h.
#pragma once

#include <memory>
#include <string>
#include <string_view>

#include "absl/status/statusor.h"
#include "server/vision/recognition/object/prepared_bytes.h"
#include "server/vision/recognition/object/prepared_object.h"

namespace horopter {

// To be raised with every change of what PrepareObject computes or how it is written: stored blobs
// of another version are recomputed.
inline constexpr int kPreparedVersion = 10;

PreparedBytes EncodePrepared(const PreparedObject& object, const PrepareOptions& options = {});

// The object that PrepareObject(model, options) returns, bit for bit. Errors: FAILED_PRECONDITION
// (the bytes are of another version, of another geometry or of other options), DATA_LOSS (damaged),
// INVALID_ARGUMENT as PrepareObject.
absl::StatusOr<std::shared_ptr<const PreparedObject>> RestorePrepared(
    ObjectModel model, const PreparedBytes& bytes, const PrepareOptions& options = {});

// The keys alone, without the geometry: whether they are of it is for the caller to know. Errors:
// FAILED_PRECONDITION (another version), DATA_LOSS.
absl::StatusOr<ObjectKeys> DecodePreparedKeys(std::string_view keys, int vertex_count);

}  // namespace horopter
