#include "server/vision/recognition/aspect_search/packed_votes.h"

#include <algorithm>
#include <cmath>
#include <numeric>
#include <unordered_map>

#include "server/base/parallel_for.h"
#include "server/vision/recognition/aspect_search/vote_test.h"
#include "server/vision/recognition/aspects/aspect_maps.h"

namespace horopter {
namespace {

constexpr int kPackedShares = 16;  // of the image's fragments, so that threads do not matter

// The best vote of a part: by its rank, as ChooseDistinct chooses.
struct BestVote {
  float rank = 0.0f;
  float value = 0.0f;  // rank by the root of the outline's length, as of object_values.cc
};
using BestVotes = std::unordered_map<std::uint32_t, BestVote>;

void KeepBetter(std::uint32_t part, const BestVote& vote, BestVotes* best) {
  BestVote& kept = (*best)[part];
  if (vote.rank > kept.rank || (vote.rank == kept.rank && vote.value > kept.value)) kept = vote;
}

// Indices side by side: fragments and parts are numbered through.
struct Sides {
  std::span<const PackedIndex* const> indices;
  std::vector<std::uint32_t> first_fragment, first_part;
  std::vector<std::span<const std::uint8_t>> wanted;

  Sides(std::span<const PackedIndex* const> all, std::span<const std::uint8_t> of_all)
      : indices(all) {
    std::uint32_t fragments = 0, parts = 0;
    for (const PackedIndex* index : all) {
      first_fragment.push_back(fragments);
      first_part.push_back(parts);
      const auto count = static_cast<std::size_t>(index->pieces());
      wanted.push_back(of_all.empty() ? of_all : of_all.subspan(parts, count));
      fragments += index->fragments();
      parts += static_cast<std::uint32_t>(count);
    }
  }
};

class PackedShare {
 public:
  PackedShare(const AspectImage& image,
              const CoarseMaps& maps,
              const Sides& sides,
              const AspectVoteOptions& options)
      : test_(image, maps, options), sides_(sides), options_(options) {}

  void Vote(const ContourFragment& fragment) {
    const float radius =
        static_cast<float>(options_.key_rms_rad) * std::sqrt(float{kFragmentAngles});
    for (const ContourFragment& way : {fragment, Reversed(fragment)}) {
      NearestKeys nearest(PackedIndex::LimitOf(radius),
                          static_cast<std::size_t>(std::max(0, options_.max_matches)));
      for (std::size_t i = 0; i < sides_.indices.size(); ++i) {
        sides_.indices[i]->Offer(way.key, sides_.first_fragment[i], sides_.wanted[i], &nearest);
      }
      found_.clear();
      nearest.Take(&found_);
      const IndexedTurn turn = TurnOf(way);
      for (const std::uint32_t f : found_) Test(way, turn, f);
    }
  }

  const BestVotes& best() const { return best_; }

 private:
  void Test(const ContourFragment& way, const IndexedTurn& turn, std::uint32_t number) {
    const auto side = static_cast<std::size_t>(
        std::upper_bound(sides_.first_fragment.begin(), sides_.first_fragment.end(), number) -
        sides_.first_fragment.begin() - 1);
    const PackedIndex& index = *sides_.indices[side];
    const PackedIndex::Match match = index.At(number - sides_.first_fragment[side]);
    const float size = way.spread / match.spread;
    if (!test_.IsSoughtSize(size)) return;
    const Similarity s = Placed(size, turn, match.turn, match.center, way.center);
    const PackedView& view = index.View(match.view);
    const FirstVotePoints first = UnpackFirstPoints(view);
    const std::optional<float> support = test_.SupportOfFirst(first, s);
    if (!support) return;
    const std::array<VotePoint, kFirstVotePoints> points = UnpackPoints(view);
    // Views of several indices may share a number: one in many is not tested then.
    const auto accepted = test_.Judge(match.view, first, points, way.pivot, *support, s);
    if (!accepted) return;
    const float length = EdgeLength(view) * accepted->at.size;
    const float rank = length * accepted->gain;
    KeepBetter(sides_.first_part[side] + static_cast<std::uint32_t>(index.PieceOf(match.view)),
               {rank, rank / std::sqrt(std::max(1.0f, length))},
               &best_);
  }

