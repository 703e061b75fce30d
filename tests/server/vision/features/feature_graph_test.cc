#include "server/vision/features/feature_graph.h"

#include <gtest/gtest.h>

#include <random>

#include "server/vision/features/junctions.h"
#include "tests/server/vision/features/rendered_shapes.h"

namespace horopter {
namespace {

Segment Piece(double x0, double y0, double x1, double y1, float left = 50, float right = 200) {
  Segment s;
  s.start = {x0, y0};
  s.end = {x1, y1};
  s.left_bgr = Eigen::Vector3f::Constant(left);
  s.right_bgr = Eigen::Vector3f::Constant(right);
  return s;
}

ImageFeatures FeaturesOf(std::vector<Segment> segments) {
  ImageFeatures features;
  features.width = 640;
  features.height = 480;
  features.segments = std::move(segments);
  features.junctions = FindJunctions(features.segments, FeatureOptions());
  return features;
}

const GraphEdge* Find(const FeatureGraph& graph, uint32_t from, uint32_t to, FeatureRelation r) {
  for (const GraphEdge& edge : graph.EdgesOf(from)) {
    if (edge.node == to && edge.relation == r) return &edge;
  }
  return nullptr;
}

// Every edge stands at both nodes with the same value and the sides exchanged.
void ExpectSymmetric(const FeatureGraph& graph) {
  size_t seen = 0;
  for (uint32_t node = 0; node < static_cast<uint32_t>(graph.NodeCount()); ++node) {
    for (const GraphEdge& edge : graph.EdgesOf(node)) {
      ++seen;
      ASSERT_LT(edge.node, static_cast<uint32_t>(graph.NodeCount()));
      ASSERT_NE(edge.node, node);
      const GraphEdge* back = Find(graph, edge.node, node, edge.relation);
      ASSERT_NE(back, nullptr);
      EXPECT_EQ(back->value, edge.value);
      EXPECT_EQ((back->sides & kRightOfThis) != 0, (edge.sides & kRightOfOther) != 0);
    }
  }
  EXPECT_EQ(seen, 2 * graph.EdgeCount());
}

TEST(FeatureGraph, CornerRelatesItsSegmentsAndTheirSharedFace) {
  // A bright face to the right of both sides of a corner (y down).
  const ImageFeatures features = FeaturesOf({Piece(100, 100, 200, 100), Piece(200, 100, 200, 200)});
  ASSERT_EQ(features.junctions.size(), 1u);
  const FeatureGraph graph = BuildFeatureGraph(features, FeatureGraphOptions());
  ExpectSymmetric(graph);
  const uint32_t corner = graph.Node(FeatureKind::kJunction, 0);
  EXPECT_EQ(graph.KindOf(corner), FeatureKind::kJunction);
  EXPECT_EQ(graph.IndexOf(corner), 0);
  EXPECT_NE(Find(graph, 0, corner, FeatureRelation::kMeetsAt), nullptr);
  const GraphEdge* shared = Find(graph, 0, 1, FeatureRelation::kSharesJunction);
  ASSERT_NE(shared, nullptr);
  EXPECT_NEAR(shared->value, M_PI / 2, 1e-6);
  const GraphEdge* region = Find(graph, 0, 1, FeatureRelation::kSameRegion);
  ASSERT_NE(region, nullptr);
  EXPECT_EQ(region->sides, kRightOfThis | kRightOfOther);
}

TEST(FeatureGraph, TellsCollinearFromParallelAndLeavesTheRest) {
  const ImageFeatures features = FeaturesOf({Piece(100, 100, 200, 100),
                                             Piece(220, 100.4, 300, 100.4),  // goes on
                                             Piece(100, 120, 200, 122),      // beside
                                             Piece(100, 300, 200, 300)});    // far away
  const FeatureGraph graph = BuildFeatureGraph(features, FeatureGraphOptions());
  ExpectSymmetric(graph);
  const GraphEdge* collinear = Find(graph, 0, 1, FeatureRelation::kCollinear);
  ASSERT_NE(collinear, nullptr);
  EXPECT_NEAR(collinear->value, 20.0, 1e-3);
  const GraphEdge* parallel = Find(graph, 0, 2, FeatureRelation::kParallel);
  ASSERT_NE(parallel, nullptr);
  EXPECT_NEAR(parallel->value, 21.0, 0.5);
  EXPECT_EQ(Find(graph, 0, 2, FeatureRelation::kCollinear), nullptr);
  EXPECT_TRUE(graph.EdgesOf(3).empty());
}

TEST(FeatureGraph, FacingSidesOfDifferentColourAreNoRegion) {
  // Right of the first (below it, bright) faces left of the second (above it, dark).
  const ImageFeatures features = FeaturesOf({Piece(100, 100, 200, 100), Piece(100, 120, 200, 120)});
  const FeatureGraph graph = BuildFeatureGraph(features, FeatureGraphOptions());
  EXPECT_NE(Find(graph, 0, 1, FeatureRelation::kParallel), nullptr);
  EXPECT_EQ(Find(graph, 0, 1, FeatureRelation::kSameRegion), nullptr);
}

TEST(FeatureGraph, EmptyAndSingleFeatures) {
  const FeatureGraph empty = BuildFeatureGraph(ImageFeatures(), FeatureGraphOptions());
  EXPECT_EQ(empty.NodeCount(), 0);
  EXPECT_EQ(empty.EdgeCount(), 0u);
  const FeatureGraph one = BuildFeatureGraph(FeaturesOf({Piece(0, 0, 50, 0)}), {});
  EXPECT_EQ(one.NodeCount(), 1);
  EXPECT_EQ(one.EdgeCount(), 0u);
}

TEST(FeatureGraph, NeighboursAreBoundedInDenseTexture) {
  // A comb of 2000 parallel segments 3 px apart.
  std::vector<Segment> comb;
  for (int k = 0; k < 2000; ++k) comb.push_back(Piece(10, 3.0 * k, 40, 3.0 * k, 100, 100));
  ImageFeatures features;
  features.segments = comb;
  FeatureGraphOptions options;
  const FeatureGraph graph = BuildFeatureGraph(features, options);
  ExpectSymmetric(graph);
  // Parallel and region, each asked for from both sides.
  EXPECT_LE(graph.EdgeCount(), 2000u * 2u * options.max_neighbours);
  for (Segment& s : features.segments) s.in_texture = true;
  EXPECT_EQ(BuildFeatureGraph(features, options).EdgeCount(), 0u);
}

TEST(FeatureGraph, RenderedPlateWithBoreIsOneConnectedShape) {
  std::mt19937 rng(11);
  ShapeRenderOptions render;
  cv::Mat image = RenderPolygon({{60, 50}, {260, 60}, {250, 190}, {70, 180}}, render, &rng);
  std::vector<cv::Point> rim;
  for (const Eigen::Vector2d& p : EllipsePolygon({160, 120}, 40, 25, 0.2)) {
    rim.emplace_back(static_cast<int>(p.x() * 16), static_cast<int>(p.y() * 16));
  }
  cv::fillPoly(image, std::vector<std::vector<cv::Point>>{rim}, render.background, cv::LINE_AA, 4);
  const absl::StatusOr<ImageFeatures> features = DetectFeatures(image, FeatureOptions());
  ASSERT_TRUE(features.ok());
  ASSERT_EQ(features->arcs.size(), 1u);
  EXPECT_EQ(features->junctions.size(), 4u);
  const FeatureGraph graph = BuildFeatureGraph(*features, FeatureGraphOptions());
  ExpectSymmetric(graph);
  int sides = 0;
  for (size_t i = 0; i < features->segments.size(); ++i) {
    const Segment& s = features->segments[i];
    if (s.arc >= 0) {
      EXPECT_NE(Find(graph,
                     static_cast<uint32_t>(i),
                     graph.Node(FeatureKind::kArc, s.arc),
                     FeatureRelation::kChordOf),
                nullptr);
      continue;
    }
    ++sides;
    int corners = 0;
    for (const GraphEdge& edge : graph.EdgesOf(static_cast<uint32_t>(i))) {
      corners += edge.relation == FeatureRelation::kSharesJunction ? 1 : 0;
    }
    EXPECT_EQ(corners, 2);
  }
  EXPECT_EQ(sides, 4);
}

}  // namespace
}  // namespace horopter
