#include "server/vision/matching/similarity_bounds.h"

#include <Eigen/Dense>
#include <algorithm>
#include <cmath>

#include "server/vision/matching/learnt_constants.h"

namespace horopter {
namespace {

// Above what single precision makes of the cues: angles and logarithms are right to 1e-6, the
// steepest table changes by 20 per radian.
constexpr float kMargin = 1e-3f;
constexpr float kGateMargin = 1e-4f;        // of gates, relative
constexpr float kEpipolarMarginPx = 0.01f;  // for rounding, so that the bound stays one

float Of(double value) {
  return static_cast<float>(value);
}

}  // namespace

float SimilarityBounds::Table::At(float cue) const {
  const float at =
      std::clamp((cue - low) * inverse_step - 0.5f, 0.0f, static_cast<float>(bins - 1));
  const int k = std::min(static_cast<int>(at), bins - 2);
  const float part = at - static_cast<float>(k);
  return values[k] + part * (values[k + 1] - values[k]);
}

float SimilarityBounds::Table::AtMost(float cue) const {
  const float at =
      std::clamp((cue - low) * inverse_step - 0.5f, 0.0f, static_cast<float>(bins - 1));
  const int k = std::min(static_cast<int>(at), bins - 2);
  const float part = at - static_cast<float>(k);
  return std::max(highest_upto[k], values[k] + part * (values[k + 1] - values[k]));
}

SimilarityBounds::Table SimilarityBounds::Weighted(const LogRatioTable& table, bool wanted) {
  Table out;
  out.low = table.low;
  out.inverse_step = 1.0f / table.step;
  out.bins = table.bins;
  float upto = -1e9f;
  for (int k = 0; k < table.bins; ++k) {
    out.values[k] = wanted ? table.weight * table.values[k] : 0.0f;
    out.highest = std::max(out.highest, out.values[k]);
    upto = std::max(upto, out.values[k]);
    out.highest_upto[k] = upto;
  }
  return out;
}

SimilarityBounds::SimilarityBounds(const PairComparison& pair, const SimilarityOptions& options)
    : pair_(pair), reach_px_(Of(pair.reach_px()) * (1.0f + kGateMargin)) {
  const int prior = pair.has_plane() ? 0 : 1;
  for (int k = 0; k < kSegmentCueCount; ++k)
    segment_[k] = Weighted(kSegmentTables[prior][k], IsUsed(static_cast<SegmentCue>(k), options));
  for (int k = 0; k < kJunctionCueCount; ++k)
    junction_[k] =
        Weighted(kJunctionTables[prior][k], IsUsed(static_cast<JunctionCue>(k), options));
  segment_rest_ = segment_[kStrip].highest + kMargin;
  if (pair.has_epipolar()) segment_rest_ += segment_[kBeam].highest;
  junction_rest_ = junction_[kTypePair].highest + junction_[kArmTurn].highest +
                   junction_[kArmCount].highest + kMargin;
  a_ = SegmentsOfA();
  b_ = SegmentsOfB();
  for (const Eigen::Vector2d& p : pair.warped_junctions()) junctions_a_.push_back(p.cast<float>());
  for (const Junction& j : pair.b().features->junctions)
    junctions_b_.push_back(j.point.cast<float>());
  for (const Eigen::Vector3d& l : pair.lines_in_b()) lines_in_b_.push_back(l.cast<float>());
  for (const Eigen::Vector3d& l : pair.lines_in_a()) lines_in_a_.push_back(l.cast<float>());
}

SimilarityBounds::SegmentRow SimilarityBounds::SegmentsOfA() const {
  SegmentRow row;
  for (size_t i = 0; i < pair_.warped_segments().size(); ++i) {
    const PairComparison::WarpedSegment& w = pair_.warped_segments()[i];
    const Segment& s = pair_.a().features->segments[i];
    row.x.push_back(Of(0.5 * (w.start.x() + w.end.x())));
    row.y.push_back(Of(0.5 * (w.start.y() + w.end.y())));
    row.ux.push_back(Of(w.direction.x()));
    row.uy.push_back(Of(w.direction.y()));
    row.angle.push_back(Of(std::atan2(w.direction.y(), w.direction.x())));
    row.log_length.push_back(w.valid ? Of(std::log(w.length)) : 0.0f);
    row.log_contrast.push_back(Of(std::log(std::max(1.0, s.contrast))));
    row.left.push_back(s.left_bgr);
    row.right.push_back(s.right_bgr);
    row.valid.push_back(w.valid);
  }
  return row;
}

SimilarityBounds::SegmentRow SimilarityBounds::SegmentsOfB() const {
  SegmentRow row;
  for (const Segment& s : pair_.b().features->segments) {
    const Eigen::Vector2d u = (s.end - s.start).normalized();
    row.x.push_back(Of(0.5 * (s.start.x() + s.end.x())));
    row.y.push_back(Of(0.5 * (s.start.y() + s.end.y())));
    row.ux.push_back(Of(u.x()));
    row.uy.push_back(Of(u.y()));
    row.angle.push_back(Of(std::atan2(u.y(), u.x())));
    row.log_length.push_back(Of(std::log(s.Length())));
    row.log_contrast.push_back(Of(std::log(std::max(1.0, s.contrast))));
    row.left.push_back(s.left_bgr);
    row.right.push_back(s.right_bgr);
  }
  return row;
}

// Marks what passes the gates; a loop without branches.
void SimilarityBounds::GateSegments(int i, std::vector<std::int32_t>* passes) const {
  const int n = static_cast<int>(b_.x.size());
  passes->assign(n, 1);
  if (!pair_.has_plane()) return;
  const float x = a_.x[i], y = a_.y[i], ux = a_.ux[i], uy = a_.uy[i], length = a_.log_length[i];
  const float max_ratio = Of(std::log(PairComparison::kMaxLengthRatio)) + kGateMargin;
  const float min_cosine = Of(std::cos(PairComparison::kMaxTurnRad)) - kGateMargin;
  const float reach2 = reach_px_ * reach_px_;
  const float *bx = b_.x.data(), *by = b_.y.data(), *bux = b_.ux.data(), *buy = b_.uy.data();
  const float* log_length = b_.log_length.data();
  std::int32_t* pass = passes->data();
  for (int j = 0; j < n; ++j) {
    const float dx = x - bx[j], dy = y - by[j];
    pass[j] = (dx * dx + dy * dy <= reach2) & (std::abs(ux * bux[j] + uy * buy[j]) >= min_cosine) &
              (std::abs(length - log_length[j]) <= max_ratio);
  }
}

// All cues but the strip's correlation and the beam.
float SimilarityBounds::SegmentBound(int i, int j) const {
  const float cosine = a_.ux[i] * b_.ux[j] + a_.uy[i] * b_.uy[j];
  float bound = segment_rest_ +
                segment_[kLengthRatio].At(std::abs(a_.log_length[i] - b_.log_length[j])) +
                segment_[kContrastRatio].At(std::abs(a_.log_contrast[i] - b_.log_contrast[j]));
  if (pair_.has_plane()) {
    const float across = (a_.x[i] - b_.x[j]) * b_.uy[j] - (a_.y[i] - b_.y[j]) * b_.ux[j];
    bound += segment_[kShift].At(std::abs(across) / static_cast<float>(pair_.b().features->width));
  }
  // Of lines: within pi / 2.
  float turn = std::abs(a_.angle[i] - b_.angle[j]);
  if (turn > Of(M_PI)) turn = Of(2.0 * M_PI) - turn;
  bound += segment_[kTurn].At(std::min(turn, Of(M_PI) - turn));
  // Which side is the brighter one is not certain across the segment itself.
  if (std::abs(cosine) < kGateMargin) {
    return bound + segment_[kFlipped].highest + segment_[kBetterSide].highest +
           segment_[kWorseSide].highest;
  }
  const bool flipped = cosine < 0.0f;
  const float l = (a_.left[i] - (flipped ? b_.right[j] : b_.left[j])).norm();
  const float r = (a_.right[i] - (flipped ? b_.left[j] : b_.right[j])).norm();
  return bound + segment_[kFlipped].At(flipped ? 1.0f : 0.0f) +
         segment_[kBetterSide].At(std::min(l, r)) + segment_[kWorseSide].At(std::max(l, r));
}

void SimilarityBounds::OfSegment(int i, float least, std::vector<Bound>* bounds) const {
  bounds->clear();
  if (!a_.valid[i]) return;
  std::vector<std::int32_t> passes;
  GateSegments(i, &passes);
  for (int j = 0; j < static_cast<int>(passes.size()); ++j) {
    if (!passes[j]) continue;
    float bound = SegmentBound(i, j);
    if (!(bound >= least)) continue;
    if (pair_.has_epipolar()) {
      const double beam = pair_.Beam(i, j);
      if (beam < PairComparison::kMinBeam) continue;
      bound -= segment_[kBeam].highest;
      if (std::isfinite(beam)) bound += segment_[kBeam].At(Of(beam));
    }
    if (bound >= least) bounds->push_back({j, bound});
  }
}

void SimilarityBounds::OfJunction(int i, float least, std::vector<Bound>* bounds) const {
  bounds->clear();
  const JunctionPatch& patch = pair_.a().patches[i];
  if (patch.empty) return;
  const bool plane = pair_.has_plane(), epipolar = pair_.has_epipolar();
  const int n = static_cast<int>(junctions_b_.size());
  const Eigen::Vector2f at = junctions_a_[i];
  const Eigen::Vector2f in_a = pair_.a().features->junctions[i].point.cast<float>();
  const float reach2 = reach_px_ * reach_px_;
  const float inverse_width = 1.0f / static_cast<float>(pair_.b().features->width);
  const std::vector<JunctionPatch>& patches = pair_.patches_b();
  for (int j = 0; j < n; ++j) {
    const Eigen::Vector2f& p = junctions_b_[j];
    float bound = junction_rest_;
    if (plane) {
      const float squared = (at - p).squaredNorm();
      if (!(squared <= reach2)) continue;
      bound += junction_[kPointShift].At(std::sqrt(squared) * inverse_width);
    }
    if (epipolar) {
      const Eigen::Vector3f &in_b_line = lines_in_b_[i], &in_a_line = lines_in_a_[j];
      const float d = std::max(std::abs(in_b_line.head<2>().dot(p) + in_b_line.z()),
                               std::abs(in_a_line.head<2>().dot(in_a) + in_a_line.z()));
      if (d > Of(PairComparison::kMaxEpipolarPx) + kEpipolarMarginPx) continue;
      bound += std::max(junction_[kEpipolar].At(std::max(0.0f, d - kEpipolarMarginPx)),
                        junction_[kEpipolar].At(d + kEpipolarMarginPx));
    }
    if (patches[j].empty || bound + junction_[kPatch].highest < least) continue;
    bound += junction_[kPatch].AtMost(HighestSimilarity(patch, patches[j]) + kGateMargin);
    if (bound >= least) bounds->push_back({j, bound});
  }
}

HighestSoFar::HighestSoFar(size_t rows, size_t columns, int keep, float least) : keep_(keep) {
  for (auto& [lists, n] : {std::pair(&rows_, rows), std::pair(&columns_, columns)}) {
    lists->values.assign(n * keep, least);
    lists->least.assign(n, least);
  }
}

void HighestSoFar::Enter(int feature, float log_ratio, Lists* lists) const {
  if (!(log_ratio > lists->least[feature])) return;
  float* values = &lists->values[static_cast<size_t>(feature) * keep_];
  *std::min_element(values, values + keep_) = log_ratio;
  lists->least[feature] = *std::min_element(values, values + keep_);
}

void HighestSoFar::Enter(int row, int column, float log_ratio) {
  Enter(row, log_ratio, &rows_);
  Enter(column, log_ratio, &columns_);
}

}  // namespace horopter
