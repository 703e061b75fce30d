// The matching's features as tracks that a reconstruction takes: points and infinite lines.
#pragma once

#include <span>
#include <vector>

#include "server/vision/matching/matching.h"
#include "server/vision/reconstruction/multiview_tracks.h"

namespace horopter {

struct MatchedTracks {
  MultiviewTracks tracks;              // pixels, as the images have them
  std::vector<FeatureTrack> points;    // of each point, its junctions
  std::vector<FeatureTrack> segments;  // of each line, its segments
};

// Which pairs' matches make tracks.
enum class MatchedPairs {
  kWithEpipolarGeometry,
  // Those first; then matches that similarity and neighbourhood alone gave extend them where
  // nothing contradicts: a pair whose few matches determine no F may still link its views by way of
  // others. Wrong ones among them are left to whoever reconstructs.
  kAll,
};

// Tracks over all views. Segments in fine texture are left out. At most kMaxFeatures of each kind,
// longest tracks first.
MatchedTracks TracksOfMatches(const MatchingResult& matching,
                              MatchedPairs pairs,
                              std::span<const ImageFeatures> features,
                              std::span<const ImageSize> sizes);

}  // namespace horopter
