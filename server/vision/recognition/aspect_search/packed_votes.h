// Which of very many parts images may show, by packed fragments, as a ranker says it: the same
// votes as those of object_ranking.h.
#pragma once

#include <cstdint>
#include <span>
#include <vector>

#include "server/base/stop_token.h"
#include "server/vision/recognition/aspect_search/object_ranking.h"
#include "server/vision/recognition/aspects/aspect_image.h"
#include "server/vision/recognition/aspects/contour_fragments.h"
#include "server/vision/recognition/aspects/packed_index.h"

namespace horopter {

// What a ranker needs of an image: its edges, of which the maps are made again, and the pieces of
// its contours that vote.
struct RankingImage {
  int width = 0, height = 0;  // working pixels
  std::vector<ImageEdgePoint> edges;
  std::vector<ContourFragment> fragments;  // key, centre, pivot, spread and chord
};

// Of the images that are looked at, evenly chosen (ObjectRankingOptions::images).
std::vector<RankingImage> RankingImages(std::span<const AspectImage> images,
                                        const ObjectRankingOptions& options = {});

// What the best vote of each part says, for parts that some image has a vote of.
struct PartValues {
  std::vector<std::uint32_t> parts;        // ascending
  std::vector<std::vector<float>> values;  // [image][k] of parts[k]; 0: none
};

// Some indices searched as one: part n of index i has the number n + the parts before it. `wanted`:
// a flag for each part; empty: all. What was found so far when stopped. The same for every number
// of threads.
PartValues PackedValues(std::span<const RankingImage> images,
                        std::span<const PackedIndex* const> indices,
                        const AspectVoteOptions& options,
                        std::span<const std::uint8_t> wanted = {},
                        const StopRequested& stop = {});

// Matches of a fragment that each of so many shards tests: together as many as one index does. They
// are not quite the same: an index's nearest keys do not fall into shards evenly.
int MatchesOfShard(int max_matches, int shards);

// Those of them that can be in a list of `most` parts that BestObjects makes of these and any
// others: the best of the sum and of each image.
PartValues LeaveBest(const PartValues& all, int most);

}  // namespace horopter
