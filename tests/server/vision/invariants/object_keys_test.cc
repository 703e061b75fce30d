#include "server/vision/invariants/object_keys.h"

#include <gtest/gtest.h>

#include <Eigen/Geometry>
#include <algorithm>
#include <random>

#include "server/vision/invariants/six_points.h"
#include "tests/server/vision/invariants/random_space.h"

namespace horopter {
namespace {

// A frame of straight edges over random corners: a path through all of them and some chords.
ObjectModel RandomFrame(std::mt19937& rng, int corners) {
  std::uniform_real_distribution<double> u(-0.05, 0.05);
  ObjectModel model;
  model.id = "frame";
  model.diameter_m = 0.15;
  for (int i = 0; i < corners; ++i) model.vertices.emplace_back(u(rng), u(rng), u(rng));
  for (int i = 0; i < corners; ++i) {
    for (const int j : {(i + 1) % corners, (i + 3) % corners}) {
      ModelEdge edge;
      edge.start_vertex = i;
      edge.end_vertex = j;
      edge.polyline = {model.vertices[i], model.vertices[j]};
      model.edges.push_back(edge);
    }
  }
  return model;
}

TEST(ObjectKeys, AreTheKeysOfTheVerticesTheyName) {
  std::mt19937 rng(1);
  const ObjectModel model = RandomFrame(rng, 10);
  const ObjectKeys keys = ComputeObjectKeys(model);
  ASSERT_FALSE(keys.chains.empty());
  ASSERT_FALSE(keys.stars.empty());
  ASSERT_FALSE(keys.six_points.empty());
  for (const FourVertexKey& key : keys.chains) {
    std::array<Eigen::Vector3d, 4> points;
    for (int k = 0; k < 4; ++k) points[k] = model.vertices[key.vertices[k]];
    const auto expected = SimilarityKeyOf(points);
    ASSERT_TRUE(expected.has_value());
    for (int k = 0; k < 5; ++k) EXPECT_FLOAT_EQ(key.values[k], float(expected->key.values(k)));
  }
  for (const SixVertexKey& key : keys.six_points) {
    std::array<Eigen::Vector4d, 6> points;
    for (int k = 0; k < 6; ++k) points[k] = model.vertices[key.vertices[k]].homogeneous();
    const auto expected = InvariantsOfSixPoints(points);
    ASSERT_TRUE(expected.has_value());
    // The vertices are in the order of the stored labeling: it is one of theirs, in that order.
    double nearest = 1e9;
    for (const SixPointLabeling& labeling : expected->labelings) {
      bool in_order = true;
      for (int k = 0; k < 6; ++k) in_order &= labeling.groups[k] == std::vector<int>{k};
      if (!in_order) continue;
      double gap = 0.0;
      for (int k = 0; k < 3; ++k)
        gap = std::max(gap, std::abs(labeling.key.values(k) - key.values[k]));
      nearest = std::min(nearest, gap);
    }
    EXPECT_LT(nearest, 1e-4);
  }
}

TEST(ObjectKeys, StayTheSameUnderASimilarityAndSixPointsUnderACollineation) {
  std::mt19937 rng(2);
  const ObjectModel model = RandomFrame(rng, 8);
  const ObjectKeys keys = ComputeObjectKeys(model);
  ObjectModel moved = model;
  const Eigen::Matrix3d turn =
      Eigen::AngleAxisd(1.1, Eigen::Vector3d(1, -2, 0.5).normalized()).toRotationMatrix();
  for (Eigen::Vector3d& v : moved.vertices) v = 2.5 * (turn * v) + Eigen::Vector3d(1, 2, 3);
  const ObjectKeys same = ComputeObjectKeys(moved);
  ASSERT_EQ(same.chains.size(), keys.chains.size());
  for (size_t i = 0; i < keys.chains.size(); ++i) {
    EXPECT_EQ(same.chains[i].handedness, keys.chains[i].handedness);
    EXPECT_NEAR(same.chains[i].log_size - keys.chains[i].log_size, std::log(2.5), 1e-4);
    for (int k = 0; k < 5; ++k) {
      EXPECT_NEAR(same.chains[i].values[k], keys.chains[i].values[k], 1e-4);
    }
  }
  ASSERT_EQ(same.six_points.size(), keys.six_points.size());
}

TEST(ObjectKeys, AreTheSameEveryTimeAndWithinTheirLimits) {
  std::mt19937 rng(3);
  const ObjectModel model = RandomFrame(rng, 60);
  const ObjectKeyOptions options{
      .max_chains = 50, .max_stars = 20, .six_point_sets = 100, .max_six_points = 10};
  const ObjectKeys keys = ComputeObjectKeys(model, options);
  EXPECT_EQ(keys, ComputeObjectKeys(model, options));
  EXPECT_LE(keys.chains.size(), 50u);
  EXPECT_LE(keys.stars.size(), 20u);
  EXPECT_LE(keys.six_points.size(), 10u);
  EXPECT_EQ(ComputeObjectKeys({}), ObjectKeys{});
}

TEST(ObjectKeys, BytesRoundTripAndDamageIsDataLoss) {
  std::mt19937 rng(4);
  const ObjectModel model = RandomFrame(rng, 12);
  const ObjectKeys keys = ComputeObjectKeys(model);
  const std::string bytes = EncodeObjectKeys(keys);
  EXPECT_EQ(*DecodeObjectKeys(bytes, 12), keys);
  EXPECT_EQ(DecodeObjectKeys(bytes, 5).status().code(), absl::StatusCode::kDataLoss);
  EXPECT_EQ(DecodeObjectKeys(bytes + "x", 12).status().code(), absl::StatusCode::kDataLoss);
  for (size_t cut = 0; cut < bytes.size(); cut += 7) {
    EXPECT_EQ(DecodeObjectKeys(bytes.substr(0, cut), 12).status().code(),
              absl::StatusCode::kDataLoss);
  }
}

}  // namespace
}  // namespace horopter
