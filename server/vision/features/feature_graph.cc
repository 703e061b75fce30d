#include "server/vision/features/feature_graph.h"

#include <algorithm>
#include <cmath>
#include <tuple>
#include <unordered_map>

#include "server/base/stop_scope.h"

namespace horopter {
namespace {

constexpr int kSegmentsPerLook = 64;  // at the stop flag: some 0.1 ms

}  // namespace

FeatureKind FeatureGraph::KindOf(uint32_t node) const {
  int kind = 0;
  while (kind < 3 && node >= first_[kind + 1]) ++kind;
  return static_cast<FeatureKind>(kind);
}

int FeatureGraph::IndexOf(uint32_t node) const {
  return static_cast<int>(node - first_[static_cast<int>(KindOf(node))]);
}

size_t FeatureGraph::Bytes() const {
  return begin_.capacity() * sizeof(begin_[0]) + edges_.capacity() * sizeof(edges_[0]);
}

class FeatureGraphBuilder {
 public:
  FeatureGraphBuilder(const ImageFeatures& features, const FeatureGraphOptions& options)
      : features_(features), options_(options) {
    const size_t sizes[] = {features.segments.size(),
                            features.arcs.size(),
                            features.junctions.size(),
                            features.conic_junctions.size()};
    for (int k = 0; k < 4; ++k) {
      graph_.first_[k + 1] = graph_.first_[k] + static_cast<uint32_t>(sizes[k]);
    }
  }

  FeatureGraph Build() {
    AddJunctions();
    AddConicJunctions();
    for (size_t i = 0; i < features_.segments.size(); ++i) {
      if (features_.segments[i].arc >= 0) {
        Add({SegmentNode(i),
             ArcNode(features_.segments[i].arc),
             FeatureRelation::kChordOf,
             0,
             0.0f});
      }
    }
    AddNeighbours();
    LeaveIfStopped();
    return Compress();
  }

 private:
  struct Pair {
    uint32_t a, b;
    FeatureRelation relation;
    uint8_t sides;  // of a's edge
    float value;
  };

  uint32_t SegmentNode(size_t i) const { return static_cast<uint32_t>(i); }
  uint32_t ArcNode(int i) const { return graph_.Node(FeatureKind::kArc, i); }
  void Add(const Pair& pair) { pairs_.push_back(pair); }

  void AddJunctions() {
    for (size_t j = 0; j < features_.junctions.size(); ++j) {
      const Junction& junction = features_.junctions[j];
      const uint32_t node = graph_.Node(FeatureKind::kJunction, static_cast<int>(j));
      for (size_t e = 0; e < junction.ends.size(); ++e) {
        const Junction::End& end = junction.ends[e];
        const float where = end.interior ? 2.0f : end.at_start ? 0.0f : 1.0f;
        Add({SegmentNode(end.segment), node, FeatureRelation::kMeetsAt, 0, where});
        for (size_t f = e + 1; f < junction.ends.size(); ++f) {
          const Segment& a = features_.segments[end.segment];
          const Segment& b = features_.segments[junction.ends[f].segment];
          const double angle = AngleBetween(Leaving(a, end), Leaving(b, junction.ends[f]));
          Add({SegmentNode(end.segment),
               SegmentNode(junction.ends[f].segment),
               FeatureRelation::kSharesJunction,
               0,
               static_cast<float>(angle)});
          AddRegion(end.segment, junction.ends[f].segment);
        }
      }
    }
  }

  void AddConicJunctions() {
    for (size_t j = 0; j < features_.conic_junctions.size(); ++j) {
      const ConicJunction& junction = features_.conic_junctions[j];
      const uint32_t node = graph_.Node(FeatureKind::kConicJunction, static_cast<int>(j));
      Add({SegmentNode(junction.segment),
           node,
           FeatureRelation::kMeetsAt,
           0,
           junction.at_start ? 0.0f : 1.0f});
      Add({ArcNode(junction.arc),
           node,
           FeatureRelation::kMeetsAt,
           0,
           junction.at_arc_end ? 1.0f : 2.0f});
      Add({SegmentNode(junction.segment),
           ArcNode(junction.arc),
           FeatureRelation::kSharesJunction,
           0,
           junction.tangent ? 0.0f : static_cast<float>(0.5 * M_PI)});
    }
  }

  static Eigen::Vector2d Leaving(const Segment& segment, const Junction::End& end) {
    return end.at_start || end.interior ? Eigen::Vector2d(segment.end - segment.start)
                                        : Eigen::Vector2d(segment.start - segment.end);
  }

  static double AngleBetween(const Eigen::Vector2d& a, const Eigen::Vector2d& b) {
    return std::atan2(std::abs(a.x() * b.y() - a.y() * b.x()), a.dot(b));
  }

