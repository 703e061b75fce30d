// The invariant keys of some thousand shapes in one block of bytes that never changes and is
// searched as it is.
//
// Byte layout, little-endian: "HSEG", u32 version, u32 members, u32 zero, three u64 counts of keys;
// addresses of the members, kAddressBytes each; then for each table (chains, stars, six points) the
// values of its keys, all first ones, then all second ones and so on, f32 each, ordered by the
// first, and their members, u16 each, filled up to 4 bytes; last the SHA-256 of all before it, 64
// hex digits.
#pragma once

#include <array>
#include <cstdint>
#include <string>
#include <string_view>
#include <vector>

#include "absl/status/statusor.h"
#include "server/vision/invariants/object_keys.h"

namespace horopter {

// To be raised with every change of the layout.
inline constexpr std::uint32_t kKeySegmentVersion = 1;
// Hex digits of the address of what is derived of a shape.
inline constexpr std::size_t kAddressBytes = 64;
inline constexpr int kMaxSegmentMembers = 65535;

// Gathers keys. Takes 24 bytes a key.
class KeySegmentWriter {
 public:
  // address: kAddressBytes bytes. At most kMaxSegmentMembers.
  void Add(std::string_view address, const ObjectKeys& keys);
  int members() const { return static_cast<int>(addresses_.size() / kAddressBytes); }
  // The block; the same for the same members in the same order.
  std::string Finish() &&;

 private:
  struct Key {
    std::array<float, 5> values{};
    std::uint16_t member = 0;
  };
  std::string addresses_;
  std::array<std::vector<Key>, 3> tables_;
};

// A block that is searched. Whoever holds the bytes keeps them.
class KeySegmentView {
 public:
  // bytes: aligned as floats. Errors: FAILED_PRECONDITION (another version), DATA_LOSS (not such a
  // block, too short or too long for its counts). The digest is left to Verify, which reads
  // everything.
  static absl::StatusOr<KeySegmentView> Of(std::string_view bytes);
  // Errors: DATA_LOSS.
  absl::Status Verify() const;

  int members() const { return members_; }
  std::string_view address(int member) const {
    return addresses_.substr(member * kAddressBytes, kAddressBytes);
  }
  int64_t size() const { return tables_[0].count + tables_[1].count + tables_[2].count; }

  // Adds to shared[i] what SharedKeys (key_index.h) counts for member i. shared: one per member.
  void AddSharedKeys(const ObjectKeys& keys, std::vector<int>* shared) const;

  // What one member's keys add up to, which does not depend on their order: to compare them with
  // TallyOf the object's keys. One per member.
  struct Tally {
    int64_t count = 0;
    std::uint64_t sum = 0;
    friend bool operator==(const Tally&, const Tally&) = default;
  };
  std::vector<Tally> Tallies() const;
  static Tally TallyOf(const ObjectKeys& keys);

 private:
  struct Table {
    int64_t count = 0;
    int dimensions = 0;
    const float* values = nullptr;  // [dimension][key]
    const std::uint16_t* of = nullptr;
  };
  template <typename Key>
  void Ask(const Table& table, const std::vector<Key>& keys, std::vector<int>* shared) const;

  std::string_view bytes_, addresses_;
  int members_ = 0;
  std::array<Table, 3> tables_;
};

}  // namespace horopter
