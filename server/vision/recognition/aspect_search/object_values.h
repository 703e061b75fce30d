// What images say of the parts of an index, one by one, and the list that follows from it: the two
// halves of RankObjects, for parts that are shared out over several indices (ADR 98).
#pragma once

#include <cstdint>
#include <span>
#include <vector>

#include "server/vision/recognition/aspect_search/object_ranking.h"

namespace horopter {

// What the best vote of each part says in each of the images that are looked at, [image][part]; 0:
// none. `wanted`: as for VoteForAspects. Parts that are shared out over several indices have in
// each what they would have in one, and more where one index's max_matches leave them out.
std::vector<std::vector<float>> ObjectValues(std::span<const AspectImage> images,
                                             const FragmentIndex& index,
                                             const ObjectRankingOptions& options = {},
                                             const StopRequested& stop = {},
                                             std::span<const std::uint8_t> wanted = {});

// The parts to be listed by their values, best first (RankObjects). values: [image][part], of one
// index or of several one after the other.
std::vector<int> BestObjects(std::span<const std::vector<float>> values,
                             const ObjectRankingOptions& options = {});

}  // namespace horopter
