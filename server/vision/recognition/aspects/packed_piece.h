// What ranks one part among very many: some views' first points and fragments, eight bits a value.
#pragma once

#include <array>
#include <cstdint>
#include <string>
#include <string_view>
#include <vector>

#include "absl/status/statusor.h"
#include "server/vision/recognition/aspects/fragment_index.h"

namespace horopter {

// A key in steps of 2 pi / 256, which wrap as angles do: 0.7 degrees at most from the angle, where
// keys that are alike differ by 10.
using BytePackedKey = std::array<std::int8_t, kFragmentAngles>;
BytePackedKey PackKeyInBytes(const FragmentKey& key);

// A view of a part. Places in steps of 1 / kPlaceScale diameters, saturated; directions in
// 1 / kBinSteps of a bin.
struct PackedView {
  static constexpr int kPlaceShift = 80;  // steps of FirstVotePoints::kPlaceScale: 1 / 205 diameter
  static constexpr int kBinSteps = 16;
  static constexpr float kLengthScale = 1024.0f;  // steps a diameter of the edges' length

  std::array<std::int8_t, kFirstVotePoints> x{}, y{};
  std::array<std::uint8_t, kFirstVotePoints> bin{};
  std::uint16_t edge_length = 0;

  friend bool operator==(const PackedView&, const PackedView&) = default;
};
FirstVotePoints UnpackFirstPoints(const PackedView& view);
std::array<VotePoint, kFirstVotePoints> UnpackPoints(const PackedView& view);
float EdgeLength(const PackedView& view);  // diameters

// A fragment of a view.
struct PackedFragment {
  BytePackedKey key{};
  std::int8_t x = 0, y = 0;  // centre, in steps of PackedView's
  std::uint8_t spread = 0;   // logarithmic, see SpreadOf
  std::int8_t turn = 0;      // 2 pi / 256
  std::uint16_t view = 0;    // of the piece

  friend bool operator==(const PackedFragment&, const PackedFragment&) = default;
};
// What a packed spread stands for, diameters: from 1 / 128 on, each step larger by 1.9 per cent.
float SpreadOf(std::uint8_t packed);
float PlaceOf(std::int8_t packed);  // diameters
const IndexedTurn& TurnOfByte(std::int8_t packed);

struct PackedPiece {
  std::vector<PackedView> views;
  std::vector<PackedFragment> fragments;

  friend bool operator==(const PackedPiece&, const PackedPiece&) = default;
};

// Of a piece that holds kFirstVotePoints points a view at least; views of fewer, and their
// fragments, are left out.
PackedPiece Pack(const FragmentPiece& piece);

// Byte layout, little-endian, no padding: the header of checked_blob.h (magic "HRKP", fingerprint
// 0), then u32 views, 50 bytes each, u32 fragments, 14 bytes each. Errors: FAILED_PRECONDITION
// (another version), DATA_LOSS (damaged).
inline constexpr int kPackedPieceVersion = 1;
std::string EncodePackedPiece(const PackedPiece& piece);
absl::StatusOr<PackedPiece> DecodePackedPiece(std::string_view blob);

}  // namespace horopter
