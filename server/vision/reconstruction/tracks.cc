#include "server/vision/reconstruction/tracks.h"

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <map>
#include <set>
#include <tuple>

#include "server/base/union_find.h"

namespace horopter {
namespace {

constexpr double kCellPx = 16.0;  // thinning: tracks per cell of the first view they are seen in

// Groups observations by their root; groups that see a view twice are dropped.
std::vector<Track> Collect(UnionFind* sets,
                           const std::vector<TrackObservation>& observations,
                           bool on_plane) {
  std::map<int, Track> by_root;
  for (int i = 0; i < sets->size(); ++i)
    by_root[sets->Find(i)].observations.push_back(observations[i]);
  std::vector<Track> tracks;
  for (auto& [root, track] : by_root) {
    std::set<int> views;
    for (const TrackObservation& o : track.observations) views.insert(o.view);
    if (views.size() < 2 || views.size() != track.observations.size()) continue;
    track.on_plane = on_plane;
    tracks.push_back(std::move(track));
  }
  return tracks;
}

}  // namespace

std::vector<Track> PlaneTracks(const MatchingResult& matching, int component, int max_tracks) {
  // The same keypoint has the same coordinates in every pair it takes part in.
  std::map<std::tuple<int, std::int64_t, std::int64_t>, int> ids;
  UnionFind sets;
  std::vector<TrackObservation> observations;
  const auto id_of = [&](int view, const Eigen::Vector2d& x) {
    const auto key = std::make_tuple(view, std::llround(x.x() * 64.0), std::llround(x.y() * 64.0));
    const auto it = ids.find(key);
    if (it != ids.end()) return it->second;
    observations.push_back({view, -1, x});
    return ids[key] = sets.Add();
  };
  for (const PlaneHomography& plane : matching.planes) {
    if (matching.component[plane.view_a] != component) continue;
    if (matching.component[plane.view_b] != component) continue;
    for (size_t i = 0; i < plane.inliers_a.size(); ++i) {
      sets.Join(id_of(plane.view_a, plane.inliers_a[i]), id_of(plane.view_b, plane.inliers_b[i]));
    }
  }
  std::vector<Track> tracks = Collect(&sets, observations, true);
  std::stable_sort(tracks.begin(), tracks.end(), [](const Track& x, const Track& y) {
    return x.observations.size() > y.observations.size();
  });
  // Round by round one more track per cell, so that dense texture does not crowd out the rest.
  std::map<std::tuple<int, int, int>, int> used;
  std::vector<std::vector<Track>> rounds;
  for (Track& track : tracks) {
    const TrackObservation& o = track.observations.front();
    const int round = used[{o.view,
                            static_cast<int>(o.point.x() / kCellPx),
                            static_cast<int>(o.point.y() / kCellPx)}]++;
    if (round >= static_cast<int>(rounds.size())) rounds.resize(round + 1);
    rounds[round].push_back(std::move(track));
  }
  std::vector<Track> thinned;
  for (std::vector<Track>& round : rounds) {
    for (Track& track : round) {
      if (static_cast<int>(thinned.size()) >= max_tracks) return thinned;
      thinned.push_back(std::move(track));
    }
  }
  return thinned;
}

std::vector<Track> JunctionTracks(const MatchingResult& matching,
                                  std::span<const ImageFeatures> features,
                                  int component) {
  std::vector<Track> tracks;
  for (const FeatureTrack& joined : matching.junction_tracks) {
    Track track;
    for (const FeatureTrack::Feature& f : joined.features) {
      if (matching.component[f.view] != component) continue;
      track.observations.push_back(
          {f.view, f.feature, features[f.view].junctions[f.feature].point});
    }
    if (track.observations.size() >= 2) tracks.push_back(std::move(track));
  }
  return tracks;
}

}  // namespace horopter
