#include "server/vision/matching/camera_matching.h"

#include <gtest/gtest.h>

#include "server/vision/features/features.h"
#include "server/vision/geometry/fundamental_matrix.h"
#include "tests/support/textured_scene.h"

namespace horopter {
namespace {

struct Views {
  std::vector<cv::Mat> images;
  std::vector<ImageFeatures> features;
  std::vector<std::optional<CalibratedCamera>> cameras;
};

Views Bench(unsigned seed) {
  const TexturedScene scene =
      MakeTexturedScene({.seed = seed, .views = 3, .arc_rad = 0.3, .contrast = 15.0});
  Views out;
  out.images = RenderTextured(scene);
  for (size_t v = 0; v < scene.views.size(); ++v) {
    out.features.push_back(*DetectFeatures(out.images[v], FeatureOptions()));
    out.cameras.push_back(
        CalibratedCamera{scene.views[v].camera, scene.views[v].camera_from_world});
  }
  return out;
}

TEST(MatchViewsOfCameras, MatchesLieOnTheEpipolarLines) {
  const Views bench = Bench(31);
  const auto result =
      MatchViewsOfCameras(bench.images, bench.features, bench.cameras, MatchingOptions());
  ASSERT_TRUE(result.ok()) << result.status();
  ASSERT_EQ(result->pairs.size(), 3u);
  size_t matches = 0;
  for (const PairGeometry& pair : result->pairs) {
    ASSERT_TRUE(pair.F.has_value());
    for (const JunctionMatch& m : pair.matches) {
      EXPECT_LT(SampsonSquared(*pair.F,
                               bench.features[pair.view_a].junctions[m.junction_a].point,
                               bench.features[pair.view_b].junctions[m.junction_b].point),
                36.0);
    }
    matches += pair.matches.size() + pair.segments.size();
  }
  EXPECT_GT(matches, 20u);
  EXPECT_EQ(result->component, std::vector<int>(3, -1));
}

TEST(MatchViewsOfCameras, AViewWithoutACameraIsInNoPair) {
  Views bench = Bench(32);
  bench.cameras[1].reset();
  const auto result =
      MatchViewsOfCameras(bench.images, bench.features, bench.cameras, MatchingOptions());
  ASSERT_TRUE(result.ok());
  ASSERT_EQ(result->pairs.size(), 1u);
  EXPECT_EQ(result->pairs[0].view_a, 0);
  EXPECT_EQ(result->pairs[0].view_b, 2);
}

TEST(MatchViewsOfCameras, RefusesSizesThatDoNotAgreeAndStops) {
  const Views bench = Bench(33);
  EXPECT_EQ(
      MatchViewsOfCameras(bench.images, bench.features, {}, MatchingOptions()).status().code(),
      absl::StatusCode::kInvalidArgument);
  EXPECT_EQ(MatchViewsOfCameras(
                bench.images, bench.features, bench.cameras, MatchingOptions(), [] { return true; })
                .status()
                .code(),
            absl::StatusCode::kCancelled);
}

}  // namespace
}  // namespace horopter
