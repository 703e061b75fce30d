// A part's contour fragments as bytes, stored beside its aspects.
//
// Byte layout, little-endian, no padding: the header of checked_blob.h (magic "HFRG", fingerprint
// of the aspects they were drawn from), then u32 aspects, f32 edge length each, u32
// fragments, 26 bytes each, u32 pairs, 14 bytes each.
#pragma once

#include <cstdint>
#include <string>
#include <string_view>

#include "absl/status/statusor.h"
#include "server/vision/recognition/aspects/aspect_fragments.h"
#include "server/vision/recognition/aspects/aspect_set.h"

namespace horopter {

// To be raised with every change of what MakeModelFragments computes or of how it is written.
inline constexpr int kFragmentVersion = 4;

std::string EncodeModelFragments(const ModelFragments& fragments, const AspectSet& set);

// What MakeModelFragments(mesh, set) returned, bit for bit. Errors: FAILED_PRECONDITION
// (another version, other aspects), DATA_LOSS (damaged).
absl::StatusOr<ModelFragments> DecodeModelFragments(std::string_view blob, const AspectSet& set);

}  // namespace horopter
