#include "tests/diagnose/match_report.h"

#include <Eigen/Geometry>
#include <Eigen/LU>
#include <algorithm>
#include <cmath>

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

bool IsMatched(const MatchingResult& matching,
               int view_a,
               int view_b,
               const Eigen::Vector2d& corner_a,
               const Eigen::Vector2d& corner_b,
               const std::vector<ImageFeatures>& features) {
  for (const PairGeometry& pair : matching.pairs) {
    if (pair.view_a != view_a || pair.view_b != view_b) {
      continue;
    }
    for (const JunctionMatch& match : pair.matches) {
      if ((features[view_a].junctions[match.junction_a].point - corner_a).norm() < kCornerPx &&
          (features[view_b].junctions[match.junction_b].point - corner_b).norm() < kCornerPx) {
        return true;
      }
    }
  }
  return false;
}

}  // namespace

MatchFinding CompareMatches(const MatchingResult& matching,
                            const BopScene& scene,
                            const std::vector<ImageFeatures>& features,
                            const std::vector<TrueView>& truth) {
  MatchFinding finding;
  for (const PairGeometry& pair : matching.pairs) {
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
    for (const TrueCorner& a : truth[v].corners) {
      for (const TrueCorner& b : truth[v + 1].corners) {
        if (a.instance != b.instance || a.vertex != b.vertex) {
          continue;
        }
        const int i = static_cast<int>(v);
        ++finding.shared_corners;
        finding.corners_matched += IsMatched(matching, i, i + 1, a.point, b.point, features) ||
                                           IsMatched(matching, i + 1, i, b.point, a.point, features)
                                       ? 1
                                       : 0;
      }
    }
  }
  return finding;
}

}  // namespace horopter
