#include "server/vision/recognition/aspect_scenes/camera_search.h"

#include <gtest/gtest.h>

#include <random>

#include "tests/support/photo_scene.h"

namespace horopter {
namespace {

// A block and a cube before cameras that are known; each view's search shows both, a little off.
class CameraSearchTest : public testing::Test {
 protected:
  static void SetUpTestSuite() {
    block_ = new PhotoPart(MakePart(SteppedBlock()));
    cube_ = new PhotoPart(MakePart(BoxMesh({0.014, 0.012, 0.012})));
  }
  static void TearDownTestSuite() {
    delete block_;
    delete cube_;
  }

  CameraSearchTest() {
    cube_pose_.t = {0.055, 0.0, 0.0};
    for (const PhotoPart* photo : {block_, cube_}) {
      AspectModel part;
      part.object = &photo->object;
      part.fragments = &photo->fragments;
      parts_.push_back(part);
    }
    for (int v = 0; v < kViews; ++v) {
      images_.push_back(
          MakeAspectImage(PhotoOf({{&block_->object.mesh, CameraFromScene(v)},
                                   {&cube_->object.mesh, CameraFromScene(v) * cube_pose_}},
                                  Camera())));
      CalibratedView& view = known_.views.emplace_back().emplace();
      view.camera = Camera();
      view.camera_from_scene = CameraFromScene(v);
      view.focal_log_sigma = 0.01;
    }
    known_.scale_known = true;
    known_.rotation_sigma_rad = 0.008;
    known_.position_sigma = 0.01;
    priors_.assign(kViews, {Camera(), 0.01});
    none_.resize(kViews);
    options_.standing = 0;
  }

  LinkedScene Find(unsigned seed, const StopRequested& hurry = {}, const StopRequested& stop = {}) {
    std::mt19937 random(seed);
    searched_ = 0;
    const auto search = [&](int v) {
      ++searched_;
      if (only_view_ >= 0 && v != only_view_) return std::vector<AspectHypothesis>{};
      return std::vector<AspectHypothesis>{Seen(v, 0, Rigid3{}, &random),
                                           Seen(v, 1, cube_pose_, &random)};
    };
    return FindInCameras({images_, priors_, none_, parts_, search}, known_, options_, hurry, stop);
  }

  // Depth is told least by a single view.
  static AspectHypothesis Seen(int v, int object, const Rigid3& pose, std::mt19937* random) {
    std::normal_distribution<double> off(0.0, 1.0);
    const double x = off(*random), y = off(*random), z = off(*random);
    AspectHypothesis h;
    h.object = object;
    h.camera = Camera();
    h.camera_from_object = CameraFromScene(v) * pose;
    h.camera_from_object.t += 3e-4 * Eigen::Vector3d(x, y, 10 * z);
    h.score = 0.5;
    return h;
  }

