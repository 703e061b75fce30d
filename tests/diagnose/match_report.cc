#include "tests/diagnose/match_report.h"

#include <Eigen/Geometry>
#include <Eigen/LU>
#include <algorithm>
#include <cmath>
#include <map>
#include <set>
#include <utility>

#include "tests/diagnose/true_matches.h"

namespace horopter {
namespace {

constexpr double kEpipolarPx = 2.0;

Eigen::Vector2d Undistort(const BopImage& image, const Eigen::Vector2d& pixel) {
  const PinholeCamera& c = image.camera;
  const Eigen::Vector2d distorted((pixel.x() - c.cx) / c.focal_px, (pixel.y() - c.cy) / c.focal_px);
  Eigen::Vector2d n = distorted;
  for (int round = 0; round < 10; ++round) {
    n = distorted / (1.0 + c.k1 * n.squaredNorm());
  }
  return {c.focal_px * n.x() + c.cx, c.focal_px * n.y() + c.cy};
}

// x_b^T F x_a = 0 for undistorted pixels.
Eigen::Matrix3d TrueF(const BopImage& a, const BopImage& b) {
  const Rigid3 b_from_a = b.camera_from_world * a.camera_from_world.Inverse();
  Eigen::Matrix3d cross;
  cross << 0, -b_from_a.t.z(), b_from_a.t.y(), b_from_a.t.z(), 0, -b_from_a.t.x(), -b_from_a.t.y(),
      b_from_a.t.x(), 0;
  return b.camera.K().inverse().transpose() * cross * b_from_a.R * a.camera.K().inverse();
}

double LineDistance(const Eigen::Vector3d& line, const Eigen::Vector2d& p) {
  return std::abs(line.dot(p.homogeneous())) / line.head<2>().norm();
}

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
                            const BopScene& scene,
                            const std::vector<ImageFeatures>& features,
                            const std::vector<TrueView>& truth) {
  MatchFinding finding;
  std::vector<FeatureLabels> labels;
  for (size_t v = 0; v < truth.size(); ++v) labels.push_back(LabelFeatures(features[v], truth[v]));
  for (const PairGeometry& pair : matching.pairs) {
    if (!pair.F) continue;
    const BopImage& a = scene.images[pair.view_a];
    const BopImage& b = scene.images[pair.view_b];
    const Eigen::Matrix3d F = TrueF(a, b);
    for (const JunctionMatch& match : pair.matches) {
      const Eigen::Vector2d xa =
          Undistort(a, features[pair.view_a].junctions[match.junction_a].point);
      const Eigen::Vector2d xb =
          Undistort(b, features[pair.view_b].junctions[match.junction_b].point);
      const double in_b = LineDistance(F * xa.homogeneous(), xb);
      const double in_a = LineDistance(F.transpose() * xb.homogeneous(), xa);
      ++finding.matches;
      finding.matches_right += std::max(in_a, in_b) <= kEpipolarPx ? 1 : 0;
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
  CountTracks(matching, labels, scene.images.front().instances.size(), &finding);
  return finding;
}

}  // namespace horopter
