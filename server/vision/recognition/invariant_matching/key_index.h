// The invariant keys of a whole catalog in X-trees: which object's vertices could these points be?
#pragma once

#include <array>
#include <cstdint>
#include <memory>
#include <vector>

#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "server/index/x_tree.h"
#include "server/vision/invariants/feature_transform.h"
#include "server/vision/invariants/object_keys.h"

namespace horopter {

enum class KeyTable { kChains = 0, kStars = 1, kSixPoints = 2 };
inline constexpr int kKeyTables = 3;  // of the enumeration above

// A key of the catalog inside a query's gate: key `key` of the object in slot `slot`.
struct KeyHit {
  int slot = 0;
  int key = 0;
  double squared_mahalanobis = 0.0;

  friend bool operator==(const KeyHit&, const KeyHit&) = default;
};

// What an index over some objects must hold, in a few numbers: per table the count of the keys and
// the sum of their hashes, which does not depend on their order.
class KeyTally {
 public:
  void Add(int slot, const ObjectKeys& keys);

 private:
  friend class KeyIndexSnapshot;
  struct Table {
    int64_t count = 0;
    std::uint64_t sum = 0;
  };
  std::array<Table, kKeyTables> tables_;
};

// One state of the index; immutable, any number of readers.
class KeyIndexSnapshot {
 public:
  // Keys whose squared Mahalanobis distance to `key` is at most `gate`; handedness and size are for
  // the caller to compare. Errors: INVALID_ARGUMENT (wrong length, covariance not positive
  // definite).
  absl::StatusOr<std::vector<KeyHit>> Find(KeyTable table,
                                           const InvariantKey& key,
                                           double gate) const;

  // The transformation that makes the table's density flat, with the generation of the catalog it
  // was computed from; empty (0 dimensions) while the table has fewer
  // than two keys.
  const FeatureTransform& Transform(KeyTable table) const;

  int64_t size() const;
  int64_t bytes() const;

  // Whether it holds exactly these keys (but for a collision of 64-bit sums) and the trees are
  // sound. Errors: INTERNAL, says what differs.
  absl::Status CheckAgainst(const KeyTally& keys) const;
  // The same of objects[i] in slot i; null: a free slot.
  absl::Status CheckAgainst(const std::vector<const ObjectKeys*>& objects) const;

 private:
  friend class KeyIndex;
  std::array<XTreeSnapshot, kKeyTables> trees_;
  std::shared_ptr<const std::array<FeatureTransform, kKeyTables>> transforms_ =
      std::make_shared<const std::array<FeatureTransform, kKeyTables>>();
};

// For each slot (up to the last that has any) how many of the object's similarity and six-point
// keys have one of that slot's near them: objects with most of them are candidates for look-alikes.
// Of more than 64 keys of a table evenly chosen ones are asked for.
std::vector<int> SharedKeys(const KeyIndexSnapshot& index, const ObjectKeys& keys);

// Keys of many objects on their way into an index: less than the objects' own tables take, and let
// go table by table while the index is made.
class KeyCollection {
 public:
  void Add(int slot, const ObjectKeys& keys);

 private:
  friend class KeyIndex;
  struct Table {
    std::vector<float> values;
    std::vector<int64_t> ids;
  };
  std::array<Table, kKeyTables> tables_;
};

// The index that changes. One writer; snapshots share all but the nodes a write touches.
class KeyIndex {
 public:
  // generation: of the catalog, kept in the transformations. Errors: INVALID_ARGUMENT (keys that
  // are not finite).
  static absl::StatusOr<KeyIndex> FromCollection(KeyCollection keys,
                                                 std::uint32_t generation,
                                                 int threads = 1);
  // objects[i] gets slot i; null: a free slot.
  static absl::StatusOr<KeyIndex> Build(const std::vector<const ObjectKeys*>& objects,
                                        std::uint32_t generation,
                                        int threads = 1);

  // Errors: INVALID_ARGUMENT (slot out of range); NOT_FOUND (Erase of keys that are not there).
  absl::Status Insert(int slot, const ObjectKeys& keys);
  absl::Status Erase(int slot, const ObjectKeys& keys);

  // The same for a slot whose keys are not known: reads the whole index.
  void EraseSlot(int slot);

  // Recomputes the transformations, if the number of keys has changed by a tenth since the last
  // time: their quantiles hardly move by less.
  absl::Status RefreshTransforms(std::uint32_t generation);

  KeyIndexSnapshot Snapshot();

 private:
  explicit KeyIndex(std::array<XTree, kKeyTables> trees) : trees_(std::move(trees)) {}

  std::array<XTree, kKeyTables> trees_;
  std::shared_ptr<const std::array<FeatureTransform, kKeyTables>> transforms_;
  int64_t keys_at_transform_ = 0;
};

}  // namespace horopter