  static inline PhotoPart *block_ = nullptr, *cube_ = nullptr;
  Rigid3 cube_pose_;
  std::vector<AspectImage> images_;
  std::vector<AspectViewPrior> priors_;
  std::vector<std::vector<AspectHypothesis>> none_;
  std::vector<AspectModel> parts_;
  KnownCameras known_;
  AspectLinkOptions options_;
  int searched_ = 0;
  int only_view_ = -1;  // the others show nothing
};

// Largest distance in any registered image between the parts as found and as they are.
double WorstPx(const LinkedScene& scene, const Rigid3& cube_pose) {
  double worst = 0.0;
  for (const LinkedObject& o : scene.objects) {
    for (int v = 0; v < kViews; ++v) {
      if (!scene.views[v]) continue;
      for (const Eigen::Vector3d& x : {Eigen::Vector3d(0.012, 0, 0),
                                       Eigen::Vector3d(0, 0.012, 0),
                                       Eigen::Vector3d(0, 0, 0.012)}) {
        const Rigid3 truth = CameraFromScene(v) * (o.object == 0 ? Rigid3{} : cube_pose);
        const Rigid3 found = scene.views[v]->camera_from_scene * o.scene_from_object;
        worst = std::max(
            worst,
            (Project(scene.views[v]->camera, found * x) - Project(Camera(), truth * x)).norm());
      }
    }
  }
  return worst;
}

TEST_F(CameraSearchTest, FindsAllPartsFromTwoViews) {
  for (const unsigned seed : {1u, 2u, 3u}) {
    SCOPED_TRACE(testing::Message() << "seed " << seed);
    const LinkedScene scene = Find(seed);
    ASSERT_EQ(scene.objects.size(), 2u);
    EXPECT_EQ(searched_, 2);  // two parts: one might have hidden another
    EXPECT_EQ(scene.registered(), kViews);
    EXPECT_LT(WorstPx(scene, cube_pose_), 1.5);
    for (const LinkedObject& o : scene.objects) {
      const Rigid3 truth = o.object == 0 ? Rigid3{} : cube_pose_;
      EXPECT_LT((o.scene_from_object.t - truth.t).norm(), 3e-3);
    }
  }
}

// Turns each camera in its place, which moves its image by some 10 pixels, draws what it sees
// larger, and gives the unit.
void Disturb(double unit_m, KnownCameras* known) {
  std::mt19937 random(7);
  std::normal_distribution<double> normal(0.0, 1.0);
  for (auto& view : known->views) {
    view->camera.focal_px *= 1.04;
    view->camera_from_scene.t.z() *= 1.04;
    const double x = normal(random), y = normal(random), z = normal(random);
    const Rigid3 turned =
        Turn(Eigen::Vector3d(x, y, z).normalized(), 0.012) * view->camera_from_scene;
    view->camera_from_scene = {turned.R, turned.t / unit_m};
    view->focal_log_sigma = 0.05;
  }
  known->scale_known = false;
  known->rotation_sigma_rad = 0.012;
  known->position_sigma = 0.02;
}

TEST_F(CameraSearchTest, OneViewIsEnoughUnderCamerasThatAreOffAndOfUnknownUnit) {
  Disturb(0.37, &known_);
  for (only_view_ = 0; only_view_ < kViews; ++only_view_) {
    SCOPED_TRACE(testing::Message() << "view " << only_view_);
    const LinkedScene scene = Find(1);
    ASSERT_EQ(scene.objects.size(), 2u);
    EXPECT_EQ(scene.registered(), kViews);
    EXPECT_LT(WorstPx(scene, cube_pose_), 2.0);
  }
}

TEST_F(CameraSearchTest, TheUnitIsFoundWithoutPointsAndWithThem) {
  Disturb(12.0, &known_);
  only_view_ = 1;
  EXPECT_EQ(Find(1).objects.size(), 2u);
  for (int i = 0; i < 40; ++i) {
    known_.points.emplace_back().point_in_world =
        Eigen::Vector3d(0.004 * (i % 7), 0.003 * (i % 5), 0) / 12.0;
  }
  EXPECT_EQ(Find(1).objects.size(), 2u);
}

// A point of texture that all views show.
ReconstructedPoint TexturePoint(const Eigen::Vector3d& x, bool on_plane = false) {
  ReconstructedPoint point;
  point.point_in_world = x;
  point.on_plane = on_plane;
  for (int v = 0; v < kViews; ++v) {
    point.observations.emplace_back(v, -1);
    point.pixels.push_back(Project(Camera(), CameraFromScene(v) * x));
  }
  return point;
}

TEST_F(CameraSearchTest, WhatTextureIsSeenThroughIsNotPlaced) {
  // What each view shows through the middle of the cube, on a plane behind it.
  for (int v = 0; v < kViews; ++v) {
    const Eigen::Vector3d eye = CameraFromScene(v).Inverse().t;
    for (int k = 0; k < 9; ++k) {
      const Eigen::Vector3d through =
          cube_pose_ * Eigen::Vector3d(1e-3 * (k % 3 - 1), 1e-3 * (k / 3 - 1), 0);
      const double far = (eye.z() + 0.04) / (eye.z() - through.z());
      known_.points.push_back(TexturePoint(eye + far * (through - eye)));
    }
  }
  const LinkedScene scene = Find(1);
  ASSERT_EQ(scene.objects.size(), 1u);
  EXPECT_EQ(scene.objects[0].object, 0);
  known_.points.clear();
  EXPECT_EQ(Find(1).objects.size(), 2u);
}

TEST_F(CameraSearchTest, APartIsNotPlacedInATableThatTextureShowsAroundIt) {
  // Around the cube, and not under it or the block.
  const auto put_table = [&](double z) {
    known_.points.clear();
    for (int i = 0; i < 81; ++i) {
      const double x = 0.0125 * (i % 9 - 4), y = 0.0125 * (i / 9 - 4);
      if (x > -0.03 && std::max(std::abs(x), std::abs(y)) > 0.02)
        known_.points.push_back(TexturePoint({cube_pose_.t.x() + x, y, z}, true));
    }
  };
  put_table(0.004);
  const LinkedScene scene = Find(1);
  ASSERT_EQ(scene.objects.size(), 1u);
  EXPECT_EQ(scene.objects[0].object, 0);
  put_table(-0.012);
  EXPECT_EQ(Find(1).objects.size(), 2u);
}

TEST_F(CameraSearchTest, APartLiesOnThePlaneOfTheTexture) {
  const double under_m = -0.012;
  parts_[1].resting = {{Eigen::Vector3d::UnitZ(), -under_m}};
  const auto lies = [&] {
    const LinkedScene scene = Find(1);
    for (const LinkedObject& o : scene.objects) {
      if (o.object == 1) return o.lies;
    }
    ADD_FAILURE() << "the cube is not found";
    return false;
  };
  EXPECT_FALSE(lies());
  for (int i = 0; i < 49; ++i) {
    known_.points.push_back(TexturePoint({0.03 * (i % 7 - 3), 0.03 * (i / 7 - 3), under_m}, true));
  }
  EXPECT_TRUE(lies());
  for (ReconstructedPoint& point : known_.points)
    point = TexturePoint(point.point_in_world - Eigen::Vector3d(0, 0, 0.01), true);
  EXPECT_FALSE(lies());
}

TEST_F(CameraSearchTest, NothingIsPlacedWhereNoViewShowsIt) {
  only_view_ = kViews;
  const LinkedScene scene = Find(1);
  EXPECT_TRUE(scene.objects.empty());
  EXPECT_EQ(scene.registered(), 0);
  EXPECT_EQ(searched_, kViews);
}

TEST_F(CameraSearchTest, AnUnknownViewIsNotRegistered) {
  known_.views[2].reset();
  const LinkedScene scene = Find(1);
  EXPECT_EQ(scene.objects.size(), 2u);
  EXPECT_FALSE(scene.views[2]);
}

// The camera is turned in its place, which moves its image.
void TurnCamera(double angle, std::optional<CalibratedView>* view) {
  (*view)->camera_from_scene = Turn(Eigen::Vector3d::UnitY(), angle) * (*view)->camera_from_scene;
}

TEST_F(CameraSearchTest, ACameraThatWasMovedALittleIsFoundAgain) {
  for (int moved = 0; moved < kViews; ++moved) {
    SCOPED_TRACE(testing::Message() << "camera " << moved);
    const KnownCameras before = known_;
    TurnCamera(0.0125, &known_.views[moved]);  // 10 pixels
    const LinkedScene scene = Find(1);
    ASSERT_EQ(scene.objects.size(), 2u);
    ASSERT_TRUE(scene.views[moved]);
    EXPECT_LT(WorstPx(scene, cube_pose_), 1.5);
    known_ = before;
  }
}

TEST_F(CameraSearchTest, ACameraThatIsSomewhereElseIsLeftOut) {
  TurnCamera(0.12, &known_.views[1]);
  const LinkedScene scene = Find(1);
  EXPECT_EQ(scene.objects.size(), 2u);
  EXPECT_FALSE(scene.views[1]);
}

TEST_F(CameraSearchTest, ACameraThatSeesNoneOfThePartsSaysNothingAgainstThem) {
  // It looks past them, and its image is another one's.
  TurnCamera(0.9, &known_.views[0]);
  EXPECT_EQ(Find(1).objects.size(), 2u);
}

TEST_F(CameraSearchTest, WhatOneViewShowsIsAnsweredInAHurry) {
  const LinkedScene scene = Find(1, [this] { return searched_ > 0; });
  ASSERT_GE(scene.objects.size(), 1u);
  EXPECT_EQ(searched_, 1);
  EXPECT_EQ(scene.registered(), kViews);
  EXPECT_LT(WorstPx(scene, cube_pose_), 2.0);
}

TEST_F(CameraSearchTest, NothingIsAnsweredOnceCancelled) {
  const auto after_a_view = [this] { return searched_ > 0; };
  const LinkedScene scene = Find(1, after_a_view, after_a_view);
  EXPECT_TRUE(scene.objects.empty());
  EXPECT_EQ(searched_, 1);
}

}  // namespace
}  // namespace horopter
