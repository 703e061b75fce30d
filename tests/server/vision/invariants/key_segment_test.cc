#include "server/vision/invariants/key_segment.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <random>

#include "server/base/sha256.h"
#include "server/vision/recognition/invariant_matching/key_index.h"
#include "tests/support/synthetic_part.h"

namespace horopter {
namespace {

using absl::StatusCode;

std::vector<ObjectKeys> RandomCatalog(int count) {
  std::mt19937 rng(5);
  std::uniform_real_distribution<double> u(0.01, 0.05);
  std::vector<ObjectKeys> keys;
  for (int i = 0; i < count; ++i) {
    const double w = u(rng) + 0.03, h = u(rng) + 0.03, t = 0.3 * u(rng) + 0.004;
    keys.push_back(ComputeObjectKeys(
        Prism("part", {{0, 0}, {w, 0}, {w, t}, {t + 0.004, t + 0.006}, {t, h}, {0, h}}, u(rng))));
  }
  return keys;
}

std::string AddressOf(int member) {
  return Sha256Hex(std::to_string(member));
}

std::string SegmentOf(const std::vector<ObjectKeys>& catalog) {
  KeySegmentWriter writer;
  for (size_t i = 0; i < catalog.size(); ++i)
    writer.Add(AddressOf(static_cast<int>(i)), catalog[i]);
  return std::move(writer).Finish();
}

TEST(KeySegment, CountsSharedKeysAsTheIndexDoes) {
  std::vector<ObjectKeys> catalog = RandomCatalog(40);
  catalog[9] = catalog[4];  // the same part again
  catalog[11] = {};         // one without a corner
  const std::string bytes = SegmentOf(catalog);
  const auto segment = KeySegmentView::Of(bytes);
  ASSERT_TRUE(segment.ok()) << segment.status();
  EXPECT_TRUE(segment->Verify().ok());
  ASSERT_EQ(segment->members(), 40);
  std::vector<const ObjectKeys*> pointers;
  for (const ObjectKeys& keys : catalog) pointers.push_back(&keys);
  const KeyIndexSnapshot index = KeyIndex::Build(pointers, 1).value().Snapshot();
  EXPECT_EQ(segment->size(), index.size());
  int64_t total = 0;
  for (const int asked : {4, 9, 11, 30}) {
    std::vector<int> shared(40, 0), expected = SharedKeys(index, catalog[asked]);
    segment->AddSharedKeys(catalog[asked], &shared);
    expected.resize(40, 0);
    EXPECT_EQ(shared, expected) << asked;
    for (const int count : shared) total += count;
  }
  EXPECT_GT(total, 100);
  const auto tallies = segment->Tallies();
  for (int i = 0; i < 40; ++i) {
    EXPECT_EQ(segment->address(i), AddressOf(i));
    EXPECT_EQ(tallies[i], KeySegmentView::TallyOf(catalog[i]));
  }
  EXPECT_EQ(tallies[4], tallies[9]);
  EXPECT_FALSE(tallies[4] == tallies[5]);
}

TEST(KeySegment, OfNothingHoldsNothing) {
  const std::string bytes = SegmentOf({});
  const auto segment = KeySegmentView::Of(bytes);
  ASSERT_TRUE(segment.ok()) << segment.status();
  EXPECT_TRUE(segment->Verify().ok());
  EXPECT_EQ(segment->members(), 0);
  std::vector<int> shared;
  segment->AddSharedKeys(RandomCatalog(1)[0], &shared);
  EXPECT_TRUE(shared.empty());
}

// Whatever lies in a file: refused, or found by its digest, and never read beyond its end.
TEST(KeySegment, DamagedBytesAreRefusedOrFoundByTheDigest) {
  const std::string good = SegmentOf(RandomCatalog(3));
  for (size_t size = 0; size < good.size(); size += 1 + good.size() / 97) {
    const std::string cut = good.substr(0, size);
    EXPECT_EQ(KeySegmentView::Of(cut).status().code(), StatusCode::kDataLoss) << size;
  }
  const std::string longer = good + "more";
  EXPECT_EQ(KeySegmentView::Of(longer).status().code(), StatusCode::kDataLoss);
  std::mt19937 rng(1);
  for (int i = 0; i < 300; ++i) {
    std::string bad = good;
    const size_t at = i < 40 ? static_cast<size_t>(i) : rng() % bad.size();
    bad[at] = static_cast<char>(bad[at] ^ (1 << rng() % 8));
    const auto segment = KeySegmentView::Of(bad);
    EXPECT_FALSE(segment.ok() && segment->Verify().ok()) << at;
  }
  std::string newer = good;
  newer[4] = 9;
  EXPECT_EQ(KeySegmentView::Of(newer).status().code(), StatusCode::kFailedPrecondition);
}

}  // namespace
}  // namespace horopter
