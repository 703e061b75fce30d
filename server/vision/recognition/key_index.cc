#include "server/vision/recognition/key_index.h"

#include <limits>
#include <map>
#include <utility>

#include "absl/strings/str_cat.h"
#include "server/base/status_macros.h"

namespace horopter {
namespace {

constexpr int kDimensions[kKeyTables] = {5, 5, 3};
constexpr int kTransformKnots = 65;
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

// Calls visit(number, values) for every key of one table.
template <typename Visit>
void ForEachKey(const ObjectKeys& keys, int table, const Visit& visit) {
  const auto all = [&](const auto& rows) {
    std::vector<double> values;
    for (std::size_t i = 0; i < rows.size(); ++i) {
      values.assign(rows[i].values.begin(), rows[i].values.end());
      visit(static_cast<int>(i), values);
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

absl::StatusOr<FeatureTransform> Fit(const XTreeSnapshot& tree, std::uint32_t generation) {
  std::vector<Eigen::VectorXd> keys;
  const int64_t stride = std::max<int64_t>(1, tree.size() / kTransformKeys);
  int64_t at = 0;
  tree.ForEach([&](int64_t, std::span<const double> low, std::span<const double>) {
    if (at++ % stride == 0) {
      keys.push_back(Eigen::Map<const Eigen::VectorXd>(low.data(), low.size()));
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
    return absl::InvalidArgumentError(
        absl::StrCat("key of ", key.values.size(), " values, need ", kDimensions[t]));
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

absl::Status KeyIndexSnapshot::CheckAgainst(const std::vector<const ObjectKeys*>& objects) const {
  for (int t = 0; t < kKeyTables; ++t) {
    HOROPTER_RETURN_IF_ERROR(trees_[t].CheckInvariants());
    std::map<int64_t, std::vector<double>> wanted;
    for (int slot = 0; slot < static_cast<int>(objects.size()); ++slot) {
      if (objects[slot] == nullptr) continue;
      ForEachKey(*objects[slot], t, [&](int key, const std::vector<double>& values) {
        wanted[IdOf(slot, key)] = values;
      });
    }
    if (static_cast<int64_t>(wanted.size()) != trees_[t].size()) {
      return absl::InternalError(absl::StrCat(
          "index ", t, " holds ", trees_[t].size(), " keys, the objects have ", wanted.size()));
    }
    int64_t wrong = 0;
    trees_[t].ForEach([&](int64_t id, std::span<const double> low, std::span<const double>) {
      const auto it = wanted.find(id);
      wrong += it == wanted.end() || !std::equal(low.begin(), low.end(), it->second.begin());
      if (it != wanted.end()) wanted.erase(it);
    });
    if (wrong > 0) {
      return absl::InternalError(absl::StrCat("index ", t, " holds ", wrong, " foreign keys"));
    }
  }
  return absl::OkStatus();
}

absl::StatusOr<KeyIndex> KeyIndex::Build(const std::vector<const ObjectKeys*>& objects,
                                         std::uint32_t generation) {
  std::vector<XTree> trees;
  for (int t = 0; t < kKeyTables; ++t) {
    std::vector<double> points;
    std::vector<int64_t> ids;
    for (int slot = 0; slot < static_cast<int>(objects.size()); ++slot) {
      if (objects[slot] == nullptr) continue;
      ForEachKey(*objects[slot], t, [&](int key, const std::vector<double>& values) {
        points.insert(points.end(), values.begin(), values.end());
        ids.push_back(IdOf(slot, key));
      });
    }
    HOROPTER_ASSIGN_OR_RETURN(XTree tree,
                              XTree::BulkLoad({.dimensions = kDimensions[t]}, points, ids));
    trees.push_back(std::move(tree));
  }
  KeyIndex index({std::move(trees[0]), std::move(trees[1]), std::move(trees[2])});
  index.transforms_ = std::make_shared<const std::array<FeatureTransform, kKeyTables>>();
  HOROPTER_RETURN_IF_ERROR(index.RefreshTransforms(generation));
  return index;
}

absl::Status KeyIndex::Insert(int slot, const ObjectKeys& keys) {
  if (slot < 0) return absl::InvalidArgumentError("negative slot");
  absl::Status status;
  for (int t = 0; t < kKeyTables; ++t) {
    ForEachKey(keys, t, [&](int key, const std::vector<double>& values) {
      status.Update(trees_[t].Insert(values, IdOf(slot, key)));
    });
  }
  return status;
}

absl::Status KeyIndex::Erase(int slot, const ObjectKeys& keys) {
  absl::Status status;
  for (int t = 0; t < kKeyTables; ++t) {
    ForEachKey(keys, t, [&](int key, const std::vector<double>& values) {
      status.Update(trees_[t].Delete(values, IdOf(slot, key)));
    });
  }
  return status;
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
