#include "server/vision/matching/pair_geometry.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <Eigen/Dense>
#include <opencv2/core.hpp>
#include <opencv2/imgproc.hpp>
#include <set>

#include "server/vision/matching/homography.h"
#include "server/vision/matching/match_features.h"
#include "tests/support/boxes_scene.h"

namespace horopter {
namespace {

struct View {
  cv::Mat image;
  ImageFeatures features;
  MatchingView prepared;
};

// The view refers to its own features, so it is built in place.
void Prepare(const cv::Mat& image, View* view) {
  view->image = image;
  view->features = *DetectFeatures(image, FeatureOptions());
  view->prepared = PrepareMatchingView(view->image, view->features);
}

SyntheticScene MakeScene(unsigned seed, bool pure_rotation = false) {
  SyntheticSceneOptions options;
  options.seed = seed;
  options.views = 2;
  options.arc_rad = 0.35;
  options.pure_rotation = pure_rotation;
  return MakeSyntheticScene(options);
}

double EpipolarDistance(const Eigen::Matrix3d& F,
                        const Eigen::Vector2d& a,
                        const Eigen::Vector2d& b) {
  const Eigen::Vector3d l = F * a.homogeneous();
  return std::abs(l.dot(b.homogeneous())) / l.head<2>().norm();
}

PairGeometry Estimate(const View& a, const View& b, const std::optional<Eigen::Matrix3d>& plane) {
  PairGeometry pair = MatchPair(0, 1, a.prepared, b.prepared, plane);
  EstimateEpipolarGeometry(a.prepared, b.prepared, plane, {}, &pair);
  return pair;
}

TEST(PairGeometry, TexturelessBoxesGiveRightGeometryOrARefusal) {
  int found = 0;
  for (unsigned seed = 1; seed <= 8; ++seed) {
    const SyntheticScene scene = MakeScene(seed);
    View a, b;
    Prepare(RenderBoxes(scene, 0, seed, 9), &a);
    Prepare(RenderBoxes(scene, 1, seed, 9), &b);
    for (const bool with_plane : {false, true}) {
      std::optional<Eigen::Matrix3d> plane;
      if (with_plane) plane = scene.PlaneHomographyOf(0, 1);
      PairGeometry pair = Estimate(a, b, plane);
      if (!pair.F) {
        EXPECT_FALSE(pair.refusal.empty());
        continue;
      }
      ++found;
      double worst = 0.0;
      for (const Eigen::Vector3d& x : scene.off_plane_points) {
        worst =
            std::max(worst,
                     EpipolarDistance(*pair.F,
                                      Project(scene.cameras[0], scene.camera_from_world[0] * x),
                                      Project(scene.cameras[1], scene.camera_from_world[1] * x)));
      }
      EXPECT_LT(worst, 4.0) << "seed " << seed << " plane " << with_plane;
    }
  }
  EXPECT_GE(found, 10);
}

TEST(PairGeometry, MatchesAlongKnownLinesAreOneToOneAndRight) {
  for (unsigned seed = 1; seed <= 5; ++seed) {
    const SyntheticScene scene = MakeScene(seed);
    View a, b;
    Prepare(RenderBoxes(scene, 0, seed, 9), &a);
    Prepare(RenderBoxes(scene, 1, seed, 9), &b);
    PairGeometry pair;
    pair.F = scene.FundamentalOf(0, 1);
    MatchAlongEpipolarLines(a.prepared, b.prepared, std::nullopt, &pair);
    EXPECT_GE(pair.matches.size(), 12u) << "seed " << seed;
    EXPECT_GE(pair.segments.size(), 15u) << "seed " << seed;
    std::set<int> used_a, used_b;
    for (const JunctionMatch& m : pair.matches) {
      EXPECT_TRUE(used_a.insert(m.junction_a).second);
      EXPECT_TRUE(used_b.insert(m.junction_b).second);
      EXPECT_LT(EpipolarDistance(*pair.F,
                                 a.features.junctions[m.junction_a].point,
                                 b.features.junctions[m.junction_b].point),
                2.0);
    }
  }
}

// A checkered floor, a little dirty: its corners look alike, all of them may match a period off,
// and such matches agree with a wrong F.
cv::Mat Checkers(unsigned seed) {
  constexpr int kSide = 900, kSquare = 45;
  cv::Mat floor(kSide, kSide, CV_8UC1);
  for (int y = 0; y < kSide; ++y) {
    for (int x = 0; x < kSide; ++x)
      floor.at<uchar>(y, x) = (x / kSquare + y / kSquare) % 2 == 0 ? 150 : 105;
  }
  cv::Mat dirt(kSide, kSide, CV_8SC1);
  cv::RNG rng(seed);
  rng.fill(dirt, cv::RNG::NORMAL, 0, 4);
  cv::add(floor, dirt, floor, cv::noArray(), CV_8U);
  return floor;
}

// Whether some junction lies at the point.
bool HasJunctionAt(const ImageFeatures& features, const Eigen::Vector2d& point) {
  return std::any_of(features.junctions.begin(), features.junctions.end(), [&](const Junction& j) {
    return (j.point - point).norm() < 1.5;
  });
}

// Corners that the floor's homography takes to corners are the floor's; what joins two such is a
// match of different ones unless the homography joins them too.
TEST(PairGeometry, CheckeredFloorsMatchNothingAPeriodOff) {
  int matches = 0, shifted = 0;
  for (unsigned seed = 1; seed <= 6; ++seed) {
    SCOPED_TRACE(seed);
    const SyntheticScene scene = MakeScene(seed);
    const cv::Mat floor = Checkers(seed);
    View a, b;
    Prepare(RenderBoxes(scene, 0, seed, 3, floor), &a);
    Prepare(RenderBoxes(scene, 1, seed, 3, floor), &b);
    const Eigen::Matrix3d H = scene.PlaneHomographyOf(0, 1), back = H.inverse();
    const PairGeometry pair = Estimate(a, b, H);
    for (const JunctionMatch& m : pair.matches) {
      const Eigen::Vector2d in_a = a.features.junctions[m.junction_a].point;
      const Eigen::Vector2d in_b = b.features.junctions[m.junction_b].point;
      ++matches;
      shifted += HasJunctionAt(b.features, Transfer(H, in_a)) &&
                 HasJunctionAt(a.features, Transfer(back, in_b)) &&
                 (Transfer(H, in_a) - in_b).norm() > 6.0;
    }
    if (!pair.F) continue;
    for (const Eigen::Vector3d& x : scene.off_plane_points) {
      EXPECT_LT(EpipolarDistance(*pair.F,
                                 Project(scene.cameras[0], scene.camera_from_world[0] * x),
                                 Project(scene.cameras[1], scene.camera_from_world[1] * x)),
                3.0);
    }
  }
  EXPECT_GE(matches, 200);
  EXPECT_LE(shifted, 2) << "of " << matches;
}

TEST(PairGeometry, IdenticalImagesMatchThemselvesAndShowNoParallax) {
  const SyntheticScene scene = MakeScene(1);
  View a;
  Prepare(RenderBoxes(scene, 0, 1, 9), &a);
  const PairGeometry pair = Estimate(a, a, std::nullopt);
  EXPECT_FALSE(pair.F);
  EXPECT_THAT(pair.refusal, testing::HasSubstr("no parallax"));
  ASSERT_GE(pair.matches.size(), 20u);
  for (const JunctionMatch& m : pair.matches) EXPECT_EQ(m.junction_a, m.junction_b);
}

TEST(PairGeometry, RotationAndZoomShowNoParallax) {
  for (unsigned seed = 1; seed <= 3; ++seed) {
    const SyntheticScene rotation = MakeScene(seed, /*pure_rotation=*/true);
    View a, b, zoomed;
    Prepare(RenderBoxes(rotation, 0, seed, 9), &a);
    Prepare(RenderBoxes(rotation, 1, seed, 9), &b);
    EXPECT_FALSE(Estimate(a, b, std::nullopt).F) << "seed " << seed;
    cv::Mat zoom;
    cv::warpAffine(a.image, zoom, cv::getRotationMatrix2D({320, 240}, 0, 1.25), a.image.size());
    Prepare(zoom, &zoomed);
    EXPECT_FALSE(Estimate(a, zoomed, std::nullopt).F) << "seed " << seed;
  }
}

TEST(PairGeometry, ForeignAndRepeatedImagesAreRefusedMirroredOnesMostly) {
  cv::Mat stairs(480, 640, CV_8UC3, cv::Scalar(90, 90, 90));
  for (int k = 0; k < 12; ++k) {
    for (int i = 0; i < 9; ++i)
      cv::rectangle(stairs,
                    {20 + 50 * k, 20 + 50 * i},
                    {44 + 50 * k, 44 + 50 * i},
                    cv::Scalar(180, 180, 180),
                    cv::FILLED);
  }
  cv::Mat shifted;
  cv::warpAffine(stairs, shifted, cv::Mat(cv::Matx23d(1, 0, 17, 0, 1, -9)), stairs.size());
  View grid, moved_grid;
  Prepare(stairs, &grid);
  Prepare(shifted, &moved_grid);
  EXPECT_FALSE(Estimate(grid, moved_grid, std::nullopt).F);
  // A mirrored image is a possible view of mirrored boxes, and boxes have mirrors: some pass.
  int mirrored_accepted = 0;
  constexpr unsigned kSeeds = 20;
  for (unsigned seed = 1; seed <= kSeeds; ++seed) {
    const SyntheticScene scene = MakeScene(seed), other = MakeScene(seed + 50);
    View a, foreign, mirrored;
    Prepare(RenderBoxes(scene, 0, seed, 9), &a);
    Prepare(RenderBoxes(other, 1, seed + 50, 9), &foreign);
    EXPECT_FALSE(Estimate(a, foreign, std::nullopt).F) << "seed " << seed;
    cv::Mat flipped;
    cv::flip(a.image, flipped, 1);
    Prepare(flipped, &mirrored);
    mirrored_accepted += Estimate(a, mirrored, std::nullopt).F.has_value();
  }
  EXPECT_LE(mirrored_accepted, static_cast<int>(kSeeds) * 2 / 5);
}

TEST(PairGeometry, BlankImagesGiveNoMatches) {
  View blank;
  Prepare(cv::Mat(480, 640, CV_8UC3, cv::Scalar(90, 90, 90)), &blank);
  const PairGeometry pair = Estimate(blank, blank, std::nullopt);
  EXPECT_FALSE(pair.F);
  EXPECT_TRUE(pair.matches.empty());
  EXPECT_TRUE(pair.segments.empty());
}

TEST(FeatureMatchOptions, BadFieldsAreNamed) {
  FeatureMatchOptions options;
  EXPECT_TRUE(Validate(options).ok());
  options.per_feature = 0;
  EXPECT_THAT(std::string(Validate(options).message()), testing::HasSubstr("per_feature"));
  options = {};
  options.assignment.reweighting = 2.0;
  EXPECT_THAT(std::string(Validate(options).message()), testing::HasSubstr("reweighting"));
}

}  // namespace
}  // namespace horopter