  // The sides on which the two lie of each other, if these have one colour.
  void AddRegion(int i, int j) {
    const Segment& a = features_.segments[i];
    const Segment& b = features_.segments[j];
    const auto right_of = [](const Segment& line, const Segment& other) {
      const Eigen::Vector2d d = line.end - line.start;
      const Eigen::Vector2d q = 0.5 * (other.start + other.end) - line.start;
      return d.x() * q.y() - d.y() * q.x() > 0.0;  // y down
    };
    const bool of_a = right_of(a, b), of_b = right_of(b, a);
    const float distance =
        ((of_a ? a.right_bgr : a.left_bgr) - (of_b ? b.right_bgr : b.left_bgr)).norm();
    if (distance <= static_cast<float>(options_.max_region_colour)) {
      Add({SegmentNode(i),
           SegmentNode(j),
           FeatureRelation::kSameRegion,
           static_cast<uint8_t>((of_a ? kRightOfThis : 0) | (of_b ? kRightOfOther : 0)),
           distance});
    }
  }

  // Pairs of segments with points in neighbouring cells.
  void AddNeighbours() {
    const double cell = options_.reach_px;
    std::unordered_map<int64_t, std::vector<int>> cells;
    const auto key = [cell](const Eigen::Vector2d& p, int dx, int dy) {
      return (static_cast<int64_t>(std::floor(p.y() / cell)) + dy + 4096) * 65536 +
             static_cast<int64_t>(std::floor(p.x() / cell)) + dx + 4096;
    };
    const auto for_each_point = [&](const Segment& s, const auto& visit) {
      const int steps = static_cast<int>(s.Length() / (0.5 * cell)) + 1;
      for (int k = 0; k <= steps; ++k) {
        visit(Eigen::Vector2d(s.start + (s.end - s.start) * (static_cast<double>(k) / steps)));
      }
    };
    StopPacer pacer(kSegmentsPerLook);
    for (size_t i = 0; i < features_.segments.size(); ++i) {
      pacer.Step();
      if (features_.segments[i].in_texture) continue;
      for_each_point(features_.segments[i], [&](const Eigen::Vector2d& p) {
        std::vector<int>& ids = cells[key(p, 0, 0)];
        if (ids.empty() || ids.back() != static_cast<int>(i)) ids.push_back(static_cast<int>(i));
      });
    }
    std::vector<int> near;
    for (size_t i = 0; i < features_.segments.size(); ++i) {
      pacer.Step();
      if (features_.segments[i].in_texture) continue;
      near.clear();
      for_each_point(features_.segments[i], [&](const Eigen::Vector2d& p) {
        for (int dy = -1; dy <= 1; ++dy) {
          for (int dx = -1; dx <= 1; ++dx) {
            if (const auto it = cells.find(key(p, dx, dy)); it != cells.end()) {
              near.insert(near.end(), it->second.begin(), it->second.end());
            }
          }
        }
      });
      std::sort(near.begin(), near.end());
      near.erase(std::unique(near.begin(), near.end()), near.end());
      Relate(static_cast<int>(i), near);
    }
  }

  // Keeps the nearest of each relation; a pair is looked at from both sides and added once, in
  // Compress().
  void Relate(int i, const std::vector<int>& near) {
    std::vector<std::pair<double, int>> collinear, parallel;
    const Segment& a = features_.segments[i];
    const Eigen::Vector2d u = (a.end - a.start).normalized();
    const double length = a.Length();
    for (int j : near) {
      if (j == i) continue;
      const Segment& b = features_.segments[j];
      const Eigen::Vector2d v = (b.end - b.start).normalized();
      const double sine = std::abs(u.x() * v.y() - u.y() * v.x());
      if (sine > std::sin(std::max(options_.parallel_rad, options_.collinear_rad))) continue;
      const Eigen::Vector2d q = 0.5 * (b.start + b.end) - a.start;
      const double offset = std::abs(u.x() * q.y() - u.y() * q.x());
      double s0 = u.dot(b.start - a.start), s1 = u.dot(b.end - a.start);
      if (s0 > s1) std::swap(s0, s1);
      const double overlap = std::min(s1, length) - std::max(s0, 0.0);
      // The longer one's line is the one to trust.
      if (sine <= std::sin(options_.collinear_rad) && overlap <= 0.0 &&
          -overlap <= options_.reach_px && OffsetFromLonger(a, b) <= options_.collinear_px) {
        collinear.emplace_back(-overlap, j);
      } else if (sine <= std::sin(options_.parallel_rad) &&
                 overlap >= options_.parallel_overlap * std::min(length, b.Length()) &&
                 offset >= options_.min_parallel_px && offset <= options_.reach_px) {
        parallel.emplace_back(offset, j);
      }
    }
    for (auto [list, relation] : {std::pair(&collinear, FeatureRelation::kCollinear),
                                  std::pair(&parallel, FeatureRelation::kParallel)}) {
      const size_t count = std::min<size_t>(list->size(), options_.max_neighbours);
      std::partial_sort(list->begin(), list->begin() + count, list->end());
      for (size_t k = 0; k < count; ++k) {
        const auto [value, j] = (*list)[k];
        Add({SegmentNode(i), SegmentNode(j), relation, 0, static_cast<float>(value)});
        if (relation == FeatureRelation::kParallel) AddRegion(i, j);
      }
    }
  }

