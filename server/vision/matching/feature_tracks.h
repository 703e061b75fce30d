// Pairwise matches joined into tracks over all views.
#pragma once

#include <span>
#include <vector>

#include "server/vision/matching/matching.h"

namespace horopter {

// One match of a pair to be joined.
struct TrackLink {
  int view_a = -1, feature_a = -1;
  int view_b = -1, feature_b = -1;
  double log_ratio = 0.0;  // of being right: likelier links are joined first
};

// Union of the links, likeliest first. A link that would give a track two features of one view is
// in conflict and left out, so one wrong match does not cost both tracks. Tracks in the order of
// their first feature, features by view. The same feature is never in two tracks.
std::vector<FeatureTrack> JoinTracks(std::vector<TrackLink> links);

// The matches of a matching result as links; `accepted_only`: of pairs with an F.
std::vector<TrackLink> JunctionLinks(std::span<const PairGeometry> pairs, bool accepted_only);
std::vector<TrackLink> SegmentLinks(std::span<const PairGeometry> pairs, bool accepted_only);

// Rejoins the tracks of a result from its pairs with an F, and counts both.
void JoinAllTracks(MatchingResult* result);

}  // namespace horopter
