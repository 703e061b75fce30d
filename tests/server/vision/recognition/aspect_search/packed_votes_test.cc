#include "server/vision/recognition/aspect_search/packed_votes.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <opencv2/core.hpp>
#include <set>

#include "server/vision/recognition/aspect_search/object_values.h"
#include "tests/server/vision/recognition/aspect_search/find_aspects_fixture.h"
#include "tests/support/part_photos.h"
#include "tests/support/random.h"

namespace horopter {
namespace {

PackedIndex IndexOf(const std::vector<const PhotoPart*>& parts) {
  PackedIndex::Builder builder(static_cast<int>(parts.size()));
  for (const PhotoPart* p : parts)
    builder.Add(Pack(MakeFragmentPiece(p->object, p->fragments, kRankingChoice)));
  return std::move(builder).Finish();
}

std::vector<float> OfImage(const PartValues& values, int parts) {
  std::vector<float> out(static_cast<std::size_t>(parts), 0.0f);
  for (std::size_t k = 0; k < values.parts.size(); ++k) out[values.parts[k]] = values.values[0][k];
  return out;
}

class PackedVotes : public FindAspects {
 protected:
  std::vector<RankingImage> QuestionOf(int part) const {
    const std::vector<AspectImage> images = {MakeAspectImage(Photo(part, Pose()))};
    return RankingImages(images);
  }
  ObjectRankingOptions options_;
};

// Eight bits a value say what the index of all says.
TEST_F(PackedVotes, TheShownPartHasTheLargestValueAndItIsThatOfTheUnpackedIndex) {
  const PackedIndex packed = IndexOf({&(*parts_)[0], &(*parts_)[1], &(*parts_)[2]});
  const PackedIndex* const index = &packed;
  std::vector<FragmentPiece> pieces;
  std::vector<const FragmentPiece*> pointers;
  for (const PhotoPart& p : *parts_)
    pieces.push_back(MakeFragmentPiece(p.object, p.fragments, kRankingChoice));
  for (const FragmentPiece& piece : pieces) pointers.push_back(&piece);
  const FragmentIndex unpacked = BuildFragmentIndex(pointers);
  for (int part = 0; part < 3; ++part) {
    const auto values =
        OfImage(PackedValues(QuestionOf(part), std::span(&index, 1), options_.votes), 3);
    EXPECT_EQ(std::max_element(values.begin(), values.end()) - values.begin(), part);
    const std::vector<AspectImage> images = {MakeAspectImage(Photo(part, Pose()))};
    const float before = ObjectValues(images, unpacked, options_)[0][part];
    EXPECT_NEAR(values[part], before, 0.1f * before) << part;
  }
}

TEST_F(PackedVotes, SeveralIndicesSearchedAsOneSayWhatOneSays) {
  const PackedIndex one = IndexOf({&(*parts_)[0], &(*parts_)[1], &(*parts_)[2]});
  const PackedIndex first = IndexOf({&(*parts_)[0]});
  const PackedIndex others = IndexOf({&(*parts_)[1], &(*parts_)[2]});
  const PackedIndex* const whole[] = {&one};
  const PackedIndex* const sides[] = {&first, &others};
  for (int part = 0; part < 3; ++part) {
    const auto question = QuestionOf(part);
    const auto by_one = OfImage(PackedValues(question, whole, options_.votes), 3);
    const auto by_two = OfImage(PackedValues(question, sides, options_.votes), 3);
    for (int k = 0; k < 3; ++k) EXPECT_NEAR(by_one[k], by_two[k], 0.1f * by_one[k] + 1e-3f);
    // What is not wanted has no value, and the threads change nothing.
    AspectVoteOptions threads = options_.votes;
    threads.threads = 3;
    std::vector<std::uint8_t> wanted = {1, 1, 1};
    wanted[part] = 0;
    EXPECT_EQ(OfImage(PackedValues(question, sides, threads), 3), by_two);
    EXPECT_EQ(OfImage(PackedValues(question, sides, threads, wanted), 3)[part], 0.0f);
  }
  EXPECT_TRUE(PackedValues(QuestionOf(0), {}, options_.votes).parts.empty());
  const auto stopped = PackedValues(QuestionOf(0), whole, options_.votes, {}, [] { return true; });
  EXPECT_TRUE(stopped.parts.empty());
}

TEST(MatchesOfShard, AreAllOfOneAndNearlyAllTogether) {
  EXPECT_EQ(MatchesOfShard(120, 1), 120);
  for (const int shards : {2, 4, 16, 200}) {
    EXPECT_GE(MatchesOfShard(120, shards) * shards, 120);
    EXPECT_LE(MatchesOfShard(120, shards), 120);
    EXPECT_LE(MatchesOfShard(120, shards), MatchesOfShard(120, shards / 2));
  }
}

// The list of all values is that of the best that each shard keeps, whatever the values are.
TEST(LeaveBest, TheListOfWhatShardsKeepIsThatOfAll) {
  for (unsigned seed = 1; seed <= 20; ++seed) {
    Random random(seed);
    const int parts = 400, shards = 1 + random.Index(6), images = 1 + random.Index(3);
    std::vector<std::vector<float>> all(images, std::vector<float>(parts, 0.0f));
    for (auto& values : all) {
      for (float& v : values) v = random.Uniform(0, 1) < 0.3 ? 0.0f : float(random.Uniform(0, 1));
    }
    ObjectRankingOptions options;
    options.objects = 1 + random.Index(60);
    // Parts in their order, without what their shard did not keep.
    std::vector<std::vector<float>> kept(images, std::vector<float>(parts, 0.0f));
    std::size_t said = 0;
    for (int s = 0; s < shards; ++s) {
      PartValues mine;
      mine.values.resize(images);
      for (int k = s; k < parts; k += shards) {
        mine.parts.push_back(static_cast<std::uint32_t>(k));
        for (int i = 0; i < images; ++i) mine.values[i].push_back(all[i][k]);
      }
      const PartValues best = LeaveBest(mine, options.objects);
      said += best.parts.size();
      EXPECT_LE(std::ssize(best.parts), (images + 1) * options.objects);
      for (std::size_t k = 0; k < best.parts.size(); ++k) {
        for (int i = 0; i < images; ++i) kept[i][best.parts[k]] = best.values[i][k];
      }
    }
    EXPECT_LE(said, static_cast<std::size_t>(parts));
    EXPECT_EQ(BestObjects(kept, options), BestObjects(all, options)) << seed;
  }
}

}  // namespace
}  // namespace horopter
