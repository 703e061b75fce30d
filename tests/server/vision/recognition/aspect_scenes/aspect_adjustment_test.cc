#include "server/vision/recognition/aspect_scenes/aspect_adjustment.h"

#include <gtest/gtest.h>

#include <Eigen/Geometry>
#include <cmath>
#include <random>

namespace horopter {
namespace {

Rigid3 Pose(const Eigen::Vector3d& turn, const Eigen::Vector3d& t) {
  const double angle = turn.norm();
  Rigid3 pose;
  if (angle > 0) pose.R = Eigen::AngleAxisd(angle, turn / angle).toRotationMatrix();
  pose.t = t;
  return pose;
}

// Three cameras around two objects, the second a little beside the first.
AspectScene TrueScene() {
  AspectScene scene;
  for (int v = 0; v < 3; ++v) {
    AspectSceneView view;
    view.camera = CenteredCamera(640, 480, 700.0 + 30 * v);
    view.camera_from_scene = Pose({0.9, 0.25 * v - 0.25, 0.1 * v}, {0.01 * v, 0.0, 0.5});
    view.prior_log_focal = std::log(768.0);
    scene.views.push_back(view);
  }
  scene.objects.push_back({0, Rigid3{}});
  scene.objects.push_back({1, Pose({0.2, -0.1, 0.6}, {0.08, 0.03, 0.01})});
  return scene;
}

// Points of both objects seen in all views, across two directions each, with noise.
std::vector<SceneRow> RowsOf(const AspectScene& scene, double noise_px, std::mt19937* random) {
  std::normal_distribution<double> noise(0.0, noise_px);
  std::uniform_real_distribution<double> place(-0.04, 0.04);
  std::vector<SceneRow> rows;
  for (int o = 0; o < static_cast<int>(scene.objects.size()); ++o) {
    for (int i = 0; i < 30; ++i) {
      const Eigen::Vector3d x(place(*random), place(*random), place(*random));
      for (int v = 0; v < static_cast<int>(scene.views.size()); ++v) {
        const AspectSceneView& view = *scene.views[v];
        const Eigen::Vector2d u =
            Project(view.camera, view.camera_from_scene * (scene.objects[o].scene_from_object * x));
        for (const Eigen::Vector2d& n : {Eigen::Vector2d(1, 0), Eigen::Vector2d(0, 1)})
          rows.push_back({v, o, x, u + n * noise(*random), n, 1.0});
      }
    }
  }
  return rows;
}

AspectScene Disturbed(AspectScene scene, std::mt19937* random) {
  std::normal_distribution<double> n(0.0, 1.0);
  const auto by = [&](double s) -> Eigen::Vector3d {
    return s * Eigen::Vector3d(n(*random), n(*random), n(*random));
  };
  for (auto& view : scene.views) {
    view->camera_from_scene = Pose(by(0.03), by(0.005)) * view->camera_from_scene;
    view->camera.focal_px *= std::exp(0.05 * n(*random));
  }
  Rigid3& second = scene.objects[1].scene_from_object;
  second = second * Pose(by(0.05), by(0.004));
  return scene;
}

double LargestErrorPx(const AspectScene& a, const AspectScene& truth) {
  double largest = 0.0;
  for (std::size_t v = 0; v < truth.views.size(); ++v) {
    for (std::size_t o = 0; o < truth.objects.size(); ++o) {
      for (int axis = 0; axis < 3; ++axis) {
        const Eigen::Vector3d x = 0.04 * Eigen::Vector3d::Unit(axis);
        const auto pixel = [&](const AspectScene& s) -> Eigen::Vector2d {
          return Project(s.views[v]->camera,
                         s.views[v]->camera_from_scene * (s.objects[o].scene_from_object * x));
        };
        largest = std::max(largest, (pixel(a) - pixel(truth)).norm());
      }
    }
  }
  return largest;
}

TEST(AdjustToRows, FindsCamerasAndPosesAgainAndErrorsGrowWithTheNoise) {
  const AspectScene truth = TrueScene();
  for (const double noise : {0.0, 0.3, 1.0}) {
    for (unsigned seed = 1; seed <= 10; ++seed) {
      SCOPED_TRACE(testing::Message() << "seed " << seed << ", noise " << noise);
      std::mt19937 random(seed);
      const std::vector<SceneRow> rows = RowsOf(truth, noise, &random);
      AspectScene scene = Disturbed(truth, &random);
      ASSERT_GT(LargestErrorPx(scene, truth), 3.0);
      const double rms = AdjustToRows(rows, 20, 1.0, &scene);
      // The weak prior of the focal length alone keeps noise-free rows from zero.
      EXPECT_LT(rms, 0.05 + 1.1 * noise);
      EXPECT_LT(LargestErrorPx(scene, truth), 0.3 + 2.0 * noise);
      EXPECT_TRUE(scene.objects[0].scene_from_object.R.isIdentity());
    }
  }
}

TEST(AdjustToRows, FocalLengthsThatOneViewLeavesFreeFollowTheOthers) {
  AspectScene truth = TrueScene();
  truth.objects.pop_back();
  for (auto& view : truth.views) view->camera.focal_px = 900.0;
  for (unsigned seed = 1; seed <= 10; ++seed) {
    SCOPED_TRACE(testing::Message() << "seed " << seed);
    std::mt19937 random(seed);
    // View 2 sees two points, which tell nothing of its focal length.
    std::vector<SceneRow> rows = RowsOf(truth, 0.3, &random);
    int of_view = 0;
    std::erase_if(rows, [&](const SceneRow& r) { return r.view == 2 && ++of_view > 4; });
    AspectScene scene = truth;
    scene.views[2]->camera.focal_px = 700.0;
    for (int k = 0; k < 5; ++k) AdjustToRows(rows, 20, 1.0, &scene);
    EXPECT_NEAR(std::log(scene.views[2]->camera.focal_px / 900.0), 0.0, 0.1);
  }
}

TEST(AdjustToRows, ASetOfTwoCamerasKeepsTheirFocalLengths) {
  AspectScene truth = TrueScene();
  truth.views[2]->camera.focal_px = 1100.0;
  for (unsigned seed = 1; seed <= 10; ++seed) {
    SCOPED_TRACE(testing::Message() << "seed " << seed);
    std::mt19937 random(seed);
    const std::vector<SceneRow> rows = RowsOf(truth, 0.3, &random);
    AspectScene scene = Disturbed(truth, &random);
    AdjustToRows(rows, 30, 1.0, &scene);
    EXPECT_NEAR(std::log(scene.views[2]->camera.focal_px / 1100.0), 0.0, 0.03);
  }
}

TEST(WithOneFocal, KeepsThePlaceAndTheSizeOfTheMiddle) {
  AspectScene scene = TrueScene();
  scene.views[1]->camera = CenteredCamera(320, 240, 365.0);  // of half the size
  scene.views[2].reset();
  const Eigen::Vector3d middle(0.04, 0.015, 0.005);
  const AspectScene one = WithOneFocal(scene, middle, 2.0, 0.02);
  EXPECT_FALSE(one.views[2].has_value());
  for (int v = 0; v < 2; ++v) {
    const AspectSceneView &before = *scene.views[v], &after = *one.views[v];
    EXPECT_NEAR(RelativeFocal(after.camera), 2.0, 1e-12);
    EXPECT_NEAR(after.prior_log_focal, std::log(after.camera.focal_px), 1e-12);
    EXPECT_EQ(after.log_focal_sigma, 0.02);
    const auto pixel = [&](const AspectSceneView& view,
                           const Eigen::Vector3d& x) -> Eigen::Vector2d {
      return Project(view.camera, view.camera_from_scene * x);
    };
    EXPECT_LT((pixel(after, middle) - pixel(before, middle)).norm(), 1e-9);
    // Across the line of sight.
    const Eigen::Vector3d across =
        0.01 * (before.camera_from_scene.R.transpose() * Eigen::Vector3d::UnitX());
    EXPECT_LT((pixel(after, middle + across) - pixel(before, middle + across)).norm(), 1e-9);
  }
}

TEST(AdjustToRows, NeverMakesItWorse) {
  const AspectScene truth = TrueScene();
  for (unsigned seed = 1; seed <= 20; ++seed) {
    std::mt19937 random(seed);
    const std::vector<SceneRow> rows = RowsOf(truth, 0.5, &random);
    AspectScene scene = Disturbed(Disturbed(Disturbed(truth, &random), &random), &random);
    AspectScene held = scene;
    const double before = AdjustToRows(rows, 0, 1.0, &held);
    EXPECT_LE(AdjustToRows(rows, 3, 1.0, &scene), before) << "seed " << seed;
  }
}

TEST(AdjustToRows, NothingToAdjustLeavesTheSceneAsItIs) {
  AspectScene scene = TrueScene();
  EXPECT_EQ(AdjustToRows({}, 5, 1.0, &scene), 0.0);
  EXPECT_EQ(LargestErrorPx(scene, TrueScene()), 0.0);
  AspectScene empty;
  EXPECT_EQ(AdjustToRows({}, 5, 1.0, &empty), 0.0);
}

TEST(AdjustObjectToRows, MovesTheObjectOnly) {
  const AspectScene truth = TrueScene();
  for (unsigned seed = 1; seed <= 10; ++seed) {
    std::mt19937 random(seed);
    std::vector<SceneRow> rows = RowsOf(truth, 0.0, &random);
    std::erase_if(rows, [](const SceneRow& r) { return r.object != 1; });
    AspectScene scene = truth;
    Rigid3 pose = Disturbed(truth, &random).objects[1].scene_from_object;
    for (int i = 0; i < 10; ++i) pose = AdjustObjectToRows(rows, truth.views, pose);
    scene.objects[1].scene_from_object = pose;
    EXPECT_LT(LargestErrorPx(scene, truth), 1e-3) << "seed " << seed;
  }
}

// Cameras as something else knows them: in a unit, and turned a little.
CamerasPrior PriorOf(const AspectScene& scene, double unit_m, double turn_rad) {
  std::mt19937 random(5);
  std::normal_distribution<double> n(0.0, 1.0);
  CamerasPrior prior;
  prior.rotation_sigma_rad = turn_rad;
  prior.position_sigma = turn_rad;
  prior.unit_m = unit_m;
  for (const auto& view : scene.views) {
    const double x = n(random), y = n(random), z = n(random);
    Rigid3 pose = Pose(turn_rad * Eigen::Vector3d(x, y, z), Eigen::Vector3d::Zero()) *
                  view->camera_from_scene;
    pose.t /= unit_m;
    prior.camera_from_world.emplace_back(pose);
  }
  return prior;
}

TEST(AspectAdjustment, UnderAPriorOfTheCamerasTheirUnitIsFound) {
  std::mt19937 random(3);
  const AspectScene truth = TrueScene();
  const std::vector<SceneRow> rows = RowsOf(truth, 0.3, &random);
  for (const double off : {0.8, 1.0, 1.25}) {
    SCOPED_TRACE(testing::Message() << "unit off by " << off);
    CamerasPrior prior = PriorOf(truth, 0.37, 0.004);
    prior.unit_m *= off;
    AspectScene scene = truth;
    for (std::size_t v = 0; v < scene.views.size(); ++v) {
      scene.views[v]->camera_from_scene = *prior.camera_from_world[v];
      scene.views[v]->camera_from_scene.t *= prior.unit_m;
    }
    AdjustToRows(rows, 20, 1.0, &scene, &prior);
    EXPECT_LT(LargestErrorPx(scene, truth), 1.0);
    // Turns of the prior against a quarter of a radian between its cameras.
    EXPECT_NEAR(prior.unit_m, 0.37, 0.004 / 0.25 * 0.37);
  }
}

TEST(AspectAdjustment, UnderAPriorInMetresTheUnitStays) {
  std::mt19937 random(3);
  const AspectScene truth = TrueScene();
  const std::vector<SceneRow> rows = RowsOf(truth, 0.3, &random);
  CamerasPrior prior = PriorOf(truth, 1.0, 0.004);
  prior.scale_known = true;
  AspectScene scene = Disturbed(truth, &random);
  AdjustToRows(rows, 20, 1.0, &scene, &prior);
  EXPECT_LT(LargestErrorPx(scene, truth), 1.0);
  EXPECT_EQ(prior.unit_m, 1.0);
}

TEST(AspectAdjustment, CamerasWithoutRowsStayWhereThePriorHasThem) {
  std::mt19937 random(3);
  const AspectScene truth = TrueScene();
  std::vector<SceneRow> rows = RowsOf(truth, 0.3, &random);
  std::erase_if(rows, [](const SceneRow& row) { return row.view == 2; });
  CamerasPrior prior = PriorOf(truth, 1.0, 1e-3);
  prior.scale_known = true;
  AspectScene scene = truth;
  scene.views[2]->camera_from_scene =
      Pose({0.05, 0, 0}, Eigen::Vector3d::Zero()) * scene.views[2]->camera_from_scene;
  AdjustToRows(rows, 20, 1.0, &scene, &prior);
  EXPECT_LT((scene.views[2]->camera_from_scene.R - prior.camera_from_world[2]->R).norm(), 3e-3);
  EXPECT_LT((scene.views[2]->camera_from_scene.t - prior.camera_from_world[2]->t).norm(), 3e-3);
}

}  // namespace
}  // namespace horopter
