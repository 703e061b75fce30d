#include "tests/diagnose/true_matches.h"

#include <algorithm>
#include <cmath>

#include "tests/diagnose/feature_report.h"

namespace horopter {
namespace {

constexpr int kPerInstance = 100000;  // labels of one instance
constexpr double kNearPx = 2.0;
constexpr double kMaxAngleRad = 0.0873;
constexpr double kLabelledShare = 0.7;

// Share of the segment that has a sample of the edge beside it; samples are about 1 px apart.
double ShareCovered(const Segment& segment, const TrueEdge& edge) {
  const double length = segment.Length();
  const Eigen::Vector2d u = (segment.end - segment.start) / length;
  std::vector<bool> covered(static_cast<size_t>(std::max(1.0, std::round(length))), false);
  for (size_t k = 0; k < edge.points.size(); ++k) {
    const Eigen::Vector2d q = edge.points[k] - segment.start;
    const double along = u.dot(q);
    if (along < 0.0 || along >= length) continue;
    if (std::abs(u.x() * q.y() - u.y() * q.x()) > kNearPx) continue;
    const Eigen::Vector2d& t = edge.tangents[k];
    if (std::abs(u.x() * t.y() - u.y() * t.x()) > std::sin(kMaxAngleRad)) continue;
    for (int d = -1; d <= 1; ++d) {
      const int at = static_cast<int>(along) + d;
      if (at >= 0 && at < static_cast<int>(covered.size())) covered[at] = true;
    }
  }
  return static_cast<double>(std::count(covered.begin(), covered.end(), true)) /
         static_cast<double>(covered.size());
}

}  // namespace

int InstanceOf(FeatureLabel label) {
  return label / kPerInstance;
}

FeatureLabels LabelFeatures(const ImageFeatures& features, const TrueView& truth) {
  FeatureLabels labels;
  for (const Segment& segment : features.segments) {
    FeatureLabel label = kUnknownFeature;
    double best = kLabelledShare;
    for (const TrueEdge& edge : truth.edges) {
      if (edge.kind != CurveKind::kLine) continue;
      const double share = ShareCovered(segment, edge);
      if (share < best) continue;
      best = share;
      label = edge.instance * kPerInstance + edge.edge;
    }
    labels.segments.push_back(label);
  }
  for (const Junction& junction : features.junctions) {
    FeatureLabel label = kUnknownFeature;
    double best = kCornerPx;
    for (const TrueCorner& corner : truth.corners) {
      const double d = (junction.point - corner.point).norm();
      if (d >= best) continue;
      best = d;
      label = corner.instance * kPerInstance + corner.vertex;
    }
    labels.junctions.push_back(label);
  }
  return labels;
}

}  // namespace horopter
