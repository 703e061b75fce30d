#include "server/vision/features/segment_merging.h"

#include <algorithm>
#include <cmath>
#include <numeric>

#include "server/base/stop_scope.h"
#include "server/vision/features/stop_paces.h"

namespace horopter {
namespace {

constexpr double kNeighbourCellPx = 32.0;  // of the grid that finds neighbours
constexpr int kMaxRounds = 3;              // what was merged may merge again
constexpr int kPiecesPerLook = 32;         // at the stop flag
constexpr size_t kMaxJoinedSamples = 300;  // bounds the cost of long edges seen in all channels

double Strength(const Segment& segment) {
  return segment.Length() * (segment.contrast + 1.0);
}

double LateralDistance(const Segment& line, const Eigen::Vector2d& point) {
  const Eigen::Vector2d d = (line.end - line.start).normalized();
  const Eigen::Vector2d q = point - line.start;
  return std::abs(d.x() * q.y() - d.y() * q.x());
}

// Gap of b's projection on a's line; negative: overlap.
double GapAlong(const Segment& a, const Segment& b) {
  const Eigen::Vector2d d = (a.end - a.start).normalized();
  const double s0 = d.dot(b.start - a.start);
  const double s1 = d.dot(b.end - a.start);
  return std::max(std::min(s0, s1) - a.Length(), -std::max(s0, s1));
}

// What the deviations of a fit do not know: sampling and neighbouring edges pull a line about.
constexpr double kModelOffsetPx = 0.15;
constexpr double kModelEndPx = 0.3;  // across, at the ends of a piece: its angle

// Offset of b's middle from a's line and difference of direction, each over its deviation.
double ChiSquare(const Segment& a, const Segment& b) {
  const Eigen::Vector2d da = (a.end - a.start).normalized();
  const Eigen::Vector2d db = (b.end - b.start).normalized();
  const Eigen::Vector2d between = 0.5 * (b.start + b.end - a.start - a.end);
  const double lever = da.dot(between);
  const double offset = da.x() * between.y() - da.y() * between.x();
  const auto angle_variance = [](const Segment& s) {
    const double model = kModelEndPx / (0.5 * s.Length());
    return s.angle_sigma_rad * s.angle_sigma_rad + model * model;
  };
  const double offset_variance =
      a.offset_sigma_px * a.offset_sigma_px + b.offset_sigma_px * b.offset_sigma_px +
      2.0 * kModelOffsetPx * kModelOffsetPx + lever * lever * angle_variance(a);
  // Pieces may run either way.
  const double angle = std::asin(std::clamp(da.x() * db.y() - da.y() * db.x(), -1.0, 1.0));
  return offset * offset / offset_variance +
         angle * angle / (angle_variance(a) + angle_variance(b));
}

bool SameEdge(const Segment& a, const Segment& b, const FeatureOptions& options) {
  if (options.merge_test == MergeTest::kStatistical) {
    return GapAlong(a, b) <= options.merge_gap_px &&
           (a.Length() >= b.Length() ? ChiSquare(a, b) : ChiSquare(b, a)) <=
               options.merge_chi_square;
  }
  const Eigen::Vector2d da = (a.end - a.start).normalized();
  const Eigen::Vector2d db = (b.end - b.start).normalized();
  if (std::abs(da.x() * db.y() - da.y() * db.x()) > std::sin(options.merge_angle_rad) ||
      GapAlong(a, b) > options.merge_gap_px) {
    return false;
  }
  // Both ends of the shorter must lie on the longer one's line.
  const bool a_longer = a.Length() >= b.Length();
  const Segment& line = a_longer ? a : b;
  const Segment& piece = a_longer ? b : a;
  return LateralDistance(line, piece.start) <= options.merge_offset_px &&
         LateralDistance(line, piece.end) <= options.merge_offset_px;
}

void Absorb(const FittedSegment& piece, FittedSegment* into) {
  const Segment like = into->segment;
  const bool extends = GapAlong(like, piece.segment) > -0.9 * piece.segment.Length();
  if (!extends && into->samples.size() >= kMaxJoinedSamples) {
    return;
  }
  into->samples.insert(into->samples.end(), piece.samples.begin(), piece.samples.end());
  into->segment = FitLineToSamples(
      into->samples, {like.start, like.end, piece.segment.start, piece.segment.end}, like);
}

// Cells of a coarse grid that a segment, grown by the merge gap, touches.
class SegmentGrid {
 public:
  void Insert(const Segment& segment, double margin, int id) {
    ForEachCell(segment, margin, [&](long key) { entries_.emplace_back(key, id); });
  }
  void Sort() {
    using Entry = std::pair<long, int>;
    StopPacer comparisons(kComparisonsPerLook);
    std::sort(entries_.begin(), entries_.end(), [&](const Entry& a, const Entry& b) {
      comparisons.Step();
      return a < b;
    });
  }

