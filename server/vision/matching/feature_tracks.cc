#include "server/vision/matching/feature_tracks.h"

#include <algorithm>
#include <map>
#include <numeric>
#include <tuple>

#include "server/base/stop_scope.h"

namespace horopter {
namespace {

constexpr int kLinksPerLook = 1024;  // at the stop flag

}  // namespace

std::vector<FeatureTrack> JoinTracks(std::vector<TrackLink> links) {
  std::sort(links.begin(), links.end(), [](const TrackLink& x, const TrackLink& y) {
    return std::make_tuple(-x.log_ratio, x.view_a, x.feature_a, x.view_b, x.feature_b) <
           std::make_tuple(-y.log_ratio, y.view_a, y.feature_a, y.view_b, y.feature_b);
  });
  std::map<std::pair<int, int>, int> ids;  // (view, feature)
  std::vector<int> parent;
  std::vector<std::map<int, int>> members;  // of each root: view -> feature
  const auto id_of = [&](int view, int feature) {
    const auto [it, added] = ids.emplace(std::pair(view, feature), static_cast<int>(parent.size()));
    if (added) {
      parent.push_back(it->second);
      members.push_back({{view, feature}});
    }
    return it->second;
  };
  const auto root_of = [&](int i) {
    while (parent[i] != i) i = parent[i] = parent[parent[i]];
    return i;
  };
  StopPacer pacer(kLinksPerLook);
  for (const TrackLink& link : links) {
    pacer.Step();
    int a = root_of(id_of(link.view_a, link.feature_a));
    int b = root_of(id_of(link.view_b, link.feature_b));
    if (a == b) continue;
    if (members[a].size() < members[b].size()) std::swap(a, b);
    const bool conflict = std::any_of(members[b].begin(), members[b].end(), [&](const auto& m) {
      return members[a].count(m.first) > 0;
    });
    if (conflict) continue;
    parent[b] = a;
    members[a].insert(members[b].begin(), members[b].end());
    members[b].clear();
  }
  std::vector<FeatureTrack> tracks;
  for (const std::map<int, int>& track : members) {
    if (track.size() < 2) continue;
    tracks.emplace_back();
    for (const auto& [view, feature] : track) tracks.back().features.push_back({view, feature});
  }
  std::sort(tracks.begin(), tracks.end(), [](const FeatureTrack& x, const FeatureTrack& y) {
    const auto& a = x.features.front();
    const auto& b = y.features.front();
    return std::tie(a.view, a.feature) < std::tie(b.view, b.feature);
  });
  return tracks;
}

std::vector<TrackLink> JunctionLinks(std::span<const PairGeometry> pairs, bool accepted_only) {
  std::vector<TrackLink> links;
  for (const PairGeometry& pair : pairs) {
    if (accepted_only && !pair.F) continue;
    for (const JunctionMatch& m : pair.matches)
      links.push_back({pair.view_a, m.junction_a, pair.view_b, m.junction_b, m.log_ratio});
  }
  return links;
}

std::vector<TrackLink> SegmentLinks(std::span<const PairGeometry> pairs, bool accepted_only) {
  std::vector<TrackLink> links;
  for (const PairGeometry& pair : pairs) {
    if (accepted_only && !pair.F) continue;
    for (const SegmentMatch& m : pair.segments)
      links.push_back({pair.view_a, m.segment_a, pair.view_b, m.segment_b, m.log_ratio});
  }
  return links;
}

void JoinAllTracks(MatchingResult* result) {
  result->junction_tracks = JoinTracks(JunctionLinks(result->pairs, /*accepted_only=*/true));
  result->segment_tracks = JoinTracks(SegmentLinks(result->pairs, /*accepted_only=*/true));
  result->counts["junction_tracks"] = static_cast<double>(result->junction_tracks.size());
  result->counts["segment_tracks"] = static_cast<double>(result->segment_tracks.size());
  double with_F = 0.0, matches = 0.0;
  for (const PairGeometry& pair : result->pairs) {
    with_F += pair.F.has_value();
    matches += static_cast<double>(pair.matches.size());
  }
  result->counts["pairs_with_epipolar"] = with_F;
  result->counts["junction_matches"] = matches;
}

}  // namespace horopter
