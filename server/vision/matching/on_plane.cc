#include "server/vision/matching/on_plane.h"

#include <Eigen/Dense>
#include <algorithm>
#include <cmath>

#include "server/vision/matching/homography.h"

namespace horopter {
namespace {

struct WarpedSegment {
  Eigen::Vector2d start, end;
};

bool Inside(const ImageFeatures& f, const Eigen::Vector2d& p) {
  return p.x() >= 0 && p.y() >= 0 && p.x() <= f.width - 1 && p.y() <= f.height - 1;
}

// A segment as what it is asked for: start, unit direction, length.
struct Straight {
  Eigen::Vector2d start, direction;
  double length = 0.0;
};

std::vector<Straight> StraightsOf(const ImageFeatures& features) {
  std::vector<Straight> straights;
  for (const Segment& s : features.segments) {
    const double length = s.Length();
    if (length > 0.0) straights.push_back({s.start, (s.end - s.start) / length, length});
  }
  return straights;
}

bool IsCopy(const WarpedSegment& w, const Straight& s, const OnPlaneOptions& options) {
  const Eigen::Vector2d& d = s.direction;
  const Eigen::Vector2d n(-d.y(), d.x());
  if (std::abs(n.dot(w.start - s.start)) > options.max_distance_px) return false;
  if (std::abs(n.dot(w.end - s.start)) > options.max_distance_px) return false;
  const Eigen::Vector2d v = w.end - w.start;
  const double warped_length = v.norm();
  if (std::abs(n.dot(v)) > std::sin(options.max_angle_rad) * warped_length) return false;
  double t0 = d.dot(w.start - s.start), t1 = d.dot(w.end - s.start);
  if (t0 > t1) std::swap(t0, t1);
  const double overlap = std::min(t1, s.length) - std::max(t0, 0.0);
  return overlap >= options.min_overlap * warped_length;
}

// Angle between the segment and the epipolar line through its middle, view b.
double EpipolarAngle(const WarpedSegment& w, const Eigen::Vector3d& epipole) {
  const Eigen::Vector2d middle = 0.5 * (w.start + w.end);
  const Eigen::Vector2d to_epipole = epipole.head<2>() - epipole.z() * middle;
  const Eigen::Vector2d d = w.end - w.start;
  const double n = to_epipole.norm() * d.norm();
  if (!(n > 0.0)) return 0.0;
  return std::asin(std::min(1.0, std::abs(d.x() * to_epipole.y() - d.y() * to_epipole.x()) / n));
}

struct Judge {
  int view = -1;
  Eigen::Matrix3d judge_from_view;
  Eigen::Vector3d epipole;  // in the judge's image
};

std::vector<Judge> JudgesOf(int view, const MatchingResult& matching) {
  std::vector<Judge> judges;
  for (const PairGeometry& pair : matching.pairs) {
    if (!pair.F || (pair.view_a != view && pair.view_b != view)) continue;
    const int other = pair.view_a == view ? pair.view_b : pair.view_a;
    if (matching.component[view] < 0 || matching.component[view] != matching.component[other]) {
      continue;
    }
    // x_b' F x_a = 0: the epipole in b is F's left null vector, in a its right one.
    Eigen::Matrix3d F = *pair.F;
    if (other == pair.view_b) F.transposeInPlace();
    const Eigen::JacobiSVD<Eigen::Matrix3d> svd(F, Eigen::ComputeFullV);
    judges.push_back({other,
                      matching.view_from_plane[other] * matching.view_from_plane[view].inverse(),
                      svd.matrixV().col(2)});
  }
  return judges;
}

bool IsOnPlane(const Segment& segment,
               const std::vector<Judge>& judges,
               std::span<const ImageFeatures> features,
               const std::vector<std::vector<Straight>>& straights,
               const OnPlaneOptions& options) {
  int able = 0, copies = 0;
  for (const Judge& judge : judges) {
    const ImageFeatures& other = features[judge.view];
    const WarpedSegment w{Transfer(judge.judge_from_view, segment.start),
                          Transfer(judge.judge_from_view, segment.end)};
    if (!Inside(other, w.start) || !Inside(other, w.end)) continue;
    if (EpipolarAngle(w, judge.epipole) < options.min_epipolar_angle_rad) continue;
    ++able;
    for (const Straight& s : straights[judge.view]) {
      if (IsCopy(w, s, options)) {
        ++copies;
        break;
      }
    }
  }
  return copies >= 2 || (copies == 1 && able == 1);
}

}  // namespace

std::vector<std::vector<bool>> FindSegmentsOnPlane(std::span<const ImageFeatures> features,
                                                   const MatchingResult& matching,
                                                   const OnPlaneOptions& options) {
  std::vector<std::vector<bool>> on_plane(features.size());
  std::vector<std::vector<Straight>> straights;
  for (const ImageFeatures& f : features) straights.push_back(StraightsOf(f));
  for (size_t v = 0; v < features.size(); ++v) {
    on_plane[v].assign(features[v].segments.size(), false);
    const std::vector<Judge> judges = JudgesOf(static_cast<int>(v), matching);
    if (judges.empty()) continue;
    for (size_t s = 0; s < features[v].segments.size(); ++s) {
      on_plane[v][s] = IsOnPlane(features[v].segments[s], judges, features, straights, options);
    }
  }
  return on_plane;
}

}  // namespace horopter