  static double OffsetFromLonger(const Segment& a, const Segment& b) {
    const Segment& line = a.Length() >= b.Length() ? a : b;
    const Segment& piece = a.Length() >= b.Length() ? b : a;
    const Eigen::Vector2d u = (line.end - line.start).normalized();
    const Eigen::Vector2d q = 0.5 * (piece.start + piece.end) - line.start;
    return std::abs(u.x() * q.y() - u.y() * q.x());
  }

  FeatureGraph Compress() {
    for (Pair& pair : pairs_) {
      if (pair.a > pair.b) {
        std::swap(pair.a, pair.b);
        pair.sides = Mirrored(pair.sides);
      }
    }
    const auto order = [](const Pair& p) { return std::tie(p.a, p.b, p.relation, p.value); };
    std::sort(pairs_.begin(), pairs_.end(), [&](const Pair& p, const Pair& q) {
      return order(p) < order(q);
    });
    LeaveIfStopped();
    // One edge of a relation between two nodes; a segment may meet a junction at one place only.
    pairs_.erase(std::unique(pairs_.begin(),
                             pairs_.end(),
                             [](const Pair& p, const Pair& q) {
                               return p.a == q.a && p.b == q.b && p.relation == q.relation;
                             }),
                 pairs_.end());
    std::vector<uint32_t>& begin = graph_.begin_;
    begin.assign(graph_.first_[4] + 1, 0);
    for (const Pair& pair : pairs_) {
      ++begin[pair.a + 1];
      ++begin[pair.b + 1];
    }
    for (size_t n = 1; n < begin.size(); ++n) begin[n] += begin[n - 1];
    std::vector<uint32_t> next(begin.begin(), begin.end() - 1);
    graph_.edges_.resize(2 * pairs_.size());
    for (const Pair& p : pairs_) {
      graph_.edges_[next[p.a]++] = {p.b, p.relation, p.sides, p.value};
      graph_.edges_[next[p.b]++] = {p.a, p.relation, Mirrored(p.sides), p.value};
    }
    for (size_t n = 0; n + 1 < begin.size(); ++n) {
      std::sort(graph_.edges_.begin() + begin[n],
                graph_.edges_.begin() + begin[n + 1],
                [](const GraphEdge& p, const GraphEdge& q) {
                  return std::tie(p.relation, p.value, p.node) <
                         std::tie(q.relation, q.value, q.node);
                });
    }
    return std::move(graph_);
  }

  static uint8_t Mirrored(uint8_t sides) {
    return static_cast<uint8_t>((sides & kRightOfThis ? kRightOfOther : 0) |
                                (sides & kRightOfOther ? kRightOfThis : 0));
  }

  const ImageFeatures& features_;
  const FeatureGraphOptions options_;
  FeatureGraph graph_;
  std::vector<Pair> pairs_;
};

FeatureGraph BuildFeatureGraph(const ImageFeatures& features, const FeatureGraphOptions& options) {
  return FeatureGraphBuilder(features, options).Build();
}

std::string NameOf(FeatureRelation relation) {
  switch (relation) {
    case FeatureRelation::kMeetsAt:
      return "meets_at";
    case FeatureRelation::kSharesJunction:
      return "shares_junction";
    case FeatureRelation::kCollinear:
      return "collinear";
    case FeatureRelation::kParallel:
      return "parallel";
    case FeatureRelation::kSameRegion:
      return "same_region";
    case FeatureRelation::kChordOf:
      return "chord_of";
  }
  return "";
}

std::string NameOf(JunctionType type) {
  switch (type) {
    case JunctionType::kL:
      return "L";
    case JunctionType::kT:
      return "T";
    case JunctionType::kArrow:
      return "arrow";
    case JunctionType::kY:
      return "Y";
    case JunctionType::kX:
      return "X";
    case JunctionType::kMulti:
      return "multi";
  }
  return "";
}

}  // namespace horopter
