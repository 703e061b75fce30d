#include "server/vision/features/junctions.h"

#include <Eigen/LU>
#include <algorithm>
#include <cmath>
#include <optional>
#include <tuple>
#include <unordered_map>

namespace horopter {
namespace {

constexpr double kJoinPx = 2.0;  // another line through the junction must pass this near
constexpr int kMaxJunctionsPerSegment = 12;  // more are texture; for time

// Buckets of ids over the image; a point's neighbourhood of 3x3 cells holds everything within one
// cell size.
class CellMap {
 public:
  explicit CellMap(double cell_px) : cell_px_(cell_px) {}

  double CellSize() const { return cell_px_; }
  long Key(const Eigen::Vector2d& p) const {
    return (static_cast<long>(std::floor(p.y() / cell_px_)) + 1024) * 1048576 +
           static_cast<long>(std::floor(p.x() / cell_px_)) + 1024;
  }
  void Insert(long key, int id) { cells_[key].push_back(id); }

  template <typename Visit>
  void ForNeighbours(const Eigen::Vector2d& p, const Visit& visit) const {
    for (int dy = -1; dy <= 1; ++dy) {
      for (int dx = -1; dx <= 1; ++dx) {
        const auto it = cells_.find(Key(p + Eigen::Vector2d(dx, dy) * cell_px_));
        if (it != cells_.end()) {
          for (int id : it->second) {
            visit(id);
          }
        }
      }
    }
  }

