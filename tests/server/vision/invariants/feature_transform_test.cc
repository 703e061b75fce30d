#include "server/vision/invariants/feature_transform.h"

#include <gtest/gtest.h>

#include "tests/server/vision/invariants/random_space.h"

namespace horopter {
namespace {

std::vector<Eigen::VectorXd> SkewKeys(int n, unsigned seed) {
  RandomSpace space(seed);
  std::vector<Eigen::VectorXd> keys;
  for (int i = 0; i < n; ++i) {
    const double x = space.Normal();
    keys.push_back(Eigen::Vector2d(std::exp(space.Normal()), x * std::abs(x)));
  }
  return keys;
}

TEST(FeatureTransformTest, MakesSkewDensitiesFlat) {
  const FeatureTransform transform = FeatureTransform::Fit(SkewKeys(20000, 1), 128, 7).value();
  int histogram[2][10] = {};
  const auto keys = SkewKeys(20000, 2);  // unseen ones
  for (const Eigen::VectorXd& key : keys) {
    const Eigen::VectorXd flat = transform.Apply(key);
    for (int d = 0; d < 2; ++d) {
      ++histogram[d][std::clamp(static_cast<int>(10 * flat(d)), 0, 9)];
    }
  }
  for (const auto& component : histogram) {
    for (const int count : component) EXPECT_NEAR(count, 2000, 200);
  }
}

TEST(FeatureTransformTest, KeepsTheOrderAlsoOutsideTheCatalog) {
  const FeatureTransform transform = FeatureTransform::Fit(SkewKeys(500, 3), 64, 1).value();
  double previous = -INFINITY;
  for (double x = -50.0; x < 50.0; x += 0.01) {
    const double y = transform.Apply(Eigen::VectorXd(Eigen::Vector2d(x, x)))(1);
    EXPECT_GT(y, previous);
    previous = y;
  }
}

TEST(FeatureTransformTest, ManyEqualKeysStayFinite) {
  std::vector<Eigen::VectorXd> keys(1000, Eigen::VectorXd::Constant(1, 0.5));
  keys.push_back(Eigen::VectorXd::Constant(1, 2.0));
  const FeatureTransform transform = FeatureTransform::Fit(keys, 32, 1).value();
  InvariantKey key{Eigen::VectorXd::Constant(1, 0.5), Eigen::MatrixXd::Constant(1, 1, 1e-6)};
  EXPECT_TRUE(transform.Apply(key).covariance.allFinite());
}

TEST(FeatureTransformTest, CovarianceGoesWithTheSlope) {
  const FeatureTransform transform = FeatureTransform::Fit(SkewKeys(20000, 4), 32, 1).value();
  const InvariantKey key{Eigen::Vector2d(1.3, 0.2), 1e-8 * Eigen::Matrix2d::Identity()};
  const InvariantKey flat = transform.Apply(key);
  for (int d = 0; d < 2; ++d) {
    Eigen::VectorXd moved = key.values;
    moved(d) += 1e-4;
    EXPECT_NEAR((transform.Apply(moved)(d) - flat.values(d)) / 1e-4,
                std::sqrt(flat.covariance(d, d)) / 1e-4,
                1e-3);
  }
}

TEST(FeatureTransformTest, RoundTripsThroughItsBlobAndRefusesDamage) {
  const FeatureTransform transform = FeatureTransform::Fit(SkewKeys(100, 5), 16, 42).value();
  const std::string blob = transform.Encode();
  const FeatureTransform read = FeatureTransform::Decode(blob).value();
  EXPECT_EQ(read.catalog_generation(), 42u);
  const Eigen::VectorXd key = Eigen::Vector2d(0.4, -0.4);
  EXPECT_EQ(read.Apply(key), transform.Apply(key));
  for (const size_t size : {size_t{0}, size_t{3}, size_t{19}, blob.size() - 1}) {
    EXPECT_EQ(FeatureTransform::Decode(blob.substr(0, size)).status().code(),
              absl::StatusCode::kDataLoss);
  }
  std::string damaged = blob;
  damaged[0] = 'X';
  EXPECT_FALSE(FeatureTransform::Decode(damaged).ok());
}

TEST(FeatureTransformTest, RefusesWhatItCannotFit) {
  EXPECT_FALSE(FeatureTransform::Fit({}, 16, 0).ok());
  EXPECT_FALSE(FeatureTransform::Fit(SkewKeys(10, 1), 1, 0).ok());
}

}  // namespace
}  // namespace horopter
