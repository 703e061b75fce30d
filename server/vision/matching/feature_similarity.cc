#include "server/vision/matching/feature_similarity.h"

#include <Eigen/Dense>
#include <algorithm>
#include <cmath>
#include <cstdint>
#include <limits>

#include "server/vision/matching/homography.h"
#include "server/vision/matching/learnt_constants.h"

namespace horopter {
namespace {

constexpr float kNone = std::numeric_limits<float>::quiet_NaN();  // a cue that says nothing
constexpr double kMinBeamSine = 0.17;  // 10 degrees: flatter beams do not bound a segment
double LineAngle(const Eigen::Vector2d& u, const Eigen::Vector2d& v) {
  return std::atan2(std::abs(u.x() * v.y() - u.y() * v.x()), std::abs(u.dot(v)));
}

// Of directions in (-pi, pi].
double TurnBetween(double a, double b) {
  const double d = std::abs(a - b);
  return d > M_PI ? 2.0 * M_PI - d : d;
}

// Directions in which the junction's segments leave it, image axes.
std::vector<Eigen::Vector2d> ArmsOf(const Junction& junction, const ImageFeatures& features) {
  std::vector<Eigen::Vector2d> arms;
  for (const Junction::End& end : junction.ends) {
    const Segment& s = features.segments[end.segment];
    const Eigen::Vector2d along = (s.end - s.start).normalized();
    if (end.interior || end.at_start) arms.push_back(along);
    if (end.interior || !end.at_start) arms.push_back(-along);
  }
  return arms;
}

// Mean turn of the arms when as many as possible are paired, nearest first; each once.
double ArmTurn(const std::vector<double>& a, const std::vector<double>& b) {
  constexpr size_t kMaxArms = 64;  // bits of a mask; no junction has so many
  const size_t of_a = std::min(a.size(), kMaxArms), of_b = std::min(b.size(), kMaxArms);
  const size_t pairs = std::min(of_a, of_b);
  uint64_t used_a = 0, used_b = 0;
  double sum = 0.0;
  for (size_t k = 0; k < pairs; ++k) {
    double best = 10.0;
    size_t at_a = 0, at_b = 0;
    for (size_t i = 0; i < of_a; ++i) {
      for (size_t j = 0; j < of_b && !(used_a >> i & 1); ++j) {
        const double turn = TurnBetween(a[i], b[j]);
        if (used_b >> j & 1 || turn >= best) continue;
        best = turn, at_a = i, at_b = j;
      }
    }
    used_a |= uint64_t{1} << at_a;
    used_b |= uint64_t{1} << at_b;
    sum += best;
  }
  return pairs > 0 ? sum / static_cast<double>(pairs) : M_PI;
}

Eigen::Vector3d UnitLine(const Eigen::Vector3d& line) {
  const double n = line.head<2>().norm();
  return n > 1e-12 ? Eigen::Vector3d(line / n) : Eigen::Vector3d(0, 0, 1e9);
}

double Weighted(const LogRatioTable& table, float cue) {
  return table.weight * TableValue(table, cue);
}

}  // namespace

double TableValue(const LogRatioTable& table, float cue) {
  if (!std::isfinite(cue)) return 0.0;
  const double at = std::clamp((cue - table.low) / table.step - 0.5, 0.0, table.bins - 1.0);
  const int k = std::min(static_cast<int>(at), table.bins - 2);
  const double part = at - k;
  return (1.0 - part) * table.values[k] + part * table.values[k + 1];
}

bool IsUsed(SegmentCue cue, const SimilarityOptions& options) {
  if (cue == kStrip) return options.correlation;
  return cue == kShift || cue == kBeam || options.parameters;
}

bool IsUsed(JunctionCue cue, const SimilarityOptions& options) {
  if (cue == kPatch) return options.correlation;
  return cue == kPointShift || cue == kEpipolar || options.parameters;
}

std::vector<JunctionPatch> WarpedPatches(const MatchingView& b, const PairPrior& prior) {
  if (!prior.b_from_a) return b.patches;
  const Eigen::Matrix3d& H = *prior.b_from_a;
  const Eigen::Matrix3d H_inverse = H.inverse();
  return SampleJunctionPatches(b.smooth, b.features->junctions, [&](const Eigen::Vector2d& p) {
    return TransferJacobian(H, Transfer(H_inverse, p));
  });
}

PairComparison::PairComparison(const MatchingView& a,
                               const MatchingView& b,
                               std::vector<JunctionPatch> patches_b,
                               const PairPrior& prior)
    : a_(a), b_(b), prior_(prior), patches_b_(std::move(patches_b)) {
  if (prior_.b_from_a) homography_ = NormalizeDeterminant(*prior_.b_from_a).value_or(homography_);
  for (const Segment& s : a.features->segments) {
    WarpedSegment w;
    w.start = Warp(s.start);
    w.end = Warp(s.end);
    w.length = (w.end - w.start).norm();
    const auto before_camera = [&](const Eigen::Vector2d& x) {
      return homography_.row(2).dot(x.homogeneous()) > 0.0;
    };
    w.valid =
        std::isfinite(w.length) && w.length > 1.0 && before_camera(s.start) && before_camera(s.end);
    if (w.valid) w.direction = (w.end - w.start) / w.length;
    if (prior_.F) {
      w.start_line = UnitLine(*prior_.F * s.start.homogeneous());
      w.end_line = UnitLine(*prior_.F * s.end.homogeneous());
    }
    segments_a_.push_back(w);
  }
  for (const Junction& j : a.features->junctions) {
    junctions_a_.push_back(Warp(j.point));
    const Eigen::Matrix2d J = TransferJacobian(homography_, j.point);
    arms_a_.emplace_back();
    for (const Eigen::Vector2d& arm : ArmsOf(j, *a.features)) {
      const Eigen::Vector2d warped = J * arm;
      arms_a_.back().push_back(std::atan2(warped.y(), warped.x()));
    }
  }
  for (const Junction& j : b.features->junctions) {
    arms_b_.emplace_back();
    for (const Eigen::Vector2d& arm : ArmsOf(j, *b.features))
      arms_b_.back().push_back(std::atan2(arm.y(), arm.x()));
  }
  if (!prior_.F) return;
  for (const Junction& j : a.features->junctions)
    lines_in_b_.push_back(UnitLine(*prior_.F * j.point.homogeneous()));
  for (const Junction& j : b.features->junctions)
    lines_in_a_.push_back(UnitLine(prior_.F->transpose() * j.point.homogeneous()));
}

Eigen::Vector2d PairComparison::Warp(const Eigen::Vector2d& x) const {
  return Transfer(homography_, x);
}

double PairComparison::EpipolarDistance(int junction_a, int junction_b) const {
  const Eigen::Vector2d& x_a = a_.features->junctions[junction_a].point;
  const Eigen::Vector2d& x_b = b_.features->junctions[junction_b].point;
  return std::max(std::abs(lines_in_b_[junction_a].dot(x_b.homogeneous())),
                  std::abs(lines_in_a_[junction_b].dot(x_a.homogeneous())));
}

double PairComparison::Beam(int index_a, int index_b) const {
  const WarpedSegment& w = segments_a_[index_a];
  const Segment& s = b_.features->segments[index_b];
  const Eigen::Vector2d u = (s.end - s.start).normalized();
  const double length = s.Length();
  double t[2];
  const Eigen::Vector3d* lines[2] = {&w.start_line, &w.end_line};
  for (int k = 0; k < 2; ++k) {
    const double slope = lines[k]->head<2>().dot(u);
    if (std::abs(slope) < kMinBeamSine) return kNone;
    t[k] = -lines[k]->dot(s.start.homogeneous()) / slope;
  }
  const double low = std::min(t[0], t[1]), high = std::max(t[0], t[1]);
  const double overlap = std::min(high, length) - std::max(low, 0.0);
  return std::max(0.0, overlap) / std::max(1.0, std::min(length, high - low));
}

bool PairComparison::MaySegments(int index_a, int index_b) const {
  const WarpedSegment& w = segments_a_[index_a];
  const Segment& s = b_.features->segments[index_b];
  if (!w.valid) return false;
  if (has_plane()) {
    const double length = s.Length();
    const double ratio = w.length / length;
    if (ratio > kMaxLengthRatio || ratio < 1.0 / kMaxLengthRatio) return false;
    const double reach = reach_px();
    if ((0.5 * (w.start + w.end) - 0.5 * (s.start + s.end)).squaredNorm() > reach * reach)
      return false;
    const double cosine = std::abs(w.direction.dot(s.end - s.start)) / length;
    if (cosine < std::cos(kMaxTurnRad)) return false;
  }
  if (has_epipolar()) {
    const double beam = Beam(index_a, index_b);
    if (std::isfinite(beam) && beam < kMinBeam) return false;
  }
  return true;
}

bool PairComparison::MayJunctions(int index_a, int index_b) const {
  const Eigen::Vector2d& x_b = b_.features->junctions[index_b].point;
  if (has_plane()) {
    const double shift = (junctions_a_[index_a] - x_b).norm();
    if (!(shift < reach_px())) return false;
  }
  if (has_epipolar() && !(EpipolarDistance(index_a, index_b) < kMaxEpipolarPx)) return false;
  return !a_.patches[index_a].empty && !patches_b_[index_b].empty;
}

SegmentCues PairComparison::Segments(int index_a, int index_b) const {
  const WarpedSegment& w = segments_a_[index_a];
  const Segment& sa = a_.features->segments[index_a];
  const Segment& sb = b_.features->segments[index_b];
  const Eigen::Vector2d along = (sb.end - sb.start).normalized();
  const bool flipped = w.direction.dot(along) < 0.0;
  SegmentCues cues;
  cues[kTurn] = static_cast<float>(LineAngle(w.direction, along));
  cues[kFlipped] = flipped ? 1.0f : 0.0f;
  cues[kLengthRatio] = static_cast<float>(std::abs(std::log(w.length / sb.Length())));
  const float left = (sa.left_bgr - (flipped ? sb.right_bgr : sb.left_bgr)).norm();
  const float right = (sa.right_bgr - (flipped ? sb.left_bgr : sb.right_bgr)).norm();
  cues[kBetterSide] = std::min(left, right);
  cues[kWorseSide] = std::max(left, right);
  cues[kContrastRatio] = static_cast<float>(
      std::abs(std::log(std::max(1.0, sa.contrast) / std::max(1.0, sb.contrast))));
  float strip = kNone;
  for (int side = 0; side < 2; ++side) {
    const float c = StripCorrelation(
        a_.strips[index_a][side], b_.strips[index_b][flipped ? 1 - side : side], flipped);
    if (std::isfinite(c)) strip = std::isfinite(strip) ? std::max(strip, c) : c;
  }
  cues[kStrip] = strip;
  cues[kShift] = kNone;
  if (has_plane()) {
    const Eigen::Vector2d normal(-along.y(), along.x());
    const Eigen::Vector2d middle = 0.5 * (w.start + w.end);
    cues[kShift] = static_cast<float>(std::abs(normal.dot(middle - sb.start)) / b_.features->width);
  }
  cues[kBeam] = has_epipolar() ? static_cast<float>(Beam(index_a, index_b)) : kNone;
  return cues;
}

JunctionCues PairComparison::Junctions(int index_a, int index_b) const {
  const Junction& ja = a_.features->junctions[index_a];
  const Junction& jb = b_.features->junctions[index_b];
  JunctionCues cues;
  cues[kPatch] = static_cast<float>(PatchSimilarity(a_.patches[index_a], patches_b_[index_b]));
  cues[kTypePair] = ja.type == jb.type                                             ? 0.0f
                    : (ja.type == JunctionType::kL || jb.type == JunctionType::kL) ? 1.0f
                                                                                   : 2.0f;
  cues[kArmTurn] = static_cast<float>(ArmTurn(arms_a_[index_a], arms_b_[index_b]));
  cues[kArmCount] = std::abs(static_cast<float>(arms_a_[index_a].size()) -
                             static_cast<float>(arms_b_[index_b].size()));
  cues[kPointShift] =
      has_plane()
          ? static_cast<float>((junctions_a_[index_a] - jb.point).norm() / b_.features->width)
          : kNone;
  cues[kEpipolar] = has_epipolar() ? static_cast<float>(EpipolarDistance(index_a, index_b)) : kNone;
  return cues;
}

double LogRatio(const SegmentCues& cues, bool has_plane, const SimilarityOptions& options) {
  double sum = 0.0;
  for (int k = 0; k < kSegmentCueCount; ++k) {
    if (IsUsed(static_cast<SegmentCue>(k), options))
      sum += Weighted(kSegmentTables[has_plane ? 0 : 1][k], cues[k]);
  }
  return sum;
}

double LogRatio(const JunctionCues& cues, bool has_plane, const SimilarityOptions& options) {
  double sum = 0.0;
  for (int k = 0; k < kJunctionCueCount; ++k) {
    if (IsUsed(static_cast<JunctionCue>(k), options))
      sum += Weighted(kJunctionTables[has_plane ? 0 : 1][k], cues[k]);
  }
  return sum;
}

}  // namespace horopter
