#include "server/vision/reconstruction/matched_tracks.h"

#include <algorithm>

#include "server/vision/matching/feature_tracks.h"

namespace horopter {
namespace {

// Deviations of a corner's coordinates and of a segment's ends across it: what true cameras leave
// on the sets the matching was learned on is 0.4 - 0.6 px; blunted corners are the larger part.
constexpr double kJunctionSigmaPx = 0.7;
constexpr double kSegmentSigmaPx = 0.7;
// Added to the log-likelihood ratios of accepted pairs: these come first.
constexpr double kAccepted = 1e3;

template <typename Links>
std::vector<FeatureTrack> Join(const Links& links_of,
                               std::span<const PairGeometry> pairs,
                               MatchedPairs which) {
  std::vector<TrackLink> links;
  for (const PairGeometry& pair : pairs) {
    if (!pair.F && which == MatchedPairs::kWithEpipolarGeometry) continue;
    for (TrackLink link : links_of(std::span(&pair, 1), false)) {
      link.log_ratio += pair.F ? kAccepted : 0.0;
      links.push_back(link);
    }
  }
  std::vector<FeatureTrack> tracks = JoinTracks(std::move(links));
  if (tracks.size() > kMaxFeatures) {
    std::stable_sort(tracks.begin(), tracks.end(), [](const auto& x, const auto& y) {
      return x.features.size() > y.features.size();
    });
    tracks.resize(kMaxFeatures);
  }
  return tracks;
}

}  // namespace

MatchedTracks TracksOfMatches(const MatchingResult& matching,
                              MatchedPairs pairs,
                              std::span<const ImageFeatures> features,
                              std::span<const ImageSize> sizes) {
  MatchedTracks out;
  out.tracks.sizes.assign(sizes.begin(), sizes.end());
  out.points = Join(JunctionLinks, matching.pairs, pairs);
  out.segments = Join(SegmentLinks, matching.pairs, pairs);
  for (FeatureTrack& track : out.segments) {
    std::erase_if(track.features, [&](const FeatureTrack::Feature& f) {
      const Segment& s = features[f.view].segments[f.feature];
      return s.in_texture || s.start == s.end;
    });
  }
  std::erase_if(out.segments, [](const FeatureTrack& t) { return t.features.size() < 2; });
  for (const FeatureTrack& track : out.points) {
    for (const FeatureTrack::Feature& f : track.features) {
      out.tracks.point_observations.push_back({f.view,
                                               out.tracks.points,
                                               features[f.view].junctions[f.feature].point,
                                               kJunctionSigmaPx});
    }
    ++out.tracks.points;
  }
  for (const FeatureTrack& track : out.segments) {
    for (const FeatureTrack::Feature& f : track.features) {
      const Segment& s = features[f.view].segments[f.feature];
      out.tracks.line_observations.push_back(
          {f.view, out.tracks.lines, s.start, s.end, kSegmentSigmaPx});
    }
    ++out.tracks.lines;
  }
  return out;
}

}  // namespace horopter
