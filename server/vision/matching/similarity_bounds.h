// Upper bounds of how like two features can be, many times cheaper than the similarity itself: most
// of all pairs of two views need no comparison (the results stay the same, bit for bit).
#pragma once

#include <Eigen/Core>
#include <cstdint>
#include <vector>

#include "server/vision/matching/feature_similarity.h"

namespace horopter {

// Log-likelihood ratios no pair reaches; pairs that fail a gate of PairComparison::May* are left
// out. Single precision with a margin above its rounding. Refers to the comparison.
class SimilarityBounds {
 public:
  struct Bound {
    int b = -1;
    float log_ratio = 0.0f;
  };

  SimilarityBounds(const PairComparison& pair, const SimilarityOptions& options);

  // Features of view b that may be like feature index_a of view a by at least `least`.
  void OfSegment(int index_a, float least, std::vector<Bound>* bounds) const;
  void OfJunction(int index_a, float least, std::vector<Bound>* bounds) const;

 private:
  // A table with its weight, for many values.
  struct Table {
    float low = 0.0f, inverse_step = 0.0f;
    int bins = 0;
    float values[12] = {};
    float highest = 0.0f;    // of any value and of none (0)
    float highest_upto[12];  // of the values up to a bin
    float At(float cue) const;
    float AtMost(float cue) const;  // the highest of all cues up to this one
  };
  struct SegmentRow {
    std::vector<float> x, y, ux, uy, angle, log_length, log_contrast;
    std::vector<Eigen::Vector3f> left, right;
    std::vector<char> valid;
  };
  static Table Weighted(const struct LogRatioTable& table, bool wanted);
  SegmentRow SegmentsOfA() const;
  SegmentRow SegmentsOfB() const;
  void GateSegments(int index_a, std::vector<std::int32_t>* passes) const;
  float SegmentBound(int index_a, int index_b) const;

  const PairComparison& pair_;
  Table segment_[kSegmentCueCount], junction_[kJunctionCueCount];
  float segment_rest_ = 0.0f;  // of the cues that a bound does not look at
  float junction_rest_ = 0.0f;
  float reach_px_ = 0.0f;
  SegmentRow a_, b_;
  std::vector<Eigen::Vector2f> junctions_a_, junctions_b_;
  std::vector<Eigen::Vector3f> lines_in_b_, lines_in_a_;  // epipolar, of the junctions of the other
};

// The `keep` highest log-likelihood ratios so far of every feature of either view: a pair below
// both lists of its features cannot become a candidate.
class HighestSoFar {
 public:
  HighestSoFar(size_t rows, size_t columns, int keep, float least);
  bool MayEnter(int row, int column, float bound) const {
    return bound >= rows_.least[row] || bound >= columns_.least[column];
  }
  void Enter(int row, int column, float log_ratio);

 private:
  struct Lists {
    std::vector<float> values;  // `keep` per feature
    std::vector<float> least;   // the lowest of a feature's
  };
  void Enter(int feature, float log_ratio, Lists* lists) const;

  int keep_;
  Lists rows_, columns_;
};

}  // namespace horopter
