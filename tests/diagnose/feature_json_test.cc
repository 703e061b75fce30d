#include "tests/diagnose/feature_json.h"

#include <gtest/gtest.h>

#include <array>
#include <limits>
#include <nlohmann/json.hpp>

#include "server/vision/features/junctions.h"

namespace horopter {
namespace {

TEST(FeaturesToJson, WritesEveryFeatureAndEachEdgeOnce) {
  ImageFeatures features;
  for (const auto& [x0, y0, x1, y1] : {std::array{100.0, 100.0, 200.0, 100.0},
                                       std::array{200.0, 100.0, 200.0, 200.0},
                                       std::array{0.0, 300.0, 50.0, 300.0}}) {
    Segment segment;
    segment.start = {x0, y0};
    segment.end = {x1, y1};
    features.segments.push_back(segment);
  }
  features.junctions = FindJunctions(features.segments, FeatureOptions());
  features.arcs.push_back({{300, 300}, 40, 20, 0.1, 0.0, 3.0, 0.2});
  features.segments[2].rms_px = std::numeric_limits<double>::quiet_NaN();
  const FeatureGraph graph = BuildFeatureGraph(features, FeatureGraphOptions());
  const auto json = nlohmann::json::parse(FeaturesToJson(features, graph));
  EXPECT_EQ(json["segments"].size(), 3u);
  EXPECT_TRUE(json["segments"][2]["rms_px"].is_null());
  EXPECT_EQ(json["arcs"].size(), 1u);
  EXPECT_EQ(json["junctions"][0]["type"], "L");
  EXPECT_EQ(json["edges"].size(), graph.EdgeCount());
  EXPECT_EQ(json["edges"][0]["from"], "segment:0");
}

}  // namespace
}  // namespace horopter
