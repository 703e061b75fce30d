// How like two features of two views are (thesis 2.7.1 - 2.7.3): measured cues, and what each says
// as a log-likelihood ratio log p(cue | same) / p(cue | different).
#pragma once

#include <Eigen/Core>
#include <optional>
#include <string>
#include <vector>

#include "server/vision/matching/matching_options.h"
#include "server/vision/matching/matching_view.h"

namespace horopter {

// What is known of a pair of views before features are compared. Both may be empty.
struct PairPrior {
  std::optional<Eigen::Matrix3d> b_from_a;  // homography of the supporting plane, pixels
  std::optional<Eigen::Matrix3d> F;         // x_b^T F x_a = 0, pixels
};

// Every cue is a number; NaN where it says nothing (a flat strip, no plane, no F).
enum SegmentCue {
  kTurn,           // |angle| between the segments' lines after the prior homography, rad, <= pi / 2
  kFlipped,        // 1: the brighter side changed, else 0
  kLengthRatio,    // |log of the ratio of the lengths|
  kBetterSide,     // BGR distance of the side whose colour agrees better (of the two)
  kWorseSide,      // ... and worse
  kContrastRatio,  // |log of the ratio of the contrasts|
  kStrip,          // best correlation of the windows along the segment, of the two sides
  kShift,          // offset of b from the warped a across itself, image widths
  kBeam,           // overlap with the epipolar beam of a, share of the shorter, 0 .. 1
  kSegmentCueCount
};
enum JunctionCue {
  kPatch,       // correlation of the colour patches
  kTypePair,    // 0: same type, 1: one is an L, 2: other
  kArmTurn,     // mean |angle| between the arms paired by angle, rad
  kArmCount,    // |difference of the number of arms|
  kPointShift,  // distance of b from the warped a, image widths
  kEpipolar,    // larger distance to the epipolar lines, px
  kJunctionCueCount
};
using SegmentCues = Eigen::Matrix<float, kSegmentCueCount, 1>;
using JunctionCues = Eigen::Matrix<float, kJunctionCueCount, 1>;

// Which evidence is used; the variants of the thesis and of the comparison.
// Whether a cue counts under the options.
bool IsUsed(SegmentCue cue, const SimilarityOptions& options);
bool IsUsed(JunctionCue cue, const SimilarityOptions& options);

// Patches of view b's junctions, laid out by the prior's homography so that they show what view a's
// upright ones show; upright themselves without one.
std::vector<JunctionPatch> WarpedPatches(const MatchingView& b, const PairPrior& prior);

// Cues of feature index_a of view a and index_b of view b. patches_b: of view b, laid out by the
// prior's homography (upright without one).
class PairComparison {
 public:
  // Gates of the cheap tests; of the true pairs of parts-train 5 % of the segments and 2 % of the
  // junctions fail them (matching_learning says so).
  static constexpr double kMaxTurnRad = 1.2;
  static constexpr double kMaxLengthRatio = 4.0;
  static constexpr double kMaxShiftWidths = 0.25;
  static constexpr double kMaxEpipolarPx = 8.0;
  static constexpr double kMinBeam = 0.05;

  // A segment of view a where the prior puts it.
  struct WarpedSegment {
    Eigen::Vector2d start, end;
    Eigen::Vector2d direction = Eigen::Vector2d::UnitX();
    double length = 0.0;
    bool valid = false;
    Eigen::Vector3d start_line, end_line;  // epipolar lines of the true end points, unit normals
  };

  PairComparison(const MatchingView& a,
                 const MatchingView& b,
                 std::vector<JunctionPatch> patches_b,
                 const PairPrior& prior);

  SegmentCues Segments(int index_a, int index_b) const;
  JunctionCues Junctions(int index_a, int index_b) const;
  // Cheap tests that hardly a true pair fails; the full comparison is made only for the others.
  bool MaySegments(int index_a, int index_b) const;
  bool MayJunctions(int index_a, int index_b) const;

  const MatchingView& a() const { return a_; }
  const MatchingView& b() const { return b_; }
  bool has_plane() const { return prior_.b_from_a.has_value(); }
  bool has_epipolar() const { return prior_.F.has_value(); }
  // Where the prior homography puts a point of view a (itself without one).
  Eigen::Vector2d Warp(const Eigen::Vector2d& x) const;
  // Larger distance of two junctions from their epipolar lines, px. Needs an F.
  double EpipolarDistance(int junction_a, int junction_b) const;
  // Overlap of a segment with the epipolar beam of one of view a (kBeam). Needs an F.
  double Beam(int index_a, int index_b) const;

  // What the bounds of similarity are made of.
  double reach_px() const { return kMaxShiftWidths * b_.features->width; }
  const std::vector<WarpedSegment>& warped_segments() const { return segments_a_; }
  const std::vector<Eigen::Vector2d>& warped_junctions() const { return junctions_a_; }
  const std::vector<JunctionPatch>& patches_b() const { return patches_b_; }
  // Epipolar lines, unit normals, of a's junctions in b and of b's in a; empty without an F.
  const std::vector<Eigen::Vector3d>& lines_in_b() const { return lines_in_b_; }
  const std::vector<Eigen::Vector3d>& lines_in_a() const { return lines_in_a_; }

 private:
  const MatchingView& a_;
  const MatchingView& b_;
  PairPrior prior_;
  Eigen::Matrix3d homography_ = Eigen::Matrix3d::Identity();
  std::vector<WarpedSegment> segments_a_;
  std::vector<Eigen::Vector2d> junctions_a_;          // warped
  std::vector<std::vector<double>> arms_a_, arms_b_;  // directions, rad, a's warped
  std::vector<JunctionPatch> patches_b_;
  std::vector<Eigen::Vector3d> lines_in_b_, lines_in_a_;
};

// Weighted sum of the cues' log-likelihood ratios.
double LogRatio(const SegmentCues& cues, bool has_plane, const SimilarityOptions& options);
double LogRatio(const JunctionCues& cues, bool has_plane, const SimilarityOptions& options);

}  // namespace horopter
