#include "server/vision/geometry/model_features.h"

#include <gtest/gtest.h>

#include <cmath>
#include <numbers>

namespace horopter {
namespace {

ModelEdge Circle(const Eigen::Vector3d& center, double radius) {
  ModelEdge edge;
  edge.kind = CurveKind::kCircle;
  for (int i = 0; i <= 48; ++i) {
    const double a = 2.0 * std::numbers::pi * (i % 48) / 48;
    edge.polyline.push_back(center + radius * Eigen::Vector3d(std::cos(a), std::sin(a), 0.0));
  }
  return edge;
}

// A plate of 100 x 60 x 4 mm, drilled through at two places, with a pocket of 20 x 10 mm.
ObjectModel Plate() {
  ObjectModel model;
  model.diameter_m = 0.117;
  const auto rectangle = [&](double x, double y, double z, double a, double b) {
    const int first = static_cast<int>(model.vertices.size());
    model.vertices.insert(model.vertices.end(),
                          {{x, y, z}, {x + a, y, z}, {x + a, y + b, z}, {x, y + b, z}});
    for (int i = 0; i < 4; ++i) {
      const int p = first + i, q = first + (i + 1) % 4;
      model.edges.push_back({CurveKind::kLine, p, q, 1.57, {model.vertices[p], model.vertices[q]}});
    }
    return first;
  };
  const auto wall = [&](int p, int q) {
    model.edges.push_back({CurveKind::kLine, p, q, 1.57, {model.vertices[p], model.vertices[q]}});
  };
  const int bottom = rectangle(0, 0, 0, 0.1, 0.06), top = rectangle(0, 0, 0.004, 0.1, 0.06);
  const int floor = rectangle(0.04, 0.02, 0.002, 0.02, 0.01);
  const int rim = rectangle(0.04, 0.02, 0.004, 0.02, 0.01);
  for (int i = 0; i < 4; ++i) wall(bottom + i, top + i), wall(floor + i, rim + i);
  for (const double z : {0.0, 0.004}) {
    model.edges.push_back(Circle({0.015, 0.03, z}, 0.004));
    model.edges.push_back(Circle({0.085, 0.03, z}, 0.003));
  }
  return model;
}

TEST(ModelFeatures, AreWhatHangsTogetherAndIsNotThePart) {
  const ObjectModel plate = Plate();
  const std::vector<ModelFeature> found = FindModelFeatures(plate);
  ASSERT_EQ(found.size(), 3u);  // the pocket, two holes
  EXPECT_NEAR(found[0].size_m, 0.02, 1e-9);
  EXPECT_LT((found[0].place - Eigen::Vector3d(0.05, 0.025, 0.003)).norm(), 1e-9);
  EXPECT_NEAR(found[1].size_m, 0.008, 1e-4);
  EXPECT_NEAR(found[2].size_m, 0.006, 1e-4);
}

TEST(ModelFeatures, SmallOnesAndNoMoreThanAskedFor) {
  ModelFeatureOptions options;
  options.min_size = 0.06;
  EXPECT_EQ(FindModelFeatures(Plate(), options).size(), 2u);  // without the hole of 6 mm
  options.most = 1;
  EXPECT_EQ(FindModelFeatures(Plate(), options).size(), 1u);
}

TEST(ModelFeatures, OfNothingAreNone) {
  EXPECT_TRUE(FindModelFeatures(ObjectModel()).empty());
  ObjectModel ball;
  ball.diameter_m = 0.05;
  EXPECT_TRUE(FindModelFeatures(ball).empty());
  ModelEdge empty;
  ball.edges.push_back(empty);
  EXPECT_TRUE(FindModelFeatures(ball).empty());
  EXPECT_EQ(FeatureMap({}, 0.05).At({0, 0, 0}), -1);
}

TEST(FeatureMap, SaysWhoseAPlaceIs) {
  const ObjectModel plate = Plate();
  const std::vector<ModelFeature> found = FindModelFeatures(plate);
  const FeatureMap map(found, plate.diameter_m);
  const double reach = 1.5 * kFeatureSpacing * plate.diameter_m;
  for (std::size_t f = 0; f < found.size(); ++f) {
    for (const Eigen::Vector3d& p : found[f].points) {
      const int at = map.At(p + Eigen::Vector3d(0, 0, 0.2 * reach));
      EXPECT_EQ(at, static_cast<int>(f));
    }
  }
  EXPECT_EQ(map.At({0.05, 0.0, 0.004}), -1);    // the plate's own edge
  EXPECT_EQ(map.At({0.015, 0.03, 0.004}), -1);  // the middle of a hole
  EXPECT_EQ(map.At({-1e3, 2e4, -7e5}), -1);     // far outside
}

}  // namespace
}  // namespace horopter