  VoteTest test_;
  const Sides& sides_;
  const AspectVoteOptions& options_;
  std::vector<std::uint32_t> found_;
  BestVotes best_;
};

BestVotes BestOfImage(const RankingImage& image,
                      const Sides& sides,
                      const AspectVoteOptions& options,
                      const StopRequested& stop) {
  BestVotes best;
  if (image.width == 0) return best;
  AspectImage maps_of;
  maps_of.width = image.width;
  maps_of.height = image.height;
  maps_of.edges = image.edges;
  FillAspectMaps(options.threads, &maps_of);
  const CoarseMaps maps(maps_of);
  std::vector<PackedShare> shares(kPackedShares, PackedShare(maps_of, maps, sides, options));
  ParallelFor(kPackedShares, options.threads, [&](int i) {
    for (std::size_t f = static_cast<std::size_t>(i); f < image.fragments.size();
         f += kPackedShares) {
      if (f / kPackedShares % 16 == 0 && IsStopRequested(stop)) return;
      shares[i].Vote(image.fragments[f]);
    }
  });
  for (const PackedShare& share : shares) {
    for (const auto& [part, vote] : share.best()) KeepBetter(part, vote, &best);
  }
  return best;
}

}  // namespace

std::vector<RankingImage> RankingImages(std::span<const AspectImage> images,
                                        const ObjectRankingOptions& options) {
  const std::size_t looked_at =
      std::min(static_cast<std::size_t>(std::max(0, options.images)), images.size());
  std::vector<RankingImage> out;
  for (std::size_t i = 0; i < looked_at; ++i) {
    const AspectImage& image = images[i * images.size() / looked_at];
    out.push_back({image.width, image.height, image.edges, VotingFragments(image, options.votes)});
  }
  return out;
}

PartValues PackedValues(std::span<const RankingImage> images,
                        std::span<const PackedIndex* const> indices,
                        const AspectVoteOptions& options,
                        std::span<const std::uint8_t> wanted,
                        const StopRequested& stop) {
  const Sides sides(indices, wanted);
  std::vector<BestVotes> of_images;
  PartValues out;
  for (const RankingImage& image : images) {
    of_images.push_back(BestOfImage(image, sides, options, stop));
    for (const auto& [part, vote] : of_images.back()) out.parts.push_back(part);
  }
  std::sort(out.parts.begin(), out.parts.end());
  out.parts.erase(std::unique(out.parts.begin(), out.parts.end()), out.parts.end());
  for (const BestVotes& best : of_images) {
    std::vector<float>& values = out.values.emplace_back(out.parts.size(), 0.0f);
    for (std::size_t k = 0; k < out.parts.size(); ++k) {
      const auto found = best.find(out.parts[k]);
      if (found != best.end()) values[k] = found->second.value;
    }
  }
  return out;
}

int MatchesOfShard(int max_matches, int shards) {
  return shards <= 1 ? max_matches : (max_matches + shards - 1) / shards;
}

PartValues LeaveBest(const PartValues& all, int most) {
  const std::size_t parts = all.parts.size();
  std::vector<float> sum(parts, 0.0f);
  for (const std::vector<float>& values : all.values) {
    std::transform(values.begin(), values.end(), sum.begin(), sum.begin(), std::plus<>());
  }
  std::vector<char> kept(parts, 0);
  const auto keep = [&](const std::vector<float>& values) {
    std::vector<std::uint32_t> order(parts);
    std::iota(order.begin(), order.end(), 0u);
    const std::size_t n = std::min(parts, static_cast<std::size_t>(std::max(0, most)));
    std::partial_sort(order.begin(),
                      order.begin() + static_cast<std::ptrdiff_t>(n),
                      order.end(),
                      [&](std::uint32_t a, std::uint32_t b) {
                        return values[a] != values[b] ? values[a] > values[b] : a < b;
                      });
    for (std::size_t i = 0; i < n && values[order[i]] > 0; ++i) kept[order[i]] = 1;
  };
  keep(sum);
  for (const std::vector<float>& values : all.values) keep(values);
  PartValues out;
  out.values.resize(all.values.size());
  for (std::size_t k = 0; k < parts; ++k) {
    if (kept[k] == 0) continue;
    out.parts.push_back(all.parts[k]);
    for (std::size_t i = 0; i < all.values.size(); ++i) out.values[i].push_back(all.values[i][k]);
  }
  return out;
}

}  // namespace horopter
