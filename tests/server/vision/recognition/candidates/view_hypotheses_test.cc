#include "server/vision/recognition/candidates/view_hypotheses.h"

#include <gtest/gtest.h>

#include <Eigen/Geometry>

#include "server/vision/recognition/initialization/view_linking.h"
#include "tests/support/circles.h"
#include "tests/support/synthetic_part.h"

namespace horopter {
namespace {

const PinholeCamera kCamera = CenteredCamera(640, 480, 900.0);

// Random poses in front of the camera: one of the two solutions is the truth, whatever the
// perspective.
TEST(PosesFromPath, RecoversThePoseFromThreeExactPoints) {
  const auto part = PrepareObject(LBracket()).value();
  std::mt19937 rng(5);
  std::uniform_real_distribution<double> u(-1, 1);
  int found = 0, tried = 0;
  for (int trial = 0; trial < 300; ++trial) {
    Rigid3 pose;
    pose.R = Eigen::Quaterniond(u(rng), u(rng), u(rng), u(rng)).normalized().toRotationMatrix();
    pose.t = {0.08 * u(rng), 0.06 * u(rng), 0.5 + 0.2 * u(rng)};
    const VertexPath& path = part->paths[trial % part->paths.size()];
    ImagePath image;
    image.a = Project(kCamera, pose * part->model.vertices[path.a]);
    image.b = Project(kCamera, pose * part->model.vertices[path.b]);
    image.c = Project(kCamera, pose * part->model.vertices[path.c]);
    if ((image.a - image.b).norm() < 15 || (image.c - image.b).norm() < 15) continue;
    ++tried;
    const PathPoses poses = PosesFromPath(part->model, path, false, kCamera, image);
    double best = 1e9;
    for (int k = 0; k < poses.count; ++k) {
      EXPECT_NEAR(poses.camera_from_object[k].R.determinant(), 1.0, 1e-3);
      best = std::min(
          best,
          ProjectionDistance(*part, kCamera, poses.camera_from_object[k], kCamera, pose, 1.0));
    }
    found += best < 4.0;
  }
  EXPECT_GT(found, 0.9 * tried) << found << " of " << tried;
}

TEST(PosesFromPath, DegenerateImagePathsGiveFinitePosesOrNone) {
  const auto part = PrepareObject(LBracket()).value();
  ImagePath point;
  point.a = point.b = point.c = {100, 100};
  for (const VertexPath& path : part->paths) {
    const PathPoses poses = PosesFromPath(part->model, path, false, kCamera, point);
    for (int k = 0; k < poses.count; ++k) EXPECT_TRUE(poses.camera_from_object[k].R.allFinite());
  }
}

TEST(FindViewHypotheses, TheRightPoseLeadsWithUnknownFocalLength) {
  const auto part = PrepareObject(LBracket()).value();
  for (unsigned seed = 1; seed <= 3; ++seed) {
    std::mt19937 rng(seed);
    const Rigid3 pose = LookAt({0.30, -0.32, 0.30 + 0.02 * seed}, {0.03, 0.02, 0.02});
    ImageFeatures features;
    AddSyntheticFeatures(*part, kCamera, pose, 0.3, &rng, &features);
    const ViewEvidence view = BuildViewEvidence(features);
    const auto hypotheses = FindViewHypotheses(*part,
                                               0,
                                               view,
                                               0,
                                               FindImagePaths(features, {}, 1.0, 450),
                                               CenteredCamera(640, 480, 1.1 * kCamera.focal_px),
                                               {},
                                               {});
    ASSERT_FALSE(hypotheses.best.empty());
    const ViewHypothesis& first = hypotheses.best[0];
    EXPECT_LT(ProjectionDistance(*part, first.camera, first.camera_from_object, kCamera, pose, 1.0),
              4.0)
        << "seed " << seed;
    EXPECT_GT(first.score, 0.7);
  }
}

// A cube under its 23 turns, among short edges into which small cubes fit.
TEST(FindViewHypotheses, OfASymmetricPartAmongLettersAreDistinctAndTheRightOneLeads) {
  constexpr double kSide = 0.08;
  ObjectModel model = Prism("cube", {{0, 0}, {kSide, 0}, {kSide, kSide}, {0, kSide}}, kSide);
  const Eigen::Vector3d center(kSide / 2, kSide / 2, kSide / 2);
  for (int up = 0; up < 6; ++up) {
    const Eigen::Matrix3d first =
        (up < 4 ? Eigen::AngleAxisd(up * M_PI / 2, Eigen::Vector3d::UnitX())
                : Eigen::AngleAxisd((up - 4.5) * M_PI, Eigen::Vector3d::UnitY()))
            .toRotationMatrix();
    for (int quarter = up == 0 ? 1 : 0; quarter < 4; ++quarter) {
      const Eigen::Matrix3d R =
          first *
          Eigen::AngleAxisd(quarter * M_PI / 2, Eigen::Vector3d::UnitZ()).toRotationMatrix();
      model.symmetries.push_back({R, center - R * center});
    }
  }
  ASSERT_EQ(model.symmetries.size(), 23u);
  const auto cube = PrepareObject(model).value();
  for (unsigned seed = 1; seed <= 3; ++seed) {
    SCOPED_TRACE(seed);
    std::mt19937 rng(seed);
    const Rigid3 pose = LookAt({0.30, -0.34, 0.36}, center);
    ImageFeatures features;
    AddSyntheticFeatures(*cube, kCamera, pose, 0.3, &rng, &features);
    for (int i = 0; i < 40; ++i) {  // small cubes, half of them on the large one
      std::uniform_real_distribution<double> u(-0.12, 0.12);
      const Eigen::Vector3d away(u(rng), u(rng), 2.2);
      const Rigid3 small{pose.R, 4.0 * away - pose.R * center};
      AddSyntheticFeatures(*cube, kCamera, small, 0.3, &rng, &features);
    }
    const ViewEvidence view = BuildViewEvidence(features);
    const auto found = FindViewHypotheses(*cube,
                                          0,
                                          view,
                                          0,
                                          FindImagePaths(features, {}, 1.0, 450),
                                          CenteredCamera(640, 480, 1.05 * kCamera.focal_px),
                                          {},
                                          {});
    const auto distance = [&](const ViewHypothesis& h,
                              const PinholeCamera& camera,
                              const Rigid3& p) {
      double nearest = ProjectionDistance(*cube, h.camera, h.camera_from_object, camera, p, 1.0);
      for (const Rigid3& s : model.symmetries)
        nearest = std::min(
            nearest, ProjectionDistance(*cube, h.camera, h.camera_from_object, camera, p * s, 1.0));
      return nearest;
    };
    ASSERT_FALSE(found.pool.empty());
    EXPECT_LT(distance(found.pool[0], kCamera, pose), 5.0);
    for (std::size_t i = 0; i < found.pool.size(); ++i) {
      for (std::size_t k = 0; k < i; ++k) {
        EXPECT_GE(distance(found.pool[k], found.pool[i].camera, found.pool[i].camera_from_object),
                  ViewHypothesisOptions().distinct_px);
      }
    }
  }
}

// No straight edge: arcs held against circles; what is off the axis tells the turn about it.
TEST(FindViewHypotheses, ATurnedPartIsFoundFromItsCircles) {
  const std::vector<CircleInSpace> on_top = {{{0.017, 0, 0.015}, {0, 0, 1}, 0.007},
                                             {{0, 0.019, 0.015}, {0, 0, 1}, 0.005}};
  const auto disc = PrepareObject(Disc(on_top)).value();
  for (unsigned seed = 1; seed <= 5; ++seed) {
    SCOPED_TRACE(seed);
    std::mt19937 rng(seed);
    std::uniform_real_distribution<double> u(-1, 1);
    const Rigid3 pose = LookAt({0.22 * u(rng), -0.22, 0.2 + 0.05 * u(rng)}, {0, 0, 0.01});
    ImageFeatures features;
    features.width = kCamera.width;
    features.height = kCamera.height;
    std::vector<CircleInSpace> seen = on_top;
    seen.push_back({{0, 0, 0.015}, {0, 0, 1}, 0.03});
    for (const CircleInSpace& c : seen)
      features.arcs.push_back(ImageOf(c, kCamera, pose, 0.3, &rng));
    AddChords(&features);
    const ViewEvidence view = BuildViewEvidence(features);
    const auto found = FindViewHypotheses(
        *disc, 0, view, 0, {}, CenteredCamera(640, 480, 1.1 * kCamera.focal_px), {}, {});
    ASSERT_FALSE(found.best.empty());
    const ViewHypothesis& first = found.best[0];
    EXPECT_LT(ProjectionDistance(*disc, first.camera, first.camera_from_object, kCamera, pose, 1.0),
              6.0);
    features.arcs.clear();
    const ViewEvidence without = BuildViewEvidence(features);
    EXPECT_TRUE(FindViewHypotheses(*disc, 0, without, 0, {}, kCamera, {}, {}).pool.empty());
  }
}

TEST(FindImagePaths, TextureStartsNoPathAndTheNumberIsBounded) {
  const auto part = PrepareObject(LBracket()).value();
  std::mt19937 rng(1);
  ImageFeatures features;
  AddSyntheticFeatures(
      *part, kCamera, LookAt({0.3, -0.32, 0.34}, {0.03, 0.02, 0.02}), 0.0, &rng, &features);
  EXPECT_EQ(FindImagePaths(features, {}, 1.0, 3).size(), 3u);
  for (Segment& s : features.segments) s.in_texture = true;
  EXPECT_TRUE(FindImagePaths(features, {}, 1.0, 100).empty());
}

// A plane seen by a camera of unknown focal length: the homography alone gives focal length and
// pose.
TEST(CameraFromPlane, RecoversFocalLengthAndPose) {
  const Rigid3 camera_from_plane = LookAt({0.4, -0.5, 0.45}, {0, 0, 0});
  Eigen::Matrix3d M;
  M << camera_from_plane.R.col(0), camera_from_plane.R.col(1), camera_from_plane.t;
  const auto found = CameraFromPlane(-2.5 * (kCamera.K() * M), CenteredCamera(640, 480, 1050.0));
  ASSERT_TRUE(found.has_value());
  EXPECT_NEAR(found->camera.focal_px, kCamera.focal_px, 1e-3 * kCamera.focal_px);
  EXPECT_LT((found->camera_from_plane.t - camera_from_plane.t).norm(), 1e-4);
  EXPECT_LT((found->camera_from_plane.R - camera_from_plane.R).norm(), 1e-4);
}

}  // namespace
}  // namespace horopter
