#include "server/vision/recognition/invariant_matching/key_index.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <atomic>
#include <cmath>
#include <random>
#include <thread>

#include "tests/support/synthetic_part.h"

namespace horopter {
namespace {

ObjectModel RandomBracket(std::mt19937& rng) {
  std::uniform_real_distribution<double> u(0.01, 0.05);
  const double w = u(rng) + 0.03, h = u(rng) + 0.03, t = 0.3 * u(rng) + 0.004;
  return Prism("part", {{0, 0}, {w, 0}, {w, t}, {t + 0.004, t + 0.006}, {t, h}, {0, h}}, u(rng));
}

std::vector<ObjectKeys> RandomCatalog(int count, unsigned seed) {
  std::mt19937 rng(seed);
  std::vector<ObjectKeys> keys;
  for (int i = 0; i < count; ++i) keys.push_back(ComputeObjectKeys(RandomBracket(rng)));
  return keys;
}

std::vector<const ObjectKeys*> Pointers(const std::vector<ObjectKeys>& keys) {
  std::vector<const ObjectKeys*> pointers;
  for (const ObjectKeys& k : keys) pointers.push_back(&k);
  return pointers;
}

InvariantKey Around(const FourVertexKey& key, double deviation) {
  InvariantKey query;
  query.values.resize(5);
  for (int k = 0; k < 5; ++k) query.values(k) = key.values[k];
  query.covariance = deviation * deviation * Eigen::MatrixXd::Identity(5, 5);
  return query;
}

TEST(KeyIndex, FindsEveryKeyAmongAllAndAgreesWithAScan) {
  const std::vector<ObjectKeys> catalog = RandomCatalog(30, 1);
  KeyIndex index = KeyIndex::Build(Pointers(catalog), 7).value();
  const KeyIndexSnapshot snapshot = index.Snapshot();
  ASSERT_TRUE(snapshot.CheckAgainst(Pointers(catalog)).ok());
  for (int slot = 0; slot < 30; slot += 7) {
    for (size_t key = 0; key < catalog[slot].chains.size(); key += 5) {
      const InvariantKey query = Around(catalog[slot].chains[key], 0.05);
      const auto hits = snapshot.Find(KeyTable::kChains, query, 11.07);
      ASSERT_TRUE(hits.ok()) << hits.status();
      size_t expected = 0;
      for (const ObjectKeys& object : catalog) {
        for (const FourVertexKey& other : object.chains) {
          const InvariantKey at = Around(other, 1.0);
          expected += (at.values - query.values).squaredNorm() / (0.05 * 0.05) <= 11.07;
        }
      }
      EXPECT_EQ(hits->size(), expected);
      EXPECT_TRUE(std::any_of(hits->begin(), hits->end(), [&](const KeyHit& h) {
        return h.slot == slot && h.key == static_cast<int>(key) && h.squared_mahalanobis < 1e-9;
      }));
    }
  }
  EXPECT_FALSE(snapshot.Find(KeyTable::kSixPoints, Around(catalog[0].chains[0], 1.0), 1.0).ok());
}

TEST(KeyIndex, ErasesASlotWhoseKeysAreNotKnownAndRanksWhoSharesKeys) {
  std::vector<ObjectKeys> catalog = RandomCatalog(12, 7);
  catalog[9] = catalog[4];  // the same part again
  KeyIndex index = KeyIndex::Build(Pointers(catalog), 1).value();
  const std::vector<int> shared = SharedKeys(index.Snapshot(), catalog[4]);
  ASSERT_GE(shared.size(), 10u);
  EXPECT_EQ(shared[4], shared[9]);
  EXPECT_EQ(shared[9], *std::max_element(shared.begin(), shared.end()));
  index.EraseSlot(3);
  std::vector<const ObjectKeys*> left = Pointers(catalog);
  left[3] = nullptr;
  EXPECT_TRUE(index.Snapshot().CheckAgainst(left).ok());
}

TEST(KeyIndex, ChangedPieceByPieceEqualsBuiltAtOnceAndSnapshotsStand) {
  std::vector<ObjectKeys> catalog = RandomCatalog(20, 2);
  KeyIndex index = KeyIndex::Build({}, 1).value();
  for (int slot = 0; slot < 20; ++slot) ASSERT_TRUE(index.Insert(slot, catalog[slot]).ok());
  const KeyIndexSnapshot full = index.Snapshot();
  std::vector<const ObjectKeys*> left = Pointers(catalog);
  for (int slot = 0; slot < 20; slot += 3) {
    ASSERT_TRUE(index.Erase(slot, catalog[slot]).ok());
    left[slot] = nullptr;
  }
  EXPECT_TRUE(index.Snapshot().CheckAgainst(left).ok());
  EXPECT_TRUE(full.CheckAgainst(Pointers(catalog)).ok());
  EXPECT_FALSE(index.Snapshot().CheckAgainst(Pointers(catalog)).ok());
  EXPECT_EQ(index.Erase(0, catalog[0]).code(), absl::StatusCode::kNotFound);
}

TEST(KeyIndex, OneChangedValueAndOneSwappedSlotAreNoticed) {
  std::vector<ObjectKeys> catalog = RandomCatalog(8, 9);
  KeyIndex index = KeyIndex::Build(Pointers(catalog), 1, 2).value();
  const KeyIndexSnapshot snapshot = index.Snapshot();
  ASSERT_TRUE(snapshot.CheckAgainst(Pointers(catalog)).ok());
  std::swap(catalog[2], catalog[5]);
  EXPECT_EQ(snapshot.CheckAgainst(Pointers(catalog)).code(), absl::StatusCode::kInternal);
  std::swap(catalog[2], catalog[5]);
  float& value = catalog[3].six_points.back().values[1];
  value = std::nextafter(value, 1e9f);
  EXPECT_EQ(snapshot.CheckAgainst(Pointers(catalog)).code(), absl::StatusCode::kInternal);
}

TEST(KeyIndex, TheTransformationNamesItsGenerationAndFlattensTheDensity) {
  const std::vector<ObjectKeys> catalog = RandomCatalog(40, 3);
  KeyIndex index = KeyIndex::Build(Pointers(catalog), 41).value();
  const FeatureTransform& transform = index.Snapshot().Transform(KeyTable::kChains);
  EXPECT_EQ(transform.catalog_generation(), 41u);
  ASSERT_EQ(transform.dimensions(), 5);
  int low_half = 0, all = 0;
  for (const ObjectKeys& object : catalog) {
    for (const FourVertexKey& key : object.chains) {
      low_half += transform.Apply(Around(key, 1.0).values)(0) < 0.5;
      ++all;
    }
  }
  EXPECT_NEAR(static_cast<double>(low_half) / all, 0.5, 0.05);
  // One more object does not move it, a tenth more keys do.
  ASSERT_TRUE(index.Insert(40, catalog[0]).ok());
  ASSERT_TRUE(index.RefreshTransforms(42).ok());
  EXPECT_EQ(index.Snapshot().Transform(KeyTable::kChains).catalog_generation(), 41u);
  for (int slot = 41; slot < 48; ++slot) ASSERT_TRUE(index.Insert(slot, catalog[slot - 40]).ok());
  ASSERT_TRUE(index.RefreshTransforms(43).ok());
  EXPECT_EQ(index.Snapshot().Transform(KeyTable::kChains).catalog_generation(), 43u);
}

}  // namespace
}  // namespace horopter
