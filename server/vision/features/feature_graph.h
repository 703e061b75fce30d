// The feature graph (thesis 2.6): what lies next to what, in one compact structure.
#pragma once

#include <cstdint>
#include <span>
#include <string>
#include <vector>

#include "server/vision/features/features.h"

namespace horopter {

enum class FeatureKind : uint8_t { kSegment, kArc, kJunction, kConicJunction };

enum class FeatureRelation : uint8_t {
  kMeetsAt,         // segment or arc and junction; value: 0 start, 1 end, 2 passes
  kSharesJunction,  // two features; value: angle between them in the junction, rad
  kCollinear,       // two segments of one line; value: gap along it, px
  kParallel,        // two segments side by side; value: distance, px
  kSameRegion,      // two segments whose facing sides have one colour; value: colour distance
  kChordOf,         // segment and arc; value: 0
};

// Sides of a kSameRegion edge.
constexpr uint8_t kRightOfThis = 1;   // else left
constexpr uint8_t kRightOfOther = 2;  // else left

struct GraphEdge {
  uint32_t node = 0;
  FeatureRelation relation = FeatureRelation::kMeetsAt;
  uint8_t sides = 0;
  float value = 0.0f;
};

// Nodes are numbered segments first, then arcs, junctions, conic junctions, in the order of
// ImageFeatures. Every edge is stored at both of its nodes; a node's edges lie together, sorted by
// relation and then by value.
class FeatureGraph {
 public:
  int NodeCount() const { return static_cast<int>(begin_.size()) - 1; }
  uint32_t Node(FeatureKind kind, int index) const {
    return first_[static_cast<int>(kind)] + static_cast<uint32_t>(index);
  }
  FeatureKind KindOf(uint32_t node) const;
  int IndexOf(uint32_t node) const;
  std::span<const GraphEdge> EdgesOf(uint32_t node) const {
    return std::span(edges_).subspan(begin_[node], begin_[node + 1] - begin_[node]);
  }
  // Each edge counted once.
  size_t EdgeCount() const { return edges_.size() / 2; }
  size_t Bytes() const;

 private:
  friend class FeatureGraphBuilder;
  uint32_t first_[5] = {0, 0, 0, 0, 0};
  std::vector<uint32_t> begin_ = {0};
  std::vector<GraphEdge> edges_;
};

// Builds the graph in time linear in features x neighbours. Segments in texture take part only in
// what they meet.
FeatureGraph BuildFeatureGraph(const ImageFeatures& features, const FeatureGraphOptions& options);

// Name of a relation or junction type as the dump writes it, e.g. "shares_junction", "arrow".
std::string NameOf(FeatureRelation relation);
std::string NameOf(JunctionType type);

}  // namespace horopter
