#include "tests/diagnose/feature_report.h"

#include <algorithm>
#include <cmath>

namespace horopter {
namespace {

constexpr double kNearPx = 2.0;
constexpr double kMaxAngle = 5.0 * M_PI / 180.0;
constexpr int kMinPieceSamples = 4;

bool Parallel(const Eigen::Vector2d& a, const Eigen::Vector2d& b) {
  return std::abs(a.x() * b.y() - a.y() * b.x()) <= std::sin(kMaxAngle);
}

bool SegmentCovers(const Segment& segment,
                   const Eigen::Vector2d& point,
                   const Eigen::Vector2d& tangent) {
  const Eigen::Vector2d d = segment.end - segment.start;
  const double length = d.norm();
  const Eigen::Vector2d u = d / length;
  const Eigen::Vector2d q = point - segment.start;
  const double s = std::clamp(u.dot(q), 0.0, length);
  return (q - s * u).norm() <= kNearPx && Parallel(u, tangent);
}

// Nearest point by the parameter of the closest direction: exact enough for 2 px.
bool ArcCovers(const EllipseArc& arc,
               const Eigen::Vector2d& point,
               const Eigen::Vector2d& tangent) {
  const double c = std::cos(arc.angle_rad), s = std::sin(arc.angle_rad);
  const Eigen::Vector2d q = point - arc.center;
  const Eigen::Vector2d local(c * q.x() + s * q.y(), -s * q.x() + c * q.y());
  double t = std::atan2(local.y() * arc.semi_major_px, local.x() * arc.semi_minor_px);
  Eigen::Vector2d on, along;
  for (int round = 0; round < 4; ++round) {
    on = {arc.semi_major_px * std::cos(t), arc.semi_minor_px * std::sin(t)};
    along = {-arc.semi_major_px * std::sin(t), arc.semi_minor_px * std::cos(t)};
    if (along.squaredNorm() < 1e-9) {
      return false;
    }
    t += along.dot(local - on) / along.squaredNorm();
  }
  double from_start = std::fmod(t - arc.start_rad, 2.0 * M_PI);
  if (from_start < 0.0) {
    from_start += 2.0 * M_PI;
  }
  const Eigen::Vector2d direction =
      Eigen::Vector2d(c * along.x() - s * along.y(), s * along.x() + c * along.y()).normalized();
  return from_start <= arc.sweep_rad + 0.05 && (local - on).norm() <= kNearPx &&
         Parallel(direction, tangent);
}

EdgeFinding CompareEdge(const ImageFeatures& features, const TrueEdge& edge) {
  const size_t n = edge.points.size();
  std::vector<char> any(n, 0), arcs(n, 0), usable(n, 0);
  EdgeFinding finding;
  Eigen::Vector2d low = edge.points[0], high = edge.points[0];
  for (const Eigen::Vector2d& p : edge.points) {
    low = low.cwiseMin(p);
    high = high.cwiseMax(p);
  }
  low.array() -= kNearPx;
  high.array() += kNearPx;
  for (const Segment& segment : features.segments) {
    if ((segment.start.cwiseMax(segment.end).array() < low.array()).any() ||
        (segment.start.cwiseMin(segment.end).array() > high.array()).any()) {
      continue;
    }
    int covered = 0;
    for (size_t k = 0; k < n; ++k) {
      if (SegmentCovers(segment, edge.points[k], edge.tangents[k])) {
        any[k] = 1;
        usable[k] |= segment.in_texture ? 0 : 1;
        ++covered;
      }
    }
    // A chord of an arc is part of that piece.
    finding.pieces += covered >= kMinPieceSamples && segment.arc < 0 ? 1 : 0;
  }
  for (const EllipseArc& arc : features.arcs) {
    int covered = 0;
    for (size_t k = 0; k < n; ++k) {
      if (ArcCovers(arc, edge.points[k], edge.tangents[k])) {
        any[k] = arcs[k] = usable[k] = 1;
        ++covered;
      }
    }
    finding.pieces += covered >= kMinPieceSamples ? 1 : 0;
  }
  const auto share = [n](const std::vector<char>& flags) {
    return static_cast<double>(std::count(flags.begin(), flags.end(), 1)) / static_cast<double>(n);
  };
  finding.covered = share(any);
  finding.covered_by_arcs = share(arcs);
  finding.covered_usable = share(usable);
  return finding;
}

}  // namespace

FeatureFinding CompareFeatures(const ImageFeatures& features, const TrueView& truth) {
  FeatureFinding finding;
  for (const TrueEdge& edge : truth.edges) {
    finding.edges.push_back(CompareEdge(features, edge));
  }
  for (const TrueCorner& corner : truth.corners) {
    double best = 1e9;
    int index = -1;
    for (size_t j = 0; j < features.junctions.size(); ++j) {
      const double d = (features.junctions[j].point - corner.point).norm();
      if (d < best) {
        best = d;
        index = static_cast<int>(j);
      }
    }
    finding.corner_error_px.push_back(best);
    finding.nearest_junction.push_back(index);
  }
  finding.segments = static_cast<int>(features.segments.size());
  for (const Segment& segment : features.segments) {
    finding.segments_in_texture += segment.in_texture ? 1 : 0;
  }
  return finding;
}

}  // namespace horopter
