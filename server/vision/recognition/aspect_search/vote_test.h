// What a vote for an aspect is tested by: the fragments of an image that vote, and whether the
// similarity that one of them means finds edges where the aspect has some.
#pragma once

#include <Eigen/Core>
#include <cstdint>
#include <optional>
#include <span>
#include <vector>

#include "server/vision/recognition/aspect_search/aspect_votes.h"
#include "server/vision/recognition/aspect_search/vote_support.h"
#include "server/vision/recognition/aspects/contour_fragments.h"

namespace horopter {

// The pieces of the image's contours that vote.
std::vector<ContourFragment> VotingFragments(const AspectImage& image,
                                             const AspectVoteOptions& options);

// The direction of a fragment that is matched: that of its pieces in the mean.
IndexedTurn TurnOf(const ContourFragment& fragment);

// Of this size, turning the model's direction into the image's, and a point of the aspect, in
// diameters, to its place.
Similarity Placed(float size,
                  const IndexedTurn& image,
                  const IndexedTurn& model,
                  const Eigen::Vector2f& from,
                  const Eigen::Vector2f& to);

// The tests of one image's votes, from the cheapest on. It remembers what was tested: other lengths
// of a contour lead to the same similarity again. Not thread-safe; image, maps and options must
// outlive it.
class VoteTest {
 public:
  VoteTest(const AspectImage& image, const CoarseMaps& maps, const AspectVoteOptions& options)
      : image_(image), maps_(maps), options_(options) {}

  // Whether a part's diameter may be so many pixels.
  bool IsSoughtSize(float size) const {
    const float width = static_cast<float>(image_.width);
    return size >= options_.min_size_px && size <= options_.max_size_share * width;
  }

  // The support of the first points where it is enough and the aspect's centre in the image.
  std::optional<float> SupportOfFirst(const FirstVotePoints& first, const Similarity& s);

  struct Accepted {
    Similarity at;
    float support = 0.0f;
    float gain = 0.0f;  // rank = edge length (px) x gain
  };
  // Tests an aspect whose first points have `support` with all of its points, after the similarity
  // was made better about `pivot`. `number`: of the aspect, by which it is remembered.
  std::optional<Accepted> Judge(std::uint32_t number,
                                const FirstVotePoints& first,
                                std::span<const VotePoint> points,
                                const Eigen::Vector2f& pivot,
                                float support,
                                Similarity s);

  std::int64_t tests_16() const { return tests_16_; }
  std::int64_t climbs() const { return climbs_; }

 private:
  static constexpr int kFirstPoints = 6, kSecondPoints = kFirstVotePoints;  // looked at in steps
  static constexpr std::uint32_t kSeenSlots = 1u << 15;                     // of hashes; for memory

  int Tau8(float size) const;
  float ExcessChance(std::span<const VotePoint> points, const Similarity& s) const;
  // A table of the last ones of each hash: what it forgets is only tested once more.
  bool IsNew(std::uint32_t number, const Similarity& s);
  // Better size and turn about a point that stays.
  Similarity Climb(const FirstVotePoints& points,
                   const Eigen::Vector2f& pivot,
                   float best,
                   Similarity s) const;

  const AspectImage& image_;
  const CoarseMaps& maps_;
  const AspectVoteOptions& options_;
  std::vector<std::uint32_t> seen_ = std::vector<std::uint32_t>(kSeenSlots, 0);
  std::int64_t tests_16_ = 0, climbs_ = 0;
};

}  // namespace horopter
