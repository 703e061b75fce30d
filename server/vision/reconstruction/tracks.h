// Pairwise matches joined into tracks over the views of one component.
#pragma once

#include <Eigen/Core>
#include <span>
#include <vector>

#include "server/vision/matching/matching.h"

namespace horopter {

struct TrackObservation {
  int view = -1;
  int junction = -1;                                // -1: a texture point of the plane
  Eigen::Vector2d point = Eigen::Vector2d::Zero();  // pixels
};

// One scene point as seen in >= 2 views, at most once in each.
struct Track {
  std::vector<TrackObservation> observations;
  bool on_plane = false;  // given by the plane's homographies
};

// Texture tracks of the plane within a component, longest first, thinned to about max_tracks spread
// over the images.
std::vector<Track> PlaneTracks(const MatchingResult& matching, int component, int max_tracks);

// The matching's junction tracks, as far as the views of a component see them.
std::vector<Track> JunctionTracks(const MatchingResult& matching,
                                  std::span<const ImageFeatures> features,
                                  int component);

}  // namespace horopter
