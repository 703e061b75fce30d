#include "server/vision/invariants/similarity_keys.h"

#include <gtest/gtest.h>

#include <Eigen/Geometry>
#include <set>

#include "tests/server/vision/invariants/random_space.h"

namespace horopter {
namespace {

using Four = std::array<Eigen::Vector3d, 4>;

Four RandomFour(RandomSpace& space) {
  Four points;
  for (auto& p : points) p = space.Noise(3);
  return points;
}

Eigen::Matrix3d RandomRotation(RandomSpace& space) {
  return Eigen::Quaterniond(Eigen::Vector4d(space.Noise(4)).normalized()).toRotationMatrix();
}

TEST(SimilarityKeysTest, KeySurvivesSimilaritiesAndMirroringTurnsTheHandedness) {
  RandomSpace space(31);
  for (int trial = 0; trial < 500; ++trial) {
    const Four points = RandomFour(space);
    const auto before = SimilarityKeyOf(points);
    if (!before) continue;
    const double scale = std::exp(space.Normal());
    const Eigen::Matrix3d rotation = RandomRotation(space);
    const Eigen::Vector3d t = space.Noise(3);
    Four moved, mirrored;
    for (int i = 0; i < 4; ++i) {
      moved[i] = scale * rotation * points[i] + t;
      mirrored[i] = -moved[i];
    }
    const auto after = SimilarityKeyOf(moved);
    ASSERT_TRUE(after);
    EXPECT_LT((after->key.values - before->key.values).norm(), 1e-9);
    EXPECT_NEAR(after->log_size, before->log_size + std::log(scale), 1e-9);
    EXPECT_EQ(after->handedness, before->handedness);
    EXPECT_EQ(SimilarityKeyOf(mirrored)->handedness, -before->handedness);
  }
}

TEST(SimilarityKeysTest, CovarianceIsWhatNoiseShows) {
  RandomSpace space(32);
  constexpr double kSigma = 1e-3;
  const Eigen::MatrixXd covariance = kSigma * kSigma * Eigen::MatrixXd::Identity(12, 12);
  const Four points = RandomFour(space);
  const auto stated = SimilarityKeyOf(points, covariance);
  ASSERT_TRUE(stated);
  std::vector<Eigen::VectorXd> samples;
  for (int k = 0; k < 4000; ++k) {
    Four noisy = points;
    for (auto& p : noisy) p += kSigma * space.Noise(3);
    samples.push_back(SimilarityKeyOf(noisy)->key.values);
  }
  EXPECT_LT(CovarianceError(samples, stated->key.covariance), 0.1);
}

TEST(SimilarityKeysTest, RejectsCoincidentAndUncertainPoints) {
  RandomSpace space(33);
  Four points = RandomFour(space);
  EXPECT_FALSE(SimilarityKeyOf(points, 1.0 * Eigen::MatrixXd::Identity(12, 12)));
  points[2] = points[1];
  EXPECT_FALSE(SimilarityKeyOf(points));
}

// A tetrahedron's graph is complete: 4 stars, 12 chains (24 orders, each with its reverse).
TEST(SimilarityKeysTest, ChainsAndStarsOfATetrahedron) {
  ObjectModel model;
  model.vertices.assign(4, Eigen::Vector3d::Zero());
  for (int a = 0; a < 4; ++a) {
    for (int b = a + 1; b < 4; ++b) {
      ModelEdge edge;
      edge.start_vertex = a;
      edge.end_vertex = b;
      model.edges.push_back(edge);
    }
  }
  const auto chains = VertexChains(model);
  EXPECT_EQ(chains.size(), 12u);
  std::set<FourVertices> all;
  for (FourVertices c : chains) {
    all.insert(c);
    std::reverse(c.begin(), c.end());
    all.insert(c);
  }
  EXPECT_EQ(all.size(), 24u);
  EXPECT_EQ(VertexStars(model).size(), 4u);
}

}  // namespace
}  // namespace horopter
