#include "server/vision/recognition/candidates/corner_search.h"

#include <gtest/gtest.h>

#include <Eigen/Geometry>
#include <limits>
#include <random>

#include "tests/support/synthetic_table.h"

namespace horopter {
namespace {

std::vector<FeatureView> FeatureViews(const Table& table) {
  std::vector<FeatureView> views;
  for (std::size_t v = 0; v < table.features.size(); ++v)
    views.push_back({{table.cameras[v], table.camera_from_table[v]}, &table.features[v], 1.0});
  return views;
}

std::vector<KnownView> KnownViews(const Table& table, const JointContext& context) {
  std::vector<KnownView> views;
  for (std::size_t v = 0; v < table.features.size(); ++v)
    views.push_back({{table.cameras[v], table.camera_from_table[v]}, &context.views[v].maps});
  return views;
}

// Any attitude, near the middle of the views.
Rigid3 RandomPose(std::mt19937* rng) {
  std::normal_distribution<double> n;
  std::uniform_real_distribution<double> u(-0.03, 0.03);
  return {Eigen::Quaterniond(n(*rng), n(*rng), n(*rng), n(*rng)).normalized().toRotationMatrix(),
          {u(*rng), u(*rng), 0.03 + u(*rng)}};
}

// Distance of the object's nearest vertex, metres.
double NearestVertex(const PreparedObject& object,
                     const Rigid3& scene_from_object,
                     const Eigen::Vector3d& point) {
  double nearest = 1.0;
  for (const Eigen::Vector3d& v : object.model.vertices)
    nearest = std::min(nearest, (scene_from_object * v - point).norm());
  return nearest;
}

TEST(PoseFromCorner, TakesExactCornersToTheirPlace) {
  const unsigned seed = 3;
  SCOPED_TRACE(testing::Message() << "seed " << seed);
  std::mt19937 rng(seed);
  std::normal_distribution<double> n;
  const auto vector = [&] { return Eigen::Vector3d(n(rng), n(rng), n(rng)); };
  for (int trial = 0; trial < 200; ++trial) {
    const Rigid3 truth = RandomPose(&rng);
    const Eigen::Vector3d vertex = vector(), u = vector().normalized(), v = vector().normalized();
    if (std::abs(u.dot(v)) > 0.99) continue;
    const Rigid3 pose = PoseFromCorner(vertex, u, v, truth * vertex, truth.R * u, truth.R * v);
    EXPECT_LT((pose.R - truth.R).norm(), 1e-9);
    EXPECT_LT((pose.t - truth.t).norm(), 1e-9);
  }
}

TEST(FindSpaceCorners, ShowsVerticesWithTheirEdgesAsNoiseGrows) {
  for (const double noise : {0.0, 0.3, 0.6}) {
    const unsigned seed = 17;
    SCOPED_TRACE(testing::Message() << "seed " << seed << " noise " << noise);
    std::mt19937 rng(seed);
    int corners = 0, right = 0;
    for (int trial = 0; trial < 20; ++trial) {
      const Rigid3 pose = RandomPose(&rng);
      const Table table = MakeTable({{0, pose}}, 4, noise, seed + trial);
      for (const SpaceCorner& c : FindSpaceCorners(FeatureViews(table))) {
        ++corners;
        EXPECT_GE(c.edges.size(), 2u);
        EXPECT_GE(c.views(), 3);
        right += NearestVertex(*table.objects[0], pose, c.point) < 0.0005 + 0.003 * noise;
        for (const SpaceCorner::Edge& e : c.edges) EXPECT_NEAR(e.direction.norm(), 1.0, 1e-9);
      }
    }
    EXPECT_GT(corners, 60);  // of 12 vertices in each scene, where all their edges are seen
    EXPECT_GT(right, 0.95 * corners);
  }
}

TEST(FindSpaceCorners, NeedsTwoViewsAndParallax) {
  std::mt19937 rng(5);
  Table table = MakeTable({{0, RandomPose(&rng)}}, 3, 0.0, 5);
  std::vector<FeatureView> views = FeatureViews(table);
  EXPECT_TRUE(FindSpaceCorners({}).empty());
  EXPECT_TRUE(FindSpaceCorners(std::span(views).first(1)).empty());
  EXPECT_FALSE(FindSpaceCorners(std::span(views).first(2)).empty());
  const std::vector<FeatureView> same(3, views[0]);
  EXPECT_TRUE(FindSpaceCorners(same).empty());
}

TEST(FindSpaceCorners, EndsOnPassingSegmentsAndNoNumbersAreNoCorners) {
  std::mt19937 rng(6);
  Table table = MakeTable({{0, RandomPose(&rng)}}, 3, 0.0, 6);
  Table broken = table;
  for (ImageFeatures& f : broken.features) {
    for (Junction& j : f.junctions) j.point.setConstant(std::numeric_limits<double>::quiet_NaN());
  }
  EXPECT_TRUE(FindSpaceCorners(FeatureViews(broken)).empty());
  for (ImageFeatures& f : table.features) {
    for (Junction& j : f.junctions) {
      for (std::size_t e = 1; e < j.ends.size(); ++e) j.ends[e].interior = true;
    }
  }
  EXPECT_TRUE(FindSpaceCorners(FeatureViews(table)).empty());
}

TEST(PosesFromCorners, FindsPartsInAnyAttitudeAndNotTheOtherPart) {
  const unsigned seed = 29;
  SCOPED_TRACE(testing::Message() << "seed " << seed);
  std::mt19937 rng(seed);
  int found = 0, mistaken = 0;
  constexpr int kTrials = 30;
  for (int trial = 0; trial < kTrials; ++trial) {
    const int object = trial % 2;
    const Rigid3 pose = RandomPose(&rng);
    Table table = MakeTable({{object, pose}}, 4, 0.4, seed + trial);
    const JointContext context = table.Context();
    const std::vector<KnownView> views = KnownViews(table, context);
    const std::vector<SpaceCorner> corners = FindSpaceCorners(FeatureViews(table));
    const auto settled = [&](int k) {
      return SettledPoses(*table.objects[k],
                          views,
                          PosesFromCorners(*table.objects[k], views, corners, {}),
                          CornerSearchOptions().settle);
    };
    const std::vector<PooledPose> own = settled(object), other = settled(1 - object);
    double error = 1e9;
    const PreparedObject& model = *table.objects[object];
    if (!own.empty()) {
      error = LargestError(table, object, own[0].plane_from_object, pose);
      for (const Rigid3& s : model.model.symmetries)
        error = std::min(error, LargestError(table, object, own[0].plane_from_object, pose * s));
    }
    found += error < 1.5;
    mistaken += !own.empty() && !other.empty() && other[0].quick > own[0].quick;
  }
  EXPECT_GE(found, kTrials - 3);
  EXPECT_LE(mistaken, 2);
}

}  // namespace
}  // namespace horopter
