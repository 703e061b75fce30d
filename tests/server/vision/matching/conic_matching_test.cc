#include "server/vision/matching/conic_matching.h"

#include <gtest/gtest.h>

#include <Eigen/Dense>
#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <numbers>
#include <random>

#include "server/vision/features/ellipse_fit.h"

namespace horopter {
namespace {

struct Scene {
  std::vector<SpaceConic> circles;
  std::vector<std::optional<CalibratedCamera>> cameras;
  std::vector<ImageFeatures> features;
  std::vector<std::vector<int>> circle_of_arc;  // per view; -1: clutter
};

CalibratedCamera LookingAtOrigin(const Eigen::Vector3d& centre) {
  CalibratedCamera view;
  view.camera = CenteredCamera(640, 480, 700.0);
  const Eigen::Vector3d z = -centre.normalized();
  const Eigen::Vector3d x = z.cross(Eigen::Vector3d(0.1, 0.2, 1.0)).normalized();
  view.camera_from_scene.R << x.transpose(), z.cross(x).transpose(), z.transpose();
  view.camera_from_scene.t = -(view.camera_from_scene.R * centre);
  return view;
}

SpaceConic Circle(const Eigen::Vector3d& centre, const Eigen::Vector3d& normal, double radius) {
  SpaceConic out;
  out.scene_from_conic = {
      Eigen::Quaterniond::FromTwoVectors(Eigen::Vector3d::UnitZ(), normal).toRotationMatrix(),
      centre};
  out.semi_major = out.semi_minor = radius;
  out.circle = true;
  return out;
}

EllipseArc ImageOf(const SpaceConic& circle,
                   const CalibratedCamera& view,
                   double noise_px,
                   std::mt19937* rng) {
  std::normal_distribution<double> noise(0.0, noise_px);
  std::vector<Eigen::Vector2f> points;
  for (int k = 0; k < 60; ++k) {
    const Eigen::Vector2d x =
        Project(view.camera,
                view.camera_from_scene * PointOfConic(circle, 2.0 * std::numbers::pi * k / 60.0));
    points.push_back((x + Eigen::Vector2d(noise(*rng), noise(*rng))).cast<float>());
  }
  return *FitEllipse(points);
}

// All circles in all views, their arcs in an order that differs, and ellipses of nothing.
Scene See(
    std::vector<SpaceConic> circles, int views, int clutter, double noise_px, std::mt19937* rng) {
  std::uniform_real_distribution<double> unit(0.0, 1.0);
  Scene scene;
  scene.circles = std::move(circles);
  for (int v = 0; v < views; ++v) {
    const double azimuth = 0.4 * v;
    const CalibratedCamera camera =
        LookingAtOrigin({0.4 * std::cos(azimuth), 0.4 * std::sin(azimuth), 0.45});
    scene.cameras.emplace_back(camera);
    std::vector<std::pair<int, EllipseArc>> arcs;
    for (int i = 0; i < std::ssize(scene.circles); ++i) {
      arcs.emplace_back(i, ImageOf(scene.circles[i], camera, noise_px, rng));
    }
    for (int k = 0; k < clutter; ++k) {
      EllipseArc arc;
      arc.center = {640.0 * unit(*rng), 480.0 * unit(*rng)};
      arc.semi_major_px = 10.0 + 40.0 * unit(*rng);
      arc.semi_minor_px = (0.3 + 0.6 * unit(*rng)) * arc.semi_major_px;
      arc.angle_rad = 3.0 * unit(*rng);
      arc.sweep_rad = 6.0;
      arcs.emplace_back(-1, arc);
    }
    std::shuffle(arcs.begin(), arcs.end(), *rng);
    scene.features.emplace_back();
    scene.circle_of_arc.emplace_back();
    for (auto& [circle, arc] : arcs) {
      scene.features.back().arcs.push_back(arc);
      scene.circle_of_arc.back().push_back(circle);
    }
  }
  return scene;
}

std::vector<SpaceConic> RandomCircles(int count, std::mt19937* rng) {
  std::uniform_real_distribution<double> unit(-1.0, 1.0);
  std::vector<SpaceConic> circles;
  for (int i = 0; i < count; ++i) {
    const Eigen::Vector3d at(0.12 * unit(*rng), 0.12 * unit(*rng), 0.04 * unit(*rng));
    const Eigen::Vector3d normal(0.4 * unit(*rng), 0.4 * unit(*rng), 1.0);
    circles.push_back(Circle(at, normal.normalized(), 0.012 + 0.008 * unit(*rng)));
  }
  return circles;
}

struct Judged {
  int right = 0, wrong = 0;
};

Judged Judge(const Scene& scene, const ConicMatching& found) {
  Judged judged;
  for (const ConicPair& pair : found.pairs) {
    for (const ConicMatch& m : pair.matches) {
      const int a = scene.circle_of_arc[pair.view_a][m.arc_a];
      const int b = scene.circle_of_arc[pair.view_b][m.arc_b];
      ++(a >= 0 && a == b ? judged.right : judged.wrong);
    }
  }
  return judged;
}

TEST(MatchConics, FindsCirclesAmongClutter) {
  for (const double noise_px : {0.0, 0.3, 0.6}) {
    Judged all;
    int tracked = 0, circles = 0;
    for (const unsigned seed : {1u, 2u, 3u, 4u}) {
      SCOPED_TRACE(testing::Message() << "noise " << noise_px << ", seed " << seed);
      std::mt19937 rng(seed);
      const Scene scene = See(RandomCircles(10, &rng), 4, 8, noise_px, &rng);
      const auto found = MatchConics(scene.features, scene.cameras);
      ASSERT_TRUE(found.ok()) << found.status();
      ASSERT_EQ(found->pairs.size(), 6u);
      const Judged judged = Judge(scene, *found);
      all.right += judged.right;
      all.wrong += judged.wrong;
      circles += 10;
      for (const TrackedConic& conic : found->conics) {
        const FeatureTrack::Feature& f = conic.track.features.front();
        const int circle = scene.circle_of_arc[f.view][f.feature];
        if (circle < 0 || conic.track.features.size() < 3) continue;
        ++tracked;
        const SpaceConic& truth = scene.circles[circle];
        const Eigen::Vector3d off = conic.conic.scene_from_conic.t - truth.scene_from_conic.t;
        const Eigen::Matrix3d S = conic.conic.covariance.block<3, 3>(3, 3);
        EXPECT_LT(off.dot(S.ldlt().solve(off)), 25.0);  // five deviations
        EXPECT_NEAR(conic.conic.semi_major, truth.semi_major, 0.03 * truth.semi_major);
        EXPECT_GT(
            std::abs(conic.conic.scene_from_conic.R.col(2).dot(truth.scene_from_conic.R.col(2))),
            0.97);
      }
    }
    SCOPED_TRACE(testing::Message() << "noise " << noise_px << ": right " << all.right << ", wrong "
                                    << all.wrong << ", tracked " << tracked);
    EXPECT_GE(all.right, 0.9 * 6 * circles);
    EXPECT_LE(all.wrong, 0.02 * all.right);
    EXPECT_GE(tracked, 0.95 * circles);
  }
}

// Cameras as texture gives them: turned by some tenths of a degree.
TEST(MatchConics, AllowsForWhatCamerasAreOff) {
  Judged all;
  for (const unsigned seed : {5u, 6u, 7u}) {
    std::mt19937 rng(seed);
    std::normal_distribution<double> turn(0.0, 0.0005);
    Scene scene = See(RandomCircles(10, &rng), 4, 8, 0.2, &rng);
    for (auto& camera : scene.cameras) {
      for (int axis = 0; axis < 3; ++axis) {
        const Eigen::Matrix3d R =
            Eigen::AngleAxisd(turn(rng), Eigen::Vector3d::Unit(axis)).toRotationMatrix();
        camera->camera_from_scene.R = R * camera->camera_from_scene.R;
        camera->camera_from_scene.t = R * camera->camera_from_scene.t;
      }
    }
    const auto found = MatchConics(scene.features, scene.cameras);
    ASSERT_TRUE(found.ok());
    const Judged judged = Judge(scene, *found);
    all.right += judged.right;
    all.wrong += judged.wrong;
  }
  EXPECT_GE(all.right, 0.75 * 180) << "seeds 5, 6, 7; wrong " << all.wrong;
  EXPECT_LE(all.wrong, 0.05 * all.right) << "seeds 5, 6, 7";
}

// Like holes along an epipolar line: two views cannot tell which is which, three can.
TEST(MatchConics, ARowOfLikeHolesNeedsAThirdView) {
  std::mt19937 rng(8);
  std::vector<SpaceConic> row;
  for (int k = 0; k < 6; ++k)
    row.push_back(Circle({0.03 * k - 0.075, -0.03 * k + 0.075, 0.0}, {0, 0, 1}, 0.008));
  const Scene three = See(row, 3, 0, 0.1, &rng);
  const auto found = MatchConics(three.features, three.cameras);
  ASSERT_TRUE(found.ok());
  EXPECT_EQ(Judge(three, *found).wrong, 0);
  EXPECT_GE(Judge(three, *found).right, 15);  // of 18
  const Scene two = See(row, 2, 0, 0.1, &rng);
  const auto in_two = MatchConics(two.features, two.cameras);
  ASSERT_TRUE(in_two.ok());
  EXPECT_EQ(Judge(two, *in_two).wrong, 0);
}

TEST(MatchConics, LeavesOutWhatTellsNothing) {
  std::mt19937 rng(9);
  Scene scene = See(RandomCircles(5, &rng), 3, 0, 0.1, &rng);
  scene.cameras[1].reset();
  auto found = MatchConics(scene.features, scene.cameras);
  ASSERT_TRUE(found.ok());
  ASSERT_EQ(found->pairs.size(), 1u);
  EXPECT_EQ(found->pairs[0].view_b, 2);
  for (ImageFeatures& f : scene.features)
    for (EllipseArc& arc : f.arcs) arc.sweep_rad = 1.0;
  found = MatchConics(scene.features, scene.cameras);
  ASSERT_TRUE(found.ok());
  EXPECT_TRUE(found->pairs[0].matches.empty());
  EXPECT_TRUE(found->conics.empty());
  // No parallax: one camera twice.
  Scene same = See(RandomCircles(5, &rng), 2, 0, 0.1, &rng);
  same.cameras[1] = same.cameras[0];
  same.features[1] = same.features[0];
  found = MatchConics(same.features, same.cameras);
  ASSERT_TRUE(found.ok());
  EXPECT_TRUE(found->conics.empty());
}

TEST(MatchConics, RefusesSizesThatDoNotAgreeAndStops) {
  std::mt19937 rng(10);
  const Scene scene = See(RandomCircles(3, &rng), 2, 0, 0.1, &rng);
  EXPECT_EQ(MatchConics(scene.features, std::span(scene.cameras).first(1)).status().code(),
            absl::StatusCode::kInvalidArgument);
  EXPECT_EQ(MatchConics(scene.features, scene.cameras, {}, [] { return true; }).status().code(),
            absl::StatusCode::kCancelled);
}

}  // namespace
}  // namespace horopter
