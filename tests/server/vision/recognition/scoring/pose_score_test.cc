#include "server/vision/recognition/scoring/pose_score.h"

#include <gtest/gtest.h>

#include "server/vision/geometry/pose_perturbation.h"
#include "server/vision/recognition/scoring/pose_refine.h"
#include "tests/support/synthetic_part.h"

namespace horopter {
namespace {

const PinholeCamera kCamera = CenteredCamera(640, 480, 950.0);

struct OnePartView {
  std::shared_ptr<const PreparedObject> part = PrepareObject(LBracket()).value();
  Rigid3 pose = LookAt({0.30, -0.32, 0.34}, {0.03, 0.02, 0.02});
  ImageFeatures features;
  ViewEvidence view;

  explicit OnePartView(double noise_px, unsigned seed = 1) {
    std::mt19937 rng(seed);
    AddSyntheticFeatures(*part, kCamera, pose, noise_px, &rng, &features);
    view = BuildViewEvidence(features);
  }
};

TEST(EdgeMaps, DoNotDependOnTheThreads) {
  const unsigned seed = 31;
  SCOPED_TRACE(testing::Message() << "seed " << seed);
  std::mt19937 rng(seed);
  std::uniform_real_distribution<double> x(-20, 340), y(-20, 260);
  ImageFeatures f;
  f.width = 320;
  f.height = 240;
  for (int i = 0; i < 40; ++i) {
    Segment s;
    s.start = {x(rng), y(rng)};
    s.end = {x(rng), y(rng)};
    f.segments.push_back(s);
  }
  const EdgeMaps one = BuildEdgeMaps(f, 1), three = BuildEdgeMaps(f, 3);
  EXPECT_EQ(one.nearest, three.nearest);
  EXPECT_EQ(one.distance, three.distance);
}

TEST(EdgeMaps, PointsFarOutsideAreAtTheLargestDistance) {
  ImageFeatures features;
  features.width = 64;
  features.height = 48;
  const EdgeMaps maps = BuildEdgeMaps(features);
  const float nan = std::nanf("");
  for (const float x : {-1.0f, 64.0f, 3e9f, 1e30f, -1e30f, nan}) {
    EXPECT_GE(maps.DistanceAt(x, 10.0f, 0), 25.0f) << x;
    EXPECT_GE(maps.DistanceAt(10.0f, x, 0), 25.0f) << x;
  }
}

TEST(EdgeMaps, DistanceIsTheDistanceToTheNearestLikeDirectedEdge) {
  ImageFeatures f;
  f.width = 200;
  f.height = 100;
  Segment s;
  s.start = {20, 50};
  s.end = {180, 50};
  f.segments.push_back(s);
  const EdgeMaps maps = BuildEdgeMaps(f);
  // The map has a cell for every 2 x 2 pixels.
  EXPECT_NEAR(maps.DistanceAt(100, 60, OrientationBin(1, 0)), 10.0, 0.75);
  EXPECT_NEAR(maps.DistanceAt(100, 45, OrientationBin(-1, 0.05f)), 5.0, 0.75);
  EXPECT_EQ(maps.DistanceAt(100, 60, OrientationBin(0, 1)), EdgeMaps::kMaxDistance);
  EXPECT_EQ(maps.DistanceAt(-5, 60, 0), EdgeMaps::kMaxDistance);
  EXPECT_EQ(maps.DistanceAt(1e9f, 60, 0), EdgeMaps::kMaxDistance);
}

TEST(EdgeMaps, AnImageWithoutEdgesIsFarFromEverything) {
  ImageFeatures f;
  f.width = 64;
  f.height = 48;
  const EdgeMaps maps = BuildEdgeMaps(f);
  // The map has a cell for every 2 x 2 pixels.
  for (int bin = 0; bin < kOrientationBins; ++bin)
    EXPECT_EQ(maps.DistanceAt(30, 20, bin), EdgeMaps::kMaxDistance);
}

TEST(OrientationBin, IgnoresTheSignAndFollowsTheAngle) {
  for (int bin = 0; bin < kOrientationBins; ++bin) {
    const float a = bin * 3.14159265f / kOrientationBins + 0.1f;
    EXPECT_EQ(OrientationBin(std::cos(a), std::sin(a)), bin);
    EXPECT_EQ(OrientationBin(-std::cos(a), -std::sin(a)), bin);
  }
}

TEST(QuickScore, TruePoseScoresHighAndATurnedOneLow) {
  const OnePartView s(0.2);
  EXPECT_GT(QuickScore(*s.part, s.view.maps, kCamera, s.pose, 4.0f, 0.0f), 0.78f);
  Rigid3 turned = s.pose;
  turned.R = turned.R * RotationFromVector({0, 0, 0.6});
  EXPECT_LT(QuickScore(*s.part, s.view.maps, kCamera, turned, 4.0f, 0.0f), 0.45f);
}

TEST(QuickScore, PosesBehindTheCameraOrOutsideTheImageScoreZero) {
  const OnePartView s(0.0);
  Rigid3 behind = s.pose;
  behind.t.z() = -0.5;
  EXPECT_EQ(QuickScore(*s.part, s.view.maps, kCamera, behind, 4.0f, 0.0f), 0.0f);
  Rigid3 outside = s.pose;
  outside.t.x() += 3.0;
  EXPECT_EQ(QuickScore(*s.part, s.view.maps, kCamera, outside, 4.0f, 0.0f), 0.0f);
}

TEST(VerifyPose, TruePoseExplainsItsEdgesAndNothingElseIsAsked) {
  const OnePartView s(0.2);
  VerifyScratch scratch;
  const EdgeSupport support = VerifyPose(*s.part, s.view, kCamera, s.pose, nullptr, &scratch);
  EXPECT_GT(support.Precision(), 0.9);
  EXPECT_GT(support.RecallInside(), 0.95);
  EXPECT_GT(support.RecallAll(), 0.95);
}

TEST(VerifyPose, AnEdgeInsideTheSilhouetteThatNobodyPredictsLowersTheScore) {
  OnePartView s(0.2);
  VerifyScratch scratch;
  const double clean =
      SilhouetteF1(VerifyPose(*s.part, s.view, kCamera, s.pose, nullptr, &scratch));
  const Eigen::Vector2d c = Project(kCamera, s.pose * Eigen::Vector3d(0.0075, 0.03, 0.04));
  Segment scratch_mark;
  scratch_mark.start = c + Eigen::Vector2d(-25, -12);
  scratch_mark.end = c + Eigen::Vector2d(25, 12);
  s.features.segments.push_back(scratch_mark);
  const ViewEvidence marked = BuildViewEvidence(s.features);
  EXPECT_LT(SilhouetteF1(VerifyPose(*s.part, marked, kCamera, s.pose, nullptr, &scratch)),
            clean - 0.005);
}

TEST(VerifyPose, EdgesHiddenByAnotherObjectAreNotMissed) {
  const OnePartView s(0.2);
  DepthBuffer wall = MakeDepthBuffer(640, 480);
  std::fill(wall.depth.begin(), wall.depth.end(), 0.05f);
  VerifyScratch scratch;
  const EdgeSupport support = VerifyPose(*s.part, s.view, kCamera, s.pose, &wall, &scratch);
  EXPECT_EQ(support.visible, 0.0);
  EXPECT_GT(support.hidden_by_others, 100.0);
}

// Refinement recovers the pose from a disturbed start; the error grows with the noise no faster
// than stated.
TEST(RefineInView, ErrorStaysBelowThreeTimesTheNoise) {
  for (const double noise : {0.1, 0.3, 0.6}) {
    for (unsigned seed = 1; seed <= 5; ++seed) {
      const OnePartView s(noise, seed);
      Rigid3 start = s.pose;
      start.R = RotationFromVector({0.02, -0.03, 0.02}) * start.R;
      start.t += Eigen::Vector3d(0.002, -0.002, 0.006);
      RefineOptions options;
      options.focal_log_sigma = 0.0;
      const auto refined = RefineInView(*s.part, s.view.maps, kCamera, start, options);
      ASSERT_TRUE(refined.has_value());
      EXPECT_LT(
          ProjectionDistance(*s.part, kCamera, refined->camera_from_object, kCamera, s.pose, 1.0),
          0.5 + 3 * noise)
          << "noise " << noise << " seed " << seed;
    }
  }
}

TEST(RefineInView, AnEmptyImageGivesNoPose) {
  const OnePartView s(0.0);
  ImageFeatures empty;
  empty.width = 640;
  empty.height = 480;
  EXPECT_FALSE(RefineInView(*s.part, BuildEdgeMaps(empty), kCamera, s.pose, {}).has_value());
}

}  // namespace
}  // namespace horopter
