#include "server/vision/recognition/candidates/shortlist.h"

#include <gtest/gtest.h>

#include <Eigen/Geometry>
#include <random>

#include "tests/support/synthetic_part.h"
#include "tests/support/synthetic_table.h"

namespace horopter {
namespace {

// The objects of every table, and boxes that nobody placed.
std::vector<std::shared_ptr<const PreparedObject>> WithBoxes(int boxes) {
  std::vector<std::shared_ptr<const PreparedObject>> out = Table().objects;
  std::mt19937 rng(7);
  std::uniform_real_distribution<double> size(0.02, 0.12);
  for (int i = 0; i < boxes; ++i) {
    const double x = size(rng), y = size(rng);
    out.push_back(PrepareObject(Prism("box", {{0, 0}, {x, 0}, {x, y}, {0, y}}, size(rng))).value());
  }
  return out;
}

TEST(Largest, TakesTheLargestAboveZeroInOrder) {
  const std::vector<double> values = {0.5, 0.0, 2.0, -1.0, 0.5, 3.0};
  EXPECT_EQ(Largest(values, 3), (std::vector<int>{5, 2, 0}));
  EXPECT_EQ(Largest(values, 9), (std::vector<int>{5, 2, 0, 4}));
  EXPECT_TRUE(Largest({}, 3).empty());
}

TEST(PromisingInSpace, ASmallCatalogIsSearchedAsAWhole) {
  const std::vector<std::shared_ptr<const PreparedObject>> none(ShortlistOptions().searched);
  const Shortlist all = PromisingInSpace(none, {}, {}, {}, {}, {}, 1);
  EXPECT_EQ(all.searched, std::vector<bool>(none.size(), true));
}

TEST(PromisingInSpace, FindsThePartAmongManyAndAsksNoMoreThanItIsTold) {
  ShortlistOptions options;
  options.searched = 4;
  const auto objects = WithBoxes(12);
  int found = 0;
  constexpr int kTrials = 4;
  for (int trial = 0; trial < kTrials; ++trial) {
    const unsigned seed = 41 + trial;
    SCOPED_TRACE(testing::Message() << "seed " << seed);
    std::mt19937 rng(seed);
    std::normal_distribution<double> n;
    const Rigid3 pose = {
        Eigen::Quaterniond(n(rng), n(rng), n(rng), n(rng)).normalized().toRotationMatrix(),
        {0.0, 0.0, 0.03}};
    Table table = MakeTable({{trial % 2, pose}}, 4, 0.4, seed);
    const JointContext context = table.Context();
    std::vector<FeatureView> features;
    std::vector<KnownView> views;
    for (std::size_t v = 0; v < table.features.size(); ++v) {
      features.push_back({{table.cameras[v], table.camera_from_table[v]}, &table.features[v], 1.0});
      views.push_back({{table.cameras[v], table.camera_from_table[v]}, &context.views[v].maps});
    }
    const Shortlist promising = PromisingInSpace(
        objects, views, FindSpaceCorners(features), FindSpaceCircles(features), {}, options, 2);
    ASSERT_EQ(promising.searched.size(), objects.size());
    EXPECT_LE(std::count(promising.searched.begin(), promising.searched.end(), true),
              options.searched);
    found += promising.searched[trial % 2];
    // What is not on the shortlist is not looked at again.
    std::vector<bool> others(objects.size(), true);
    others[trial % 2] = false;
    EXPECT_FALSE(PromisingInSpace(objects,
                                  views,
                                  FindSpaceCorners(features),
                                  FindSpaceCircles(features),
                                  others,
                                  options,
                                  2)
                     .searched[trial % 2]);
  }
  EXPECT_EQ(found, kTrials);
}

}  // namespace
}  // namespace horopter