  // Sorted ids without repetition.
  std::vector<int> Near(const Segment& segment) const {
    std::vector<int> ids;
    ForEachCell(segment, 0.0, [&](long key) {
      auto it = std::lower_bound(entries_.begin(), entries_.end(), std::make_pair(key, -1));
      for (; it != entries_.end() && it->first == key; ++it) {
        ids.push_back(it->second);
      }
    });
    std::sort(ids.begin(), ids.end());
    ids.erase(std::unique(ids.begin(), ids.end()), ids.end());
    return ids;
  }

 private:
  template <typename Visit>
  static void ForEachCell(const Segment& segment, double margin, const Visit& visit) {
    const Eigen::Vector2d d = (segment.end - segment.start).normalized();
    const double length = segment.Length() + 2.0 * margin;
    const int steps = static_cast<int>(length / (0.5 * kNeighbourCellPx)) + 1;
    long last = -1;
    for (int i = 0; i <= steps; ++i) {
      const Eigen::Vector2d p = segment.start + d * (length * i / steps - margin);
      for (const Eigen::Vector2d& q :
           {p,
            Eigen::Vector2d(p.x() + 0.25 * kNeighbourCellPx, p.y() + 0.25 * kNeighbourCellPx),
            Eigen::Vector2d(p.x() - 0.25 * kNeighbourCellPx, p.y() - 0.25 * kNeighbourCellPx)}) {
        const long key = static_cast<long>(std::floor(q.y() / kNeighbourCellPx) + 64) * 65536 +
                         static_cast<long>(std::floor(q.x() / kNeighbourCellPx) + 64);
        if (key != last) {
          visit(key);
          last = key;
        }
      }
    }
  }

  std::vector<std::pair<long, int>> entries_;
};

bool MergeOnce(std::vector<FittedSegment>* pieces, const FeatureOptions& options) {
  StopPacer comparisons(kComparisonsPerLook);
  std::stable_sort(
      pieces->begin(), pieces->end(), [&](const FittedSegment& a, const FittedSegment& b) {
        comparisons.Step();
        return Strength(a.segment) > Strength(b.segment);
      });
  SegmentGrid grid;
  StopPacer pacer(kPiecesPerLook);
  for (size_t i = 0; i < pieces->size(); ++i) {
    pacer.Step();
    grid.Insert((*pieces)[i].segment, options.merge_gap_px, static_cast<int>(i));
  }
  grid.Sort();
  std::vector<char> gone(pieces->size(), 0);
  bool changed = false;
  for (size_t i = 0; i < pieces->size(); ++i) {
    if (gone[i]) {
      continue;
    }
    pacer.Step();
    for (int j : grid.Near((*pieces)[i].segment)) {
      if (j > static_cast<int>(i) && !gone[j] &&
          SameEdge((*pieces)[i].segment, (*pieces)[j].segment, options)) {
        Absorb((*pieces)[j], &(*pieces)[i]);
        gone[j] = 1;
        changed = true;
      }
    }
  }
  size_t kept = 0;
  for (size_t i = 0; i < pieces->size(); ++i) {
    if (!gone[i]) {
      if (kept != i) {
        (*pieces)[kept] = std::move((*pieces)[i]);
      }
      ++kept;
    }
  }
  pieces->resize(kept);
  return changed;
}

}  // namespace

std::vector<Segment> MergeSegments(std::vector<FittedSegment> pieces,
                                   const FeatureOptions& options) {
  for (int round = 0; round < kMaxRounds && MergeOnce(&pieces, options); ++round) {
  }
  std::vector<Segment> segments;
  segments.reserve(pieces.size());
  for (FittedSegment& piece : pieces) {
    segments.push_back(piece.segment);
  }
  StopPacer comparisons(kComparisonsPerLook);
  std::stable_sort(segments.begin(), segments.end(), [&](const Segment& a, const Segment& b) {
    comparisons.Step();
    return Strength(a) > Strength(b);
  });
  return segments;
}

}  // namespace horopter
