#include "server/vision/recognition/aspects/packed_index.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <set>

#include "tests/support/random.h"

namespace horopter {
namespace {

FragmentPiece RandomPiece(Random& random, int views, int fragments) {
  FragmentPiece piece;
  for (int v = 0; v < views; ++v) {
    IndexedAspect& aspect = piece.aspects.emplace_back();
    aspect.points = kFirstVotePoints;
    aspect.first_point = static_cast<std::uint32_t>(piece.points.size());
    aspect.edge_length = static_cast<float>(random.Uniform(1.0, 20.0));
    for (int i = 0; i < kFirstVotePoints; ++i) {
      piece.points.push_back({static_cast<float>(random.Uniform(-0.5, 0.5)),
                              static_cast<float>(random.Uniform(-0.5, 0.5)),
                              static_cast<float>(random.Uniform(0.0, 11.99))});
    }
  }
  for (int f = 0; f < fragments; ++f) {
    FragmentPiece::Entry& e = piece.entries.emplace_back();
    FragmentKey key;
    for (float& angle : key) angle = static_cast<float>(0.8 * random.Normal());
    e.key = PackKey(key);
    e.fragment.aspect = random.Index(views);
    e.fragment.x = static_cast<float>(random.Uniform(-0.5, 0.5));
    e.fragment.y = static_cast<float>(random.Uniform(-0.5, 0.5));
    e.fragment.spread = static_cast<float>(random.Uniform(0.03, 0.5));
    e.fragment.turn = IndexedTurn(static_cast<float>(random.Uniform(-3.0, 3.0)));
  }
  return piece;
}

// Squared steps, capped as the search caps them.
int Away(const BytePackedKey& a, const BytePackedKey& b) {
  int sum = 0;
  for (int i = 0; i < kFragmentAngles; ++i) {
    const int d = std::abs(static_cast<std::int8_t>(a[i] - b[i]));
    sum += std::min(d, CoarseKeys::kFar) * std::min(d, CoarseKeys::kFar);
  }
  return sum;
}

TEST(PackedPiece, ValuesStayWithinHalfAStepAndTheBlobIsThePiece) {
  Random random(1);
  const FragmentPiece piece = RandomPiece(random, 7, 60);
  const PackedPiece packed = Pack(piece);
  ASSERT_EQ(packed.views.size(), 7u);
  ASSERT_EQ(packed.fragments.size(), 60u);
  for (std::size_t v = 0; v < packed.views.size(); ++v) {
    const auto points = UnpackPoints(packed.views[v]);
    const FirstVotePoints first = UnpackFirstPoints(packed.views[v]);
    for (int i = 0; i < kFirstVotePoints; ++i) {
      const VotePoint& p = piece.points[piece.aspects[v].first_point + i];
      EXPECT_NEAR(points[i].x, p.x, 0.0025f);
      EXPECT_NEAR(points[i].y, p.y, 0.0025f);
      EXPECT_NEAR(points[i].bin, p.bin, 1.0f / PackedView::kBinSteps);
      EXPECT_NEAR(first.x[i] / FirstVotePoints::kPlaceScale, points[i].x, 1e-4f);
      EXPECT_NEAR(first.bin[i] / float{FirstVotePoints::kBinSteps}, points[i].bin, 1e-4f);
    }
    EXPECT_NEAR(EdgeLength(packed.views[v]), piece.aspects[v].edge_length, 0.001f);
  }
  for (std::size_t f = 0; f < packed.fragments.size(); ++f) {
    const IndexedFragment& from = piece.entries[f].fragment;
    EXPECT_NEAR(PlaceOf(packed.fragments[f].x), from.x, 0.0025f);
    EXPECT_NEAR(SpreadOf(packed.fragments[f].spread) / from.spread, 1.0f, 0.01f);
    EXPECT_NEAR(TurnOfByte(packed.fragments[f].turn).rad, from.turn.rad, 0.0125f);
    EXPECT_EQ(packed.fragments[f].view, from.aspect);
  }
  EXPECT_EQ(*DecodePackedPiece(EncodePackedPiece(packed)), packed);
}

TEST(PackedPiece, SaysSixteenKilobytesOfAPartAtMost) {
  Random random(2);
  // As many views and fragments as a part has at most for rankers.
  EXPECT_LE(EncodePackedPiece(Pack(RandomPiece(random, 160, 256))).size(), 16'000u);
}

TEST(PackedPiece, ViewsOfTooFewPointsAreLeftOutWithTheirFragments) {
  Random random(3);
  FragmentPiece piece = RandomPiece(random, 2, 20);
  piece.aspects[0].points = 3;
  const PackedPiece packed = Pack(piece);
  EXPECT_EQ(packed.views.size(), 1u);
  const auto of_second = std::count_if(piece.entries.begin(),
                                       piece.entries.end(),
                                       [](const auto& e) { return e.fragment.aspect == 1; });
  EXPECT_EQ(std::ssize(packed.fragments), of_second);
  for (const PackedFragment& f : packed.fragments) EXPECT_EQ(f.view, 0);
}

TEST(PackedPiece, DamagedBlobsAreRefused) {
  Random random(4);
  const std::string blob = EncodePackedPiece(Pack(RandomPiece(random, 3, 9)));
  for (const std::size_t size : {std::size_t{0}, std::size_t{10}, blob.size() - 1})
    EXPECT_EQ(DecodePackedPiece(blob.substr(0, size)).status().code(), absl::StatusCode::kDataLoss);
  for (std::size_t i = 24; i < blob.size(); i += 13) {
    std::string other = blob;
    other[i] = static_cast<char>(other[i] ^ 1);
    EXPECT_EQ(DecodePackedPiece(other).status().code(), absl::StatusCode::kDataLoss) << i;
  }
  std::string newer = blob;
  newer[4] = static_cast<char>(kPackedPieceVersion + 1);
  EXPECT_EQ(DecodePackedPiece(newer).status().code(), absl::StatusCode::kFailedPrecondition);
}

class PackedIndexTest : public ::testing::Test {
 protected:
  PackedIndexTest() {
    Random random(5);
    PackedIndex::Builder builder(kPieces);
    for (int i = 0; i < kPieces; ++i) {
      pieces_.push_back(Pack(RandomPiece(random, 1 + random.Index(5), random.Index(120))));
      builder.Add(pieces_.back());
    }
    index_ = std::move(builder).Finish();
    for (int i = 0; i < 30; ++i) {
      for (float& angle : keys_.emplace_back()) angle = static_cast<float>(0.8 * random.Normal());
    }
  }

  // Of the fragment that is the same in all else.
  int AwayOf(std::uint32_t fragment, const FragmentKey& key) const {
    const PackedIndex::Match match = index_.At(fragment);
    for (const PackedFragment& f : pieces_[index_.PieceOf(match.view)].fragments) {
      if (PlaceOf(f.x) == match.center.x() && PlaceOf(f.y) == match.center.y() &&
          SpreadOf(f.spread) == match.spread && TurnOfByte(f.turn).rad == match.turn.rad)
        return Away(f.key, PackKeyInBytes(key));
    }
    return 1 << 30;
  }

  static constexpr int kPieces = 300;  // more than the builder takes to guess its memory
  std::vector<PackedPiece> pieces_;
  PackedIndex index_;
  std::vector<FragmentKey> keys_;
};

TEST_F(PackedIndexTest, HoldsEveryFragmentOfEveryPieceOnce) {
  std::size_t fragments = 0;
  std::multiset<std::tuple<int, float, float>> there, found;
  for (int i = 0; i < kPieces; ++i) {
    fragments += pieces_[i].fragments.size();
    for (const PackedFragment& f : pieces_[i].fragments)
      there.insert({i, PlaceOf(f.x), SpreadOf(f.spread)});
  }
  ASSERT_EQ(index_.pieces(), kPieces);
  ASSERT_EQ(index_.fragments(), fragments);
  for (std::uint32_t f = 0; f < index_.fragments(); ++f) {
    const PackedIndex::Match match = index_.At(f);
    found.insert({index_.PieceOf(match.view), match.center.x(), match.spread});
  }
  EXPECT_EQ(found, there);
}

TEST_F(PackedIndexTest, TheNearestAreThoseOfALinearScan) {
  std::vector<std::uint8_t> odd(kPieces);
  for (int i = 0; i < kPieces; ++i) odd[i] = i % 2;
  for (const bool all : {true, false}) {
    for (const FragmentKey& key : keys_) {
      const int limit = PackedIndex::LimitOf(1.0f);
      std::vector<int> away;
      for (int i = 0; i < kPieces; ++i) {
        for (const PackedFragment& f : pieces_[i].fragments) {
          const int d = Away(f.key, PackKeyInBytes(key));
          if (d <= limit && (all || odd[i])) away.push_back(d);
        }
      }
      std::sort(away.begin(), away.end());
      for (const std::size_t most : {std::size_t{5}, std::size_t{100000}}) {
        NearestKeys nearest(limit, most);
        index_.Offer(key, 7, all ? std::span<const std::uint8_t>() : odd, &nearest);
        std::vector<std::uint32_t> found;
        nearest.Take(&found);
        ASSERT_EQ(found.size(), std::min(most, away.size()));
        for (const std::uint32_t f : found) {
          const int piece = index_.PieceOf(index_.At(f - 7).view);
          EXPECT_TRUE(all || odd[piece]);
          EXPECT_LE(AwayOf(f - 7, key), away[found.size() - 1]);
        }
        EXPECT_TRUE(std::is_sorted(found.begin(), found.end()));
        EXPECT_EQ(std::adjacent_find(found.begin(), found.end()), found.end());
      }
    }
  }
}

TEST_F(PackedIndexTest, AnEmptyOneFindsNothing) {
  NearestKeys nearest(1000, 10);
  PackedIndex().Offer(keys_[0], 0, {}, &nearest);
  const PackedIndex none = PackedIndex::Builder(0).Finish();
  none.Offer(keys_[0], 0, {}, &nearest);
  std::vector<std::uint32_t> found;
  nearest.Take(&found);
  EXPECT_TRUE(found.empty());
  EXPECT_EQ(PackedIndex().pieces(), 0);
}

}  // namespace
}  // namespace horopter
