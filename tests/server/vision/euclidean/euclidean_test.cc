#include "server/vision/euclidean/euclidean.h"

#include <gtest/gtest.h>

#include <Eigen/Eigenvalues>

#include "server/vision/euclidean/plane_points.h"
#include "tests/support/synthetic_part.h"

namespace horopter {
namespace {

// Two parts on a table, five views, start values disturbed as recognition leaves them.
struct Scene {
  std::vector<std::shared_ptr<const PreparedObject>> objects{PrepareObject(LBracket()).value(),
                                                             PrepareObject(Wedge()).value()};
  std::vector<Rigid3> world_from_object;
  std::vector<PinholeCamera> cameras;
  std::vector<Rigid3> camera_from_world;
  std::vector<ImageFeatures> features;
  MatchingResult matching;
  RecognitionResult recognition;

  Scene(double noise_px, unsigned seed) {
    std::mt19937 rng(seed);
    world_from_object.resize(2);
    world_from_object[1].t = {0.12, 0.03, 0.0};
    world_from_object[1].R = RotationFromVector({0, 0, 0.7});
    for (int v = 0; v < 5; ++v) {
      const double a = -0.8 + 0.35 * v;
      cameras.push_back(CenteredCamera(640, 480, 880.0 + 40 * v));
      camera_from_world.push_back(
          LookAt({0.5 * std::sin(a), -0.5 * std::cos(a), 0.40}, {0.06, 0.02, 0.02}));
      ImageFeatures f;
      for (int k = 0; k < 2; ++k) {
        AddSyntheticFeatures(*objects[k],
                             cameras[v],
                             camera_from_world[v] * world_from_object[k],
                             noise_px,
                             &rng,
                             &f);
      }
      features.push_back(std::move(f));
    }
    recognition.state = RecognitionState::kRecognized;
    std::normal_distribution<double> g;
    auto disturb = [&](Rigid3 pose, double turn, double move) {
      const Eigen::Vector3d w(turn * g(rng), turn * g(rng), turn * g(rng));
      return Rigid3{RotationFromVector(w) * pose.R,
                    pose.t + Eigen::Vector3d(move * g(rng), move * g(rng), move * g(rng))};
    };
    for (int v = 0; v < 5; ++v) {
      CalibratedCamera view{cameras[v], camera_from_world[v]};
      view.camera.focal_px *= 1.01;
      recognition.views.push_back(view);
    }
    for (int k = 0; k < 2; ++k) {
      SceneObject o;
      o.object = k;
      o.scene_from_object =
          disturb(world_from_object[k], k == 0 ? 0.0 : 0.004, k == 0 ? 0.0 : 0.0008);
      recognition.objects.push_back(o);
    }
  }

  RecognitionInput Input() {
    RecognitionInput input;
    input.features = features;
    input.matching = &matching;
    input.objects = objects;
    return input;
  }

