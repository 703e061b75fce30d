// What a ranker keeps of an object.
#pragma once

#include "server/vision/recognition/aspect_search/object_values.h"
#include "server/vision/recognition/aspect_search/packed_votes.h"
#include "server/vision/recognition/aspects/packed_piece.h"
#include "server/vision/recognition/object/prepared_object.h"

namespace horopter {

// Views and fragments of rankers: fewer than kRankingChoice, as 10^6 parts shall fit into four
// servers of 16 GB.
inline constexpr FragmentChoice kPackedChoice{.points = kFirstVotePoints,
                                              .view_spacing_rad = 0.25,
                                              .fragments = 256,
                                              .pairs = false,
                                              .ellipses = false};

// Empty of an object without aspects.
PackedPiece RankingPiece(const PreparedObject& object);

}  // namespace horopter
