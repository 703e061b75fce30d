#include "tests/diagnose/match_report.h"

#include <algorithm>
#include <map>
#include <set>
#include <utility>

#include "tests/diagnose/true_matches.h"
#include "tests/diagnose/true_transfer.h"

namespace horopter {
namespace {

// Labels found in both views, and those of the matches whose two features carry the same one.
struct Shared {
  std::set<FeatureLabel> found, matched;
};

Shared ShareOf(const std::vector<FeatureLabel>& a,
               const std::vector<FeatureLabel>& b,
               const std::vector<std::pair<int, int>>& matches) {
  Shared shared;
  const std::set<FeatureLabel> in_b(b.begin(), b.end());
  for (FeatureLabel label : a) {
    if (label != kUnknownFeature && in_b.count(label)) shared.found.insert(label);
  }
  for (const auto& [i, j] : matches) {
    if (a[i] != kUnknownFeature && a[i] == b[j]) shared.matched.insert(a[i]);
  }
  return shared;
}

// The label that most of a track's features carry, when at least three do.
FeatureLabel LabelOf(const FeatureTrack& track,
                     const std::vector<FeatureLabels>& labels,
                     std::vector<FeatureLabel> FeatureLabels::*kind) {
  std::map<FeatureLabel, int> votes;
  for (const FeatureTrack::Feature& f : track.features) ++votes[(labels[f.view].*kind)[f.feature]];
  votes.erase(kUnknownFeature);
  for (const auto& [label, count] : votes) {
    if (count >= 3) return label;
  }
  return kUnknownFeature;
}

void CountTracks(const MatchingResult& matching,
                 const std::vector<FeatureLabels>& labels,
                 size_t parts,
                 MatchFinding* finding) {
  std::vector<std::set<FeatureLabel>> tracked(2 * parts);
  const auto count = [&](const std::vector<FeatureTrack>& tracks,
                         std::vector<FeatureLabel> FeatureLabels::*kind,
                         size_t slot) {
    for (const FeatureTrack& track : tracks) {
      const FeatureLabel label = LabelOf(track, labels, kind);
      if (label != kUnknownFeature) tracked[2 * InstanceOf(label) + slot].insert(label);
    }
  };
  count(matching.junction_tracks, &FeatureLabels::junctions, 0);
  count(matching.segment_tracks, &FeatureLabels::segments, 1);
  for (size_t k = 0; k < parts; ++k)
    finding->tracked.push_back(static_cast<int>(tracked[2 * k].size() + tracked[2 * k + 1].size()));
}

}  // namespace

MatchFinding CompareMatches(const MatchingResult& matching,
                            const TrueWorld& world,
                            const TrueModels& models,
                            const std::vector<ImageFeatures>& features,
                            const std::vector<TrueView>& truth) {
  MatchFinding finding;
  std::vector<FeatureLabels> labels;
  for (size_t v = 0; v < truth.size(); ++v) labels.push_back(LabelFeatures(features[v], truth[v]));
  const TrueTransfer transfer(world, models);
  for (const PairGeometry& pair : matching.pairs) {
    if (!pair.F) continue;
    for (const JunctionMatch& match : pair.matches) {
      const MatchTruth judged =
          transfer.Judge(pair.view_a,
                         features[pair.view_a].junctions[match.junction_a].point,
                         pair.view_b,
                         features[pair.view_b].junctions[match.junction_b].point);
      if (judged == MatchTruth::kUnknown) continue;
      ++finding.matches;
      finding.matches_right += judged == MatchTruth::kRight ? 1 : 0;
    }
  }
  for (size_t v = 0; v + 1 < truth.size(); ++v) {
    std::vector<std::pair<int, int>> junctions, segments;
    for (const PairGeometry& pair : matching.pairs) {
      if (!pair.F || pair.view_a != static_cast<int>(v) || pair.view_b != static_cast<int>(v) + 1)
        continue;
      for (const JunctionMatch& m : pair.matches)
        junctions.emplace_back(m.junction_a, m.junction_b);
      for (const SegmentMatch& m : pair.segments) segments.emplace_back(m.segment_a, m.segment_b);
    }
    const Shared corners = ShareOf(labels[v].junctions, labels[v + 1].junctions, junctions);
    const Shared edges = ShareOf(labels[v].segments, labels[v + 1].segments, segments);
    finding.shared_corners += static_cast<int>(corners.found.size());
    finding.corners_matched += static_cast<int>(corners.matched.size());
    finding.shared_edges += static_cast<int>(edges.found.size());
    finding.edges_matched += static_cast<int>(edges.matched.size());
  }
  CountTracks(matching, labels, world.scene.images.front().instances.size(), &finding);
  return finding;
}

}  // namespace horopter
