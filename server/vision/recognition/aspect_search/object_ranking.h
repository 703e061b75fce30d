// Which objects of a large catalog images may show, by votes of a few fragments of each: the search
// with all their aspects (find_aspects.h) is for these alone.
#pragma once

#include <cstdint>
#include <span>
#include <vector>

#include "server/base/stop_token.h"
#include "server/vision/recognition/aspect_search/aspect_votes.h"
#include "server/vision/recognition/aspects/aspect_image.h"
#include "server/vision/recognition/aspects/fragment_index.h"

namespace horopter {

// Of each object, for an index that ranks: up to some 200 views over the sphere, two fragments of
// each, more of fewer views.
inline constexpr FragmentChoice kRankingChoice{.points = kFirstVotePoints,
                                               .view_spacing_rad = 0.2,
                                               .fragments = 400,
                                               .pairs = false,
                                               .ellipses = false};

struct ObjectRankingOptions {
  AspectVoteOptions votes;
  int objects = 48;  // that are listed; more: fewer missed, slower search
  // Images that are looked at, evenly chosen: an object worth an answer is seen in several.
  int images = 3;
  double of_single_images = 0.5;  // share of the list that goes to the best of each image
  ObjectRankingOptions();
};

// Part numbers of the index, best first: those with the largest sum over the images of their best
// vote's rank, and in between, in turn, the best of each single image. All that are wanted, in any
// order, while they are not more than asked for. `wanted`: as for VoteForAspects.
std::vector<int> RankObjects(std::span<const AspectImage> images,
                             const FragmentIndex& index,
                             const ObjectRankingOptions& options = {},
                             const StopRequested& stop = {},
                             std::span<const std::uint8_t> wanted = {});

}  // namespace horopter