  // Table matches between neighbouring views.
  void AddTable(std::mt19937* rng) {
    std::uniform_real_distribution<double> u(-0.12, 0.2);
    for (int v = 0; v + 1 < 5; ++v) {
      PlaneHomography pair;
      pair.view_a = v;
      pair.view_b = v + 1;
      const auto from_plane = [&](int view) {
        Eigen::Matrix3d H;
        H << camera_from_world[view].R.leftCols<2>(), camera_from_world[view].t;
        return Eigen::Matrix3d(cameras[view].K() * H);
      };
      pair.b_from_a = from_plane(v + 1) * from_plane(v).inverse();
      for (int i = 0; i < 40; ++i) {
        const Eigen::Vector3d x(u(*rng), u(*rng), 0.0);
        pair.inliers_a.push_back(Project(cameras[v], camera_from_world[v] * x));
        pair.inliers_b.push_back(Project(cameras[v + 1], camera_from_world[v + 1] * x));
      }
      matching.planes.push_back(pair);
    }
  }
};

TEST(RefineMetricScene, RelativePoseOfTwoPartsWithinTwoMillimetresAtHalfAPixel) {
  for (unsigned seed = 1; seed <= 4; ++seed) {
    Scene scene(0.5, seed);
    const auto metric = RefineMetricScene(scene.Input(), scene.recognition, {});
    ASSERT_TRUE(metric.ok()) << metric.status();
    const Rigid3 estimated =
        metric->objects[0].scene_from_object.Inverse() * metric->objects[1].scene_from_object;
    const Rigid3 truth = scene.world_from_object[0].Inverse() * scene.world_from_object[1];
    EXPECT_LT((estimated * scene.objects[1]->center - truth * scene.objects[1]->center).norm(),
              0.002)
        << "seed " << seed;
  }
}

TEST(RefineMetricScene, TheTableDeterminesTheFocalLengths) {
  Scene scene(0.3, 5);
  std::mt19937 rng(5);
  scene.AddTable(&rng);
  const auto metric = RefineMetricScene(scene.Input(), scene.recognition, {});
  ASSERT_TRUE(metric.ok()) << metric.status();
  EXPECT_GT(metric->counts.at("plane_cells"), 20);
  for (int v = 0; v < 5; ++v) {
    ASSERT_TRUE(metric->cameras[v].has_value());
    EXPECT_NEAR(metric->cameras[v]->camera.focal_px / scene.cameras[v].focal_px, 1.0, 0.02);
    EXPECT_GT(metric->cameras[v]->focal_log_sigma, 0.0);
    EXPECT_LT(metric->cameras[v]->focal_log_sigma, 0.1);
  }
}

TEST(RefineMetricScene, FirstObjectIsTheFrameAndTheOthersHaveAPositiveCovariance) {
  Scene scene(0.3, 6);
  const auto metric = RefineMetricScene(scene.Input(), scene.recognition, {});
  ASSERT_TRUE(metric.ok());
  EXPECT_LT(metric->objects[0].scene_from_object.t.norm(), 1e-12);
  EXPECT_EQ(metric->objects[0].covariance, Matrix6d::Zero());
  const Eigen::SelfAdjointEigenSolver<Matrix6d> eigen(metric->objects[1].covariance);
  EXPECT_GT(eigen.eigenvalues().minCoeff(), 0.0);
  EXPECT_LT(std::sqrt(eigen.eigenvalues().maxCoeff()), 0.1);
}

TEST(RefineMetricScene, AGivenFocalLengthIsKept) {
  Scene scene(0.3, 7);
  RecognitionInput input = scene.Input();
  std::vector<CameraHint> hints(5);
  for (int v = 0; v < 5; ++v) {
    hints[v].focal_px = scene.cameras[v].focal_px;
    hints[v].focal_log_sigma = 1e-4;
  }
  input.hints = hints;
  const auto metric = RefineMetricScene(input, scene.recognition, {});
  ASSERT_TRUE(metric.ok());
  for (int v = 0; v < 5; ++v) {
    EXPECT_NEAR(metric->cameras[v]->camera.focal_px / scene.cameras[v].focal_px, 1.0, 1e-3);
  }
}

TEST(RefineMetricScene, NothingToRefineIsAPrecondition) {
  Scene scene(0.3, 8);
  RecognitionResult none = scene.recognition;
  none.objects.clear();
  EXPECT_EQ(RefineMetricScene(scene.Input(), none, {}).status().code(),
            absl::StatusCode::kFailedPrecondition);
  RecognitionResult blind = scene.recognition;
  for (auto& v : blind.views) v.reset();
  EXPECT_EQ(RefineMetricScene(scene.Input(), blind, {}).status().code(),
            absl::StatusCode::kFailedPrecondition);
  EXPECT_EQ(
      RefineMetricScene(scene.Input(), scene.recognition, {}, [] { return true; }).status().code(),
      absl::StatusCode::kCancelled);
  for (ImageFeatures& f : scene.features) {
    f.segments.clear();
    f.chains.clear();
  }
  EXPECT_EQ(RefineMetricScene(scene.Input(), scene.recognition, {}).status().code(),
            absl::StatusCode::kFailedPrecondition);
}

TEST(RefineMetricScene, NoObjectThatFitsIsAPrecondition) {
  Scene scene(0.3, 9);
  scene.recognition.objects.push_back(scene.recognition.objects[1]);  // of two none is rejected
  EuclideanOptions options;
  options.misfits.least_found = 2.0;  // more than all of its edges
  EXPECT_EQ(RefineMetricScene(scene.Input(), scene.recognition, options).status().code(),
            absl::StatusCode::kFailedPrecondition);
}

TEST(FindPlanePoints, PlaneOfTheTableAndNothingFromTooFewMatches) {
  Scene scene(0.0, 9);
  std::mt19937 rng(9);
  std::vector<std::optional<CalibratedCamera>> views;
  for (int v = 0; v < 5; ++v)
    views.push_back(CalibratedCamera{scene.cameras[v], scene.camera_from_world[v]});
  EXPECT_TRUE(FindPlanePoints(scene.matching, views).matches.empty());
  scene.AddTable(&rng);
  const PlanePoints plane = FindPlanePoints(scene.matching, views);
  EXPECT_EQ(plane.matches.size(), 160u);
  EXPECT_GT(plane.plane.normalized().z(), 0.9999);  // towards the cameras
}

TEST(GraspsInScene, OnePerSymmetryAndGrasp) {
  ObjectModel model = Wedge();
  Grasp g;
  g.name = "top";
  g.object_from_gripper.t = {0.01, 0.02, 0.03};
  g.jaw_opening_m = 0.05;
  Grasp waiting = g;
  waiting.object_from_pregrasp = g.object_from_gripper;
  waiting.object_from_pregrasp->t.z() = 0.2;
  model.grasps = {g, waiting};
  model.symmetries = {{RotationFromVector({0, 0, 3.14159265358979}), {0, 0, 0}}};
  Rigid3 scene_from_object;
  scene_from_object.t = {1, 0, 0};
  const auto grasps = GraspsInScene(model, scene_from_object, 0.05);
  ASSERT_EQ(grasps.size(), 4u);
  EXPECT_TRUE(grasps[0].scene_from_gripper.t.isApprox(Eigen::Vector3d(1.01, 0.02, 0.03), 1e-12));
  EXPECT_TRUE(grasps[2].scene_from_gripper.t.isApprox(Eigen::Vector3d(0.99, -0.02, 0.03), 1e-12));
  EXPECT_EQ(grasps[2].symmetry, 1);
  // Straight back where none was enrolled.
  EXPECT_TRUE(grasps[0].scene_from_pregrasp.t.isApprox(Eigen::Vector3d(1.01, 0.02, -0.02), 1e-12));
  EXPECT_TRUE(grasps[1].scene_from_pregrasp.t.isApprox(Eigen::Vector3d(1.01, 0.02, 0.2), 1e-12));
  EXPECT_TRUE(grasps[3].scene_from_pregrasp.t.isApprox(Eigen::Vector3d(0.99, -0.02, 0.2), 1e-12));
}

}  // namespace
}  // namespace horopter