 private:
  double cell_px_;
  std::unordered_map<long, std::vector<int>> cells_;
};

// Ends may be two gaps apart.
double CellSizeFor(const FeatureOptions& options) {
  return std::max(2.0 * options.junction_gap_px, 4.0);
}

struct Line {
  Eigen::Vector2d start;
  Eigen::Vector2d end;
  Eigen::Vector2d direction;
  Eigen::Vector2d normal;
  double offset = 0.0;  // normal . x = offset
  double reach = 0.0;   // how far an end may be from the intersection
  double weight = 1.0;
  double offset_variance = 0.0;
  double angle_variance = 0.0;
  int arc = -1;  // see Segment::arc
};

Line MakeLine(const Segment& segment, const FeatureOptions& options) {
  Line line;
  line.start = segment.start;
  line.end = segment.end;
  line.direction = (segment.end - segment.start).normalized();
  line.normal = {-line.direction.y(), line.direction.x()};
  line.offset = line.normal.dot(segment.start);
  line.reach = std::min(options.junction_gap_px, options.junction_gap_fraction * segment.Length());
  // A line's position at its end is about as good as its number of samples.
  line.weight = segment.Length();
  line.offset_variance = segment.offset_sigma_px * segment.offset_sigma_px;
  line.arc = segment.arc;
  line.angle_variance = segment.angle_sigma_rad * segment.angle_sigma_rad;
  return line;
}

double Cross(const Eigen::Vector2d& a, const Eigen::Vector2d& b) {
  return a.x() * b.y() - a.y() * b.x();
}

// Neighbouring chords of an arc meet in no corner.
bool ChordsOfOneArc(const Line& a, const Line& b) {
  return a.arc >= 0 && a.arc == b.arc;
}

const Eigen::Vector2d& EndOf(const Line& line, bool at_start) {
  return at_start ? line.start : line.end;
}

struct Candidate {
  double cost = 0.0;  // sum of the gaps
  Eigen::Vector2d point = Eigen::Vector2d::Zero();
  Junction::End a, b;
};

std::optional<Eigen::Vector2d> Intersect(const Line& a, const Line& b, double min_sine) {
  const double sine = Cross(a.direction, b.direction);
  if (std::abs(sine) < min_sine) {
    return std::nullopt;
  }
  return Eigen::Vector2d(a.start + a.direction * (Cross(b.start - a.start, b.direction) / sine));
}

// End-to-end meetings of pairs.
void CollectCorners(const std::vector<Line>& lines,
                    double min_sine,
                    double cell_px,
                    std::vector<Candidate>* out) {
  CellMap cells(cell_px);
  for (size_t i = 0; i < lines.size(); ++i) {
    for (int k = 0; k < 2; ++k) {
      const Eigen::Vector2d& p = EndOf(lines[i], k == 1);
      cells.Insert(cells.Key(p), static_cast<int>(2 * i + k));
    }
  }
  for (size_t i = 0; i < lines.size(); ++i) {
    for (int k = 0; k < 2; ++k) {
      const Eigen::Vector2d& p = EndOf(lines[i], k == 1);
      cells.ForNeighbours(p, [&](int other) {
        const int j = other / 2;
        if (j <= static_cast<int>(i) || ChordsOfOneArc(lines[i], lines[j])) {
          return;
        }
        const std::optional<Eigen::Vector2d> x = Intersect(lines[i], lines[j], min_sine);
        if (!x) {
          return;
        }
        const double gap_a = (*x - p).norm();
        const double gap_b = (*x - EndOf(lines[j], other % 2 == 1)).norm();
        if (gap_a <= lines[i].reach && gap_b <= lines[j].reach) {
          out->push_back({gap_a + gap_b,
                          *x,
                          {static_cast<int>(i), k == 1, false},
                          {j, other % 2 == 1, false}});
        }
      });
    }
  }
}

// Ends on the middle of another segment.
void CollectTees(const std::vector<Line>& lines,
                 double min_sine,
                 double cell_px,
                 std::vector<Candidate>* out) {
  CellMap cells(cell_px);
  for (size_t j = 0; j < lines.size(); ++j) {
    const int steps =
        static_cast<int>((lines[j].end - lines[j].start).norm() / (0.5 * cells.CellSize())) + 1;
    long last = -1;
    for (int s = 0; s <= steps; ++s) {
      const Eigen::Vector2d p =
          lines[j].start + (lines[j].end - lines[j].start) * (static_cast<double>(s) / steps);
      const long key = cells.Key(p);
      if (key != last) {
        cells.Insert(key, static_cast<int>(j));
        last = key;
      }
    }
  }
  std::vector<int> seen(lines.size(), -1);
  for (size_t i = 0; i < lines.size(); ++i) {
    for (int k = 0; k < 2; ++k) {
      const Eigen::Vector2d& p = EndOf(lines[i], k == 1);
      cells.ForNeighbours(p, [&](int j) {
        const int stamp = static_cast<int>(2 * i + k);
        if (j == static_cast<int>(i) || seen[j] == stamp || ChordsOfOneArc(lines[i], lines[j])) {
          return;
        }
        seen[j] = stamp;
        const std::optional<Eigen::Vector2d> x = Intersect(lines[i], lines[j], min_sine);
        if (!x) {
          return;
        }
        const double along = lines[j].direction.dot(*x - lines[j].start);
        const double length = lines[j].direction.dot(lines[j].end - lines[j].start);
        const double gap = (*x - p).norm();
        // Nearer than its reach to an end it is a corner, not a tee.
        if (gap <= lines[i].reach && along > lines[j].reach && along < length - lines[j].reach) {
          out->push_back(
              {gap + lines[j].reach, *x, {static_cast<int>(i), k == 1, false}, {j, false, true}});
        }
      });
    }
  }
}

// Least-squares point of the lines; rms of the distances.
void Relocate(const std::vector<Line>& lines, Junction* junction) {
  Eigen::Matrix2d normal_matrix = Eigen::Matrix2d::Zero();
  Eigen::Vector2d right_side = Eigen::Vector2d::Zero();
  for (const Junction::End& end : junction->ends) {
    const Line& line = lines[end.segment];
    normal_matrix += line.weight * line.normal * line.normal.transpose();
    right_side += line.weight * line.offset * line.normal;
  }
  const Eigen::Matrix2d inverse = normal_matrix.inverse();
  junction->point = inverse * right_side;
  // Each line's error across itself at the junction, carried through the weighted solution.
  Eigen::Matrix2d spread = Eigen::Matrix2d::Zero();
  for (const Junction::End& end : junction->ends) {
    const Line& line = lines[end.segment];
    const double lever = line.direction.dot(junction->point - 0.5 * (line.start + line.end));
    const double variance = line.offset_variance + lever * lever * line.angle_variance;
    spread += line.weight * line.weight * variance * line.normal * line.normal.transpose();
  }
  junction->covariance = inverse * spread * inverse;
  double square = 0.0;
  for (const Junction::End& end : junction->ends) {
    const double d = lines[end.segment].normal.dot(junction->point) - lines[end.segment].offset;
    square += d * d;
  }
  junction->rms_px = std::sqrt(square / static_cast<double>(junction->ends.size()));
}

long PairKey(int a, int b) {
  return static_cast<long>(std::min(a, b)) * 1048576 + std::max(a, b);
}

// The third and fourth line of a junction: those of a candidate beside it that meet the point.
void AddEnds(const std::vector<Line>& lines,
             const Candidate& other,
             const Eigen::Vector2d& point,
             Junction* junction) {
  if ((other.point - point).norm() > 2.0 * kJoinPx) return;
  for (const Junction::End& end : {other.a, other.b}) {
    const bool known =
        std::any_of(junction->ends.begin(), junction->ends.end(), [&](const Junction::End& k) {
          return k.segment == end.segment;
        });
    const Line& line = lines[end.segment];
    if (!known && std::abs(line.normal.dot(point) - line.offset) <= kJoinPx)
      junction->ends.push_back(end);
  }
}

}  // namespace

std::vector<Junction> FindJunctions(const std::vector<Segment>& segments,
                                    const FeatureOptions& options) {
  std::vector<Line> lines;
  lines.reserve(segments.size());
  for (const Segment& segment : segments) {
    lines.push_back(MakeLine(segment, options));
  }
  const double min_sine = std::sin(options.junction_min_angle_rad);
  std::vector<Candidate> candidates;
  CollectCorners(lines, min_sine, CellSizeFor(options), &candidates);
  CollectTees(lines, min_sine, CellSizeFor(options), &candidates);
  std::sort(candidates.begin(), candidates.end(), [](const Candidate& a, const Candidate& b) {
    return std::tie(a.cost, a.a.segment, a.b.segment) < std::tie(b.cost, b.a.segment, b.b.segment);
  });
  // Candidates of each segment, to find the third and fourth line of a junction.
  std::vector<std::vector<int>> of_segment(lines.size());
  for (size_t c = 0; c < candidates.size(); ++c) {
    of_segment[candidates[c].a.segment].push_back(static_cast<int>(c));
    of_segment[candidates[c].b.segment].push_back(static_cast<int>(c));
  }
  std::vector<Junction> junctions;
  std::vector<int> count(lines.size(), 0);
  std::unordered_map<long, bool> joined;
  for (const Candidate& candidate : candidates) {
    if (joined.count(PairKey(candidate.a.segment, candidate.b.segment)) > 0 ||
        std::max(count[candidate.a.segment], count[candidate.b.segment]) >=
            kMaxJunctionsPerSegment) {
      continue;
    }
    Junction junction;
    junction.point = candidate.point;
    junction.ends = {candidate.a, candidate.b};
    for (size_t e = 0; e < 2; ++e) {
      for (int c : of_segment[junction.ends[e].segment])
        AddEnds(lines, candidates[c], candidate.point, &junction);
    }
    Relocate(lines, &junction);
    junction.type = TypeOf(junction, segments);
    for (size_t e = 0; e < junction.ends.size(); ++e) {
      ++count[junction.ends[e].segment];
      for (size_t f = e + 1; f < junction.ends.size(); ++f) {
        joined[PairKey(junction.ends[e].segment, junction.ends[f].segment)] = true;
      }
    }
    junctions.push_back(std::move(junction));
  }
  return junctions;
}

JunctionType TypeOf(const Junction& junction, const std::vector<Segment>& segments) {
  // Rays from the point along the segments; one that passes gives two.
  constexpr double kStraightRad = 0.12;  // two ends this near to one line are one edge, cut here
  std::vector<double> rays;
  int passing = 0;
  for (const Junction::End& end : junction.ends) {
    const Segment& segment = segments[end.segment];
    const Eigen::Vector2d along =
        end.at_start || end.interior ? segment.end - segment.start : segment.start - segment.end;
    rays.push_back(std::atan2(along.y(), along.x()));
    if (end.interior) {
      rays.push_back(std::atan2(-along.y(), -along.x()));
      ++passing;
    }
  }
  if (rays.size() == 2) return JunctionType::kL;
  std::sort(rays.begin(), rays.end());
  if (rays.size() == 4) {
    const bool crossing = std::abs(rays[2] - rays[0] - M_PI) < kStraightRad &&
                          std::abs(rays[3] - rays[1] - M_PI) < kStraightRad;
    return crossing ? JunctionType::kX : JunctionType::kMulti;
  }
  if (rays.size() > 4) return JunctionType::kMulti;
  if (passing == 1) return JunctionType::kT;
  double widest = rays.front() + 2.0 * M_PI - rays.back();
  for (size_t k = 0; k + 1 < rays.size(); ++k) widest = std::max(widest, rays[k + 1] - rays[k]);
  if (std::abs(widest - M_PI) < kStraightRad) return JunctionType::kT;
  return widest > M_PI ? JunctionType::kArrow : JunctionType::kY;
}

}  // namespace horopter
