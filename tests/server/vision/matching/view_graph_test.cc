#include "server/vision/matching/view_graph.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <limits>
#include <numeric>
#include <set>

#include "tests/support/boxes_scene.h"
#include "tests/support/random.h"
#include "tests/support/textured_plane.h"

namespace horopter {
namespace {

using Pairs = std::vector<std::pair<int, int>>;

int CountComponents(int views, const Pairs& pairs) {
  std::vector<int> label(views);
  std::iota(label.begin(), label.end(), 0);
  for (const auto& [a, b] : pairs) {
    const int old = label[a], now = label[b];
    std::replace(label.begin(), label.end(), old, now);
  }
  return static_cast<int>(std::set<int>(label.begin(), label.end()).size());
}

TEST(ChooseViewPairs, JoinsAllViewsAndGrowsLinearly) {
  for (unsigned seed = 1; seed <= 20; ++seed) {
    Random random(seed);
    const int views = 7 + random.Index(26);
    std::vector<ViewOverlap> overlaps;
    for (int a = 0; a < views; ++a) {
      for (int b = a + 1; b < views; ++b)
        overlaps.push_back({a, b, std::floor(random.Uniform(0.0, 20.0))});
    }
    const ViewGraphOptions options;
    const Pairs pairs = ChooseViewPairs(views, overlaps, options);
    SCOPED_TRACE(testing::Message() << "seed " << seed << " views " << views);
    EXPECT_EQ(CountComponents(views, pairs), 1);
    EXPECT_LE(static_cast<int>(pairs.size()), views * options.best + views - 1);
    EXPECT_TRUE(std::is_sorted(pairs.begin(), pairs.end()));
    std::vector<int> partners(views, 0);
    for (const auto& [a, b] : pairs) {
      EXPECT_LT(a, b);
      ++partners[a], ++partners[b];
    }
    for (const int n : partners) EXPECT_GE(n, options.best);
    // Every view keeps its best partner.
    for (int v = 0; v < views; ++v) {
      double best = -1.0;
      for (const ViewOverlap& o : overlaps) {
        if (o.view_a == v || o.view_b == v) best = std::max(best, o.score);
      }
      const bool kept = std::any_of(overlaps.begin(), overlaps.end(), [&](const ViewOverlap& o) {
        return (o.view_a == v || o.view_b == v) && o.score == best &&
               std::count(pairs.begin(), pairs.end(), std::pair(o.view_a, o.view_b)) == 1;
      });
      EXPECT_TRUE(kept) << "view " << v;
    }
  }
}

TEST(ChooseViewPairs, FewViewsAreComparedEachWithEach) {
  EXPECT_TRUE(ChooseViewPairs(0, {}, {}).empty());
  EXPECT_TRUE(ChooseViewPairs(1, {}, {}).empty());
  for (int views = 2; views <= 6; ++views)
    EXPECT_EQ(ChooseViewPairs(views, {}, {}).size(), static_cast<size_t>(views * (views - 1) / 2));
}

TEST(ChooseViewPairs, WithoutScoresNeighboursAreTaken) {
  const double nan = std::numeric_limits<double>::quiet_NaN();
  const std::vector<ViewOverlap> useless = {{0, 9, nan}, {3, 3, 50.0}, {-1, 4, 9.0}, {2, 70, 9.0}};
  const Pairs pairs = ChooseViewPairs(10, useless, {});
  for (int v = 0; v + 1 < 10; ++v)
    EXPECT_EQ(std::count(pairs.begin(), pairs.end(), std::pair(v, v + 1)), 1) << v;
  EXPECT_EQ(std::count(pairs.begin(), pairs.end(), std::pair(0, 9)), 0);
}

// Views on an arc, in an order that says nothing: the ones that stand side by side are found.
TEST(CountOverlapVotes, FindsNeighboursOfShuffledViews) {
  for (const double contrast : {0.0, 12.0}) {
    const int views = 10;
    SyntheticSceneOptions options;
    options.views = views;
    options.arc_rad = 0.3 * (views - 1);
    const SyntheticScene scene = MakeSyntheticScene(options);
    const cv::Mat texture = contrast > 0.0 ? PlaneTexture(3, contrast) : cv::Mat();
    const int place[] = {4, 9, 1, 7, 0, 5, 2, 8, 6, 3};  // on the arc, of view v
    std::vector<OverlapSketch> sketches;
    for (const int v : place) {
      const cv::Mat image = RenderBoxes(scene, v, 3, 9, texture);
      const ImageFeatures features = *DetectFeatures(image, FeatureOptions());
      sketches.push_back(SketchForOverlap(
          image, SampleJunctionPatches(SmoothForPatches(image), features.junctions)));
    }
    std::vector<ViewOverlap> overlaps;
    for (int a = 0; a < views; ++a) {
      for (int b = a + 1; b < views; ++b)
        overlaps.push_back({a, b, 1.0 * CountOverlapVotes(sketches[a], sketches[b])});
    }
    const Pairs pairs = ChooseViewPairs(views, overlaps, {});
    int neighbours = 0, far = 0;
    for (const auto& [a, b] : pairs) {
      neighbours += std::abs(place[a] - place[b]) == 1;
      far += std::abs(place[a] - place[b]) > 5;
    }
    EXPECT_GE(neighbours, 8) << "of 9, contrast " << contrast;
    EXPECT_LE(far, 5) << "contrast " << contrast;
    EXPECT_LT(pairs.size(), 36u);
  }
}

TEST(CountOverlapVotes, BlankViewsHaveNone) {
  const OverlapSketch blank = SketchForOverlap(cv::Mat(48, 64, CV_8UC3, cv::Scalar(9, 9, 9)), {});
  const OverlapSketch tiny = SketchForOverlap(cv::Mat(1, 1, CV_8UC1, cv::Scalar(7)), {});
  EXPECT_EQ(CountOverlapVotes(blank, blank), 0);
  EXPECT_EQ(CountOverlapVotes(blank, tiny), 0);
}

}  // namespace
}  // namespace horopter
