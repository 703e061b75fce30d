#include "server/vision/matching/known_cameras.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <Eigen/Dense>
#include <limits>
#include <opencv2/core.hpp>

#include "tests/support/boxes_scene.h"
#include "tests/support/textured_plane.h"

namespace horopter {
namespace {

struct Input {
  SyntheticScene scene;
  std::vector<cv::Mat> images;
  std::vector<ImageFeatures> features;
  std::vector<std::optional<PosedView>> views;  // the truth

  KnownCameras known() const { return {views, Eigen::Vector3d(0, 0, 0.03)}; }
};

// contrast: of the plane's texture; 0: blank.
Input MakeInput(unsigned seed, int views, double contrast, double k1 = 0.0) {
  SyntheticSceneOptions options;
  options.seed = seed;
  options.views = views;
  options.arc_rad = 0.35 * (views - 1);
  Input input;
  input.scene = MakeSyntheticScene(options);
  const cv::Mat texture =
      contrast > 0.0 ? PlaneTexture(static_cast<int>(seed), contrast) : cv::Mat();
  for (int v = 0; v < views; ++v) {
    input.scene.cameras[v].k1 = k1;
    input.images.push_back(RenderBoxes(input.scene, v, seed, 9, texture));
    input.features.push_back(*DetectFeatures(input.images.back(), FeatureOptions()));
    input.views.emplace_back(PosedView{input.scene.cameras[v], input.scene.camera_from_world[v]});
  }
  return input;
}

MatchingResult FirstPass(const Input& input) {
  const auto first = MatchViews(input.images, input.features, {});
  EXPECT_TRUE(first.ok()) << first.status();
  return first.value_or(MatchingResult());
}

// Larger distance of the undistorted points of a match from the true epipolar lines, px.
double TrueDistance(const Input& input, const PairGeometry& pair, const JunctionMatch& m) {
  const auto undistorted = [&](int v, int junction) {
    const PinholeCamera& c = input.scene.cameras[v];
    const Eigen::Vector2d n = NormalizedPoint(c, input.features[v].junctions[junction].point);
    return Eigen::Vector3d(c.focal_px * n.x() + c.cx, c.focal_px * n.y() + c.cy, 1.0);
  };
  const Eigen::Matrix3d F = input.scene.FundamentalOf(pair.view_a, pair.view_b);
  const Eigen::Vector3d a = undistorted(pair.view_a, m.junction_a);
  const Eigen::Vector3d b = undistorted(pair.view_b, m.junction_b);
  const Eigen::Vector3d in_b = F * a, in_a = F.transpose() * b;
  return std::max(std::abs(in_b.dot(b)) / in_b.head<2>().norm(),
                  std::abs(in_a.dot(a)) / in_a.head<2>().norm());
}

int TracksOfThree(const std::vector<FeatureTrack>& tracks) {
  int n = 0;
  for (const FeatureTrack& track : tracks) n += track.features.size() >= 3;
  return n;
}

TEST(MatchUnderCameras, EveryPairOfKnownViewsIsLinkedAndRight) {
  for (unsigned seed = 1; seed <= 3; ++seed) {
    for (const double contrast : {0.0, 12.0}) {
      const Input input = MakeInput(seed, 4, contrast);
      const MatchingResult first = FirstPass(input);
      const auto linked = MatchUnderCameras(input.images, input.features, input.known(), first, {});
      ASSERT_TRUE(linked.ok()) << linked.status();
      SCOPED_TRACE(testing::Message() << "seed " << seed << " contrast " << contrast);
      EXPECT_EQ(linked->counts.at("pairs_under_cameras"), 6);
      EXPECT_EQ(linked->counts.at("pairs_with_epipolar"), 6);
      for (const PairGeometry& pair : linked->pairs) {
        ASSERT_TRUE(pair.F);
        EXPECT_TRUE(pair.refusal.empty());
        EXPECT_GE(pair.matches.size(), 8u);
        for (const JunctionMatch& m : pair.matches) EXPECT_LT(TrueDistance(input, pair, m), 2.01);
      }
      EXPECT_GE(TracksOfThree(linked->junction_tracks), 8);
      EXPECT_GE(TracksOfThree(linked->segment_tracks), 8);
      // What knows the cameras links no less than what does not, but for a few on the limit.
      EXPECT_GE(linked->counts.at("junction_matches"), 0.97 * first.counts.at("junction_matches"));
    }
  }
}

TEST(MatchUnderCameras, LensDistortionIsTakenOut) {
  const Input input = MakeInput(2, 3, 0.0, -0.3);
  const MatchingResult first = FirstPass(input);
  const auto linked = MatchUnderCameras(input.images, input.features, input.known(), first, {});
  ASSERT_TRUE(linked.ok()) << linked.status();
  for (const PairGeometry& pair : linked->pairs) {
    ASSERT_TRUE(pair.F);
    EXPECT_GE(pair.matches.size(), 8u);
    for (const JunctionMatch& m : pair.matches) EXPECT_LT(TrueDistance(input, pair, m), 2.01);
  }
  // With the distortion left in, true matches near the corners are off their lines.
  Input ignorant = input;
  for (auto& view : ignorant.views) view->camera.k1 = 0.0;
  const auto worse = MatchUnderCameras(input.images, input.features, ignorant.known(), first, {});
  ASSERT_TRUE(worse.ok());
  EXPECT_GT(linked->counts.at("junction_matches"), worse->counts.at("junction_matches"));
}

TEST(MatchUnderCameras, UnknownViewsStayAndKnownOnesWithoutParallaxAreRefused) {
  Input input = MakeInput(3, 4, 12.0);
  const MatchingResult first = FirstPass(input);
  input.views[3].reset();
  input.views[1] = input.views[0];  // one place claimed twice
  const auto linked = MatchUnderCameras(input.images, input.features, input.known(), first, {});
  ASSERT_TRUE(linked.ok()) << linked.status();
  for (size_t k = 0; k < first.pairs.size(); ++k) {
    const PairGeometry& before = first.pairs[k];
    const PairGeometry& after = linked->pairs[k];
    if (before.view_b == 3) {
      EXPECT_EQ(before.F.has_value(), after.F.has_value());
      EXPECT_EQ(before.matches.size(), after.matches.size());
      EXPECT_EQ(before.refusal, after.refusal);
    } else if (before.view_b == 1) {
      EXPECT_FALSE(after.F);
      EXPECT_THAT(after.refusal, testing::HasSubstr("no parallax"));
    } else {
      EXPECT_TRUE(after.F);
    }
  }
  input.views.assign(4, std::nullopt);
  const auto none = MatchUnderCameras(input.images, input.features, input.known(), first, {});
  ASSERT_TRUE(none.ok());
  EXPECT_EQ(none->junction_tracks.size(), first.junction_tracks.size());
}

TEST(MatchUnderCameras, BadInputNamesTheOffender) {
  Input input = MakeInput(1, 2, 0.0);
  const MatchingResult first = FirstPass(input);
  const auto run = [&] {
    return MatchUnderCameras(input.images, input.features, input.known(), first, {}).status();
  };
  EXPECT_TRUE(run().ok());
  EXPECT_EQ(
      MatchUnderCameras(input.images, input.features, input.known(), first, {}, [] { return true; })
          .status()
          .code(),
      absl::StatusCode::kCancelled);
  const auto views = input.views;
  input.views[1]->camera.focal_px = std::numeric_limits<double>::quiet_NaN();
  EXPECT_EQ(run().code(), absl::StatusCode::kInvalidArgument);
  EXPECT_THAT(std::string(run().message()), testing::HasSubstr("camera 1"));
  input.views = views;
  input.views.pop_back();
  EXPECT_EQ(run().code(), absl::StatusCode::kInvalidArgument);
  input.views = views;
  input.images[0] = cv::Mat();
  EXPECT_THAT(std::string(run().message()), testing::HasSubstr("image 0"));
}

TEST(PlaneUnderCameras, IsTheTrueOneOrNothing) {
  for (unsigned seed = 1; seed <= 3; ++seed) {
    Input input = MakeInput(seed, 3, 12.0);
    const MatchingResult first = FirstPass(input);
    const auto plane = PlaneUnderCameras(input.known(), first);
    ASSERT_TRUE(plane) << "seed " << seed;
    EXPECT_GT(std::abs(plane->normal.z()), 0.9995) << "seed " << seed;
    EXPECT_LT(std::abs(plane->offset), 0.002) << "seed " << seed;
    // Cameras that contradict the homographies give none.
    std::swap(input.views[0], input.views[2]);
    EXPECT_FALSE(PlaneUnderCameras(input.known(), first)) << "seed " << seed;
    input.views[0].reset();
    input.views[1].reset();
    EXPECT_FALSE(PlaneUnderCameras(input.known(), first));
  }
  const Input blank = MakeInput(1, 2, 0.0);
  EXPECT_FALSE(PlaneUnderCameras(blank.known(), FirstPass(blank)));
}

}  // namespace
}  // namespace horopter
