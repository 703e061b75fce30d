#include "server/vision/recognition/invariant_matching/key_index.h"

#include <bit>
#include <optional>
#include <span>
#include <utility>

#include "absl/strings/str_cat.h"
#include "server/base/status_macros.h"

namespace horopter {
namespace {

constexpr int kDimensions[kKeyTables] = {5, 5, 3};  // of each table's keys
constexpr int kTransformKnots = 65;                 // quantiles of each dimension, 64 pieces
// Keys that a transformation is computed from; more change its quantiles by less than a hundredth.
constexpr int64_t kTransformKeys = 20000;

int64_t IdOf(int slot, int key) {
  return (static_cast<int64_t>(slot) << 32) | static_cast<int64_t>(key);
}
int SlotOf(int64_t id) {
  return static_cast<int>(id >> 32);
}
int KeyOf(int64_t id) {
  return static_cast<int>(id & 0xffffffff);
}

XTreeOptions TreeOptions(int table) {
  return {.dimensions = kDimensions[table]};
}

// Calls visit(number, values) for every key of one table.
template <typename Visit>
void ForEachKey(const ObjectKeys& keys, int table, const Visit& visit) {
  const auto all = [&](const auto& rows) {
    for (std::size_t i = 0; i < rows.size(); ++i) {
      visit(static_cast<int>(i), std::span(rows[i].values));
    }
  };
  switch (static_cast<KeyTable>(table)) {
    case KeyTable::kChains:
      return all(keys.chains);
    case KeyTable::kStars:
      return all(keys.stars);
    case KeyTable::kSixPoints:
      return all(keys.six_points);
  }
}

std::vector<double> Doubles(std::span<const float> values) {
  return {values.begin(), values.end()};
}

// Of an entry of a tree; floats and the doubles they become give the same.
template <typename Scalar>
std::uint64_t HashOf(int64_t id, std::span<const Scalar> values) {
  std::uint64_t hash = 0;
  const auto mix = [&](std::uint64_t value) {  // the finaliser of splitmix64
    hash += value + 0x9e3779b97f4a7c15ull;
    hash = (hash ^ (hash >> 30)) * 0xbf58476d1ce4e5b9ull;
    hash = (hash ^ (hash >> 27)) * 0x94d049bb133111ebull;
    hash ^= hash >> 31;
  };
  mix(static_cast<std::uint64_t>(id));
  for (const Scalar x : values) mix(std::bit_cast<std::uint64_t>(static_cast<double>(x)));
  return hash;
}

absl::StatusOr<FeatureTransform> Fit(const XTreeSnapshot& tree, std::uint32_t generation) {
  std::vector<Eigen::VectorXd> keys;
  const int64_t stride = std::max<int64_t>(1, tree.size() / kTransformKeys);
  int64_t at = 0;
  tree.ForEach([&](int64_t, std::span<const double> values, std::span<const double>) {
    if (at++ % stride == 0) {
      keys.push_back(Eigen::Map<const Eigen::VectorXd>(values.data(),
                                                       static_cast<Eigen::Index>(values.size())));
    }
  });
  if (keys.size() < 2) return FeatureTransform();
  return FeatureTransform::Fit(keys, kTransformKnots, generation);
}

}  // namespace

absl::StatusOr<std::vector<KeyHit>> KeyIndexSnapshot::Find(KeyTable table,
                                                           const InvariantKey& key,
                                                           double gate) const {
  const int t = static_cast<int>(table);
  if (key.values.size() != kDimensions[t]) {
    return absl::InvalidArgumentError(absl::StrCat(
        "key of ", key.values.size(), " values for table ", t, ", need ", kDimensions[t]));
  }
  HOROPTER_ASSIGN_OR_RETURN(const std::vector<EllipsoidMatch> found,
                            trees_[t].Inside({key.values, key.covariance, gate}));
  std::vector<KeyHit> hits;
  hits.reserve(found.size());
  for (const EllipsoidMatch& m : found) {
    hits.push_back({SlotOf(m.id), KeyOf(m.id), m.squared_mahalanobis});
  }
  return hits;
}

const FeatureTransform& KeyIndexSnapshot::Transform(KeyTable table) const {
  return (*transforms_)[static_cast<int>(table)];
}

int64_t KeyIndexSnapshot::size() const {
  int64_t sum = 0;
  for (const XTreeSnapshot& tree : trees_) sum += tree.size();
  return sum;
}

int64_t KeyIndexSnapshot::bytes() const {
  int64_t sum = 0;
  for (const XTreeSnapshot& tree : trees_) sum += tree.Memory().bytes;
  return sum;
}

absl::Status KeyIndexSnapshot::CheckAgainst(const KeyTally& keys) const {
  for (int t = 0; t < kKeyTables; ++t) {
    HOROPTER_RETURN_IF_ERROR(trees_[t].CheckInvariants());
    if (keys.tables_[t].count != trees_[t].size()) {
      return absl::InternalError(absl::StrCat("index ",
                                              t,
                                              " holds ",
                                              trees_[t].size(),
                                              " keys, the objects have ",
                                              keys.tables_[t].count));
    }
    std::uint64_t sum = 0;
    trees_[t].ForEach([&](int64_t id, std::span<const double> values, std::span<const double>) {
      sum += HashOf(id, values);
    });
    if (sum != keys.tables_[t].sum) {
      return absl::InternalError(absl::StrCat("index ", t, " holds foreign keys"));
    }
  }
  return absl::OkStatus();
}

absl::Status KeyIndexSnapshot::CheckAgainst(const std::vector<const ObjectKeys*>& objects) const {
  KeyTally keys;
  for (int slot = 0; slot < static_cast<int>(objects.size()); ++slot) {
    if (objects[slot] != nullptr) keys.Add(slot, *objects[slot]);
  }
  return CheckAgainst(keys);
}

void KeyTally::Add(int slot, const ObjectKeys& keys) {
  for (int t = 0; t < kKeyTables; ++t) {
    ForEachKey(keys, t, [&](int key, std::span<const float> values) {
      ++tables_[t].count;
      tables_[t].sum += HashOf(IdOf(slot, key), values);
    });
  }
}

std::vector<int> SharedKeys(const KeyIndexSnapshot& index, const ObjectKeys& keys) {
  // Keys of an object, for how many objects share them; for time.
  constexpr std::size_t kMostAsked = 64;
  // Twice the tolerance within which FindLookAlike calls corners equal, as of a part's typical
  // edge.
  constexpr double kDeviation = 0.02;
  std::vector<int> shared, last_key;
  int number = 0;
  const auto ask = [&](KeyTable table, const auto& rows) {
    const std::size_t asked = std::min(rows.size(), kMostAsked);
    for (std::size_t k = 0; k < asked; ++k) {
      const auto& values = rows[k * rows.size() / asked].values;
      const auto size = static_cast<Eigen::Index>(values.size());
      InvariantKey key;
      key.values = Eigen::Map<const Eigen::VectorXf>(values.data(), size).template cast<double>();
      key.covariance = kDeviation * kDeviation * Eigen::MatrixXd::Identity(size, size);
      ++number;
      const auto hits = index.Find(table, key, 4.0);
      if (!hits.ok()) continue;
      for (const KeyHit& hit : *hits) {
        if (hit.slot >= static_cast<int>(shared.size())) {
          shared.resize(hit.slot + 1, 0);
          last_key.resize(hit.slot + 1, 0);
        }
        if (last_key[hit.slot] != number) ++shared[hit.slot];  // each key counts once
        last_key[hit.slot] = number;
      }
    }
  };
  ask(KeyTable::kChains, keys.chains);
  ask(KeyTable::kStars, keys.stars);
  ask(KeyTable::kSixPoints, keys.six_points);
  return shared;
}

void KeyCollection::Add(int slot, const ObjectKeys& keys) {
  for (int t = 0; t < kKeyTables; ++t) {
    Table& table = tables_[t];
    ForEachKey(keys, t, [&](int key, std::span<const float> values) {
      table.values.insert(table.values.end(), values.begin(), values.end());
      table.ids.push_back(IdOf(slot, key));
    });
  }
}

absl::StatusOr<KeyIndex> KeyIndex::FromCollection(KeyCollection keys,
                                                  std::uint32_t generation,
                                                  int threads) {
  std::array<std::optional<XTree>, kKeyTables> trees;
  for (int t = kKeyTables; t-- > 0;) {  // the largest first, while the memory is still there
    const KeyCollection::Table table = std::exchange(keys.tables_[t], {});
    HOROPTER_ASSIGN_OR_RETURN(
        trees[t],
        XTree::BulkLoadBoxes(TreeOptions(t), table.values, table.values, table.ids, threads));
  }
  KeyIndex index({*std::move(trees[0]), *std::move(trees[1]), *std::move(trees[2])});
  index.transforms_ = std::make_shared<const std::array<FeatureTransform, kKeyTables>>();
  HOROPTER_RETURN_IF_ERROR(index.RefreshTransforms(generation));
  return index;
}

absl::StatusOr<KeyIndex> KeyIndex::Build(const std::vector<const ObjectKeys*>& objects,
                                         std::uint32_t generation,
                                         int threads) {
  KeyCollection keys;
  for (int slot = 0; slot < static_cast<int>(objects.size()); ++slot) {
    if (objects[slot] != nullptr) keys.Add(slot, *objects[slot]);
  }
  return FromCollection(std::move(keys), generation, threads);
}

absl::Status KeyIndex::Insert(int slot, const ObjectKeys& keys) {
  if (slot < 0) return absl::InvalidArgumentError("negative slot");
  absl::Status status;
  for (int t = 0; t < kKeyTables; ++t) {
    ForEachKey(keys, t, [&](int key, std::span<const float> values) {
      status.Update(trees_[t].Insert(Doubles(values), IdOf(slot, key)));
    });
  }
  return status;
}

absl::Status KeyIndex::Erase(int slot, const ObjectKeys& keys) {
  absl::Status status;
  for (int t = 0; t < kKeyTables; ++t) {
    ForEachKey(keys, t, [&](int key, std::span<const float> values) {
      status.Update(trees_[t].Delete(Doubles(values), IdOf(slot, key)));
    });
  }
  return status;
}

void KeyIndex::EraseSlot(int slot) {
  for (XTree& tree : trees_) {
    struct Found {
      int64_t id;
      std::vector<double> values;
    };
    std::vector<Found> found;
    tree.view().ForEach([&](int64_t id, std::span<const double> at, std::span<const double>) {
      if (SlotOf(id) == slot) found.push_back({id, {at.begin(), at.end()}});
    });
    for (const Found& entry : found) (void)tree.Delete(entry.values, entry.id);
  }
}

absl::Status KeyIndex::RefreshTransforms(std::uint32_t generation) {
  int64_t keys = 0;
  for (const XTree& tree : trees_) keys += tree.size();
  if (std::abs(keys - keys_at_transform_) * 10 <= keys_at_transform_) return absl::OkStatus();
  std::array<FeatureTransform, kKeyTables> transforms;
  for (int t = 0; t < kKeyTables; ++t) {
    HOROPTER_ASSIGN_OR_RETURN(transforms[t], Fit(trees_[t].view(), generation));
  }
  transforms_ =
      std::make_shared<const std::array<FeatureTransform, kKeyTables>>(std::move(transforms));
  keys_at_transform_ = keys;
  return absl::OkStatus();
}

KeyIndexSnapshot KeyIndex::Snapshot() {
  KeyIndexSnapshot snapshot;
  for (int t = 0; t < kKeyTables; ++t) snapshot.trees_[t] = trees_[t].Snapshot();
  snapshot.transforms_ = transforms_;
  return snapshot;
}

}  // namespace horopter
