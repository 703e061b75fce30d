#include "server/vision/recognition/aspect_scenes/rig_search.h"

#include <gtest/gtest.h>

#include <random>

#include "tests/support/photo_scene.h"

namespace horopter {
namespace {

// A block and a cube before cameras that are known; each view's search shows both, a little off.
class RigSearch : public testing::Test {
 protected:
  static void SetUpTestSuite() {
    block_ = new PhotoPart(MakePart(SteppedBlock()));
    cube_ = new PhotoPart(MakePart(BoxMesh({0.014, 0.012, 0.012})));
  }
  static void TearDownTestSuite() {
    delete block_;
    delete cube_;
  }

  RigSearch() {
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
      rig_.push_back(
          AspectSceneView{Camera(), CameraFromScene(v), std::log(Camera().focal_px), 0.01});
    }
    priors_.assign(kViews, {Camera(), 0.01});
    none_.resize(kViews);
    options_.standing = 0;
  }

  LinkedScene Find(unsigned seed) {
    std::mt19937 random(seed);
    searched_ = 0;
    const auto search = [&](int v) {
      ++searched_;
      return std::vector<AspectHypothesis>{Seen(v, 0, Rigid3{}, &random),
                                           Seen(v, 1, cube_pose_, &random)};
    };
    return FindInRig({images_, priors_, none_, parts_, nullptr, search}, rig_, options_);
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
  std::vector<std::optional<AspectSceneView>> rig_;
  AspectLinkOptions options_;
  int searched_ = 0;
};

TEST_F(RigSearch, FindsAllPartsFromTwoViewsAndLeavesTheCameras) {
  for (const unsigned seed : {1u, 2u, 3u}) {
    SCOPED_TRACE(testing::Message() << "seed " << seed);
    const LinkedScene scene = Find(seed);
    ASSERT_EQ(scene.objects.size(), 2u);
    EXPECT_EQ(searched_, 2);  // two parts: one might have hidden another
    for (const LinkedObject& o : scene.objects) {
      const Rigid3 truth = o.object == 0 ? Rigid3{} : cube_pose_;
      EXPECT_LT((o.scene_from_object.t - truth.t).norm(), 1e-3);
    }
    for (int v = 0; v < kViews; ++v) {
      ASSERT_TRUE(scene.views[v]);
      EXPECT_EQ(scene.views[v]->camera_from_scene.t, rig_[v]->camera_from_scene.t);
    }
  }
}

// The camera is turned in its place, which moves its image.
void TurnCamera(double angle, AspectSceneView* view) {
  view->camera_from_scene = Turn(Eigen::Vector3d::UnitY(), angle) * view->camera_from_scene;
}

TEST_F(RigSearch, ACameraThatWasMovedALittleIsFoundAgain) {
  for (int moved = 0; moved < kViews; ++moved) {
    SCOPED_TRACE(testing::Message() << "camera " << moved);
    const auto before = rig_;
    TurnCamera(0.0125, &*rig_[moved]);  // 10 pixels
    const LinkedScene scene = Find(1);
    ASSERT_EQ(scene.objects.size(), 2u);
    ASSERT_TRUE(scene.views[moved]);
    const auto middle = [](const AspectSceneView& view) {
      return Project(view.camera, view.camera_from_scene.t);
    };
    EXPECT_LT((middle(*scene.views[moved]) - middle(*before[moved])).norm(), 1.5);
    rig_ = before;
  }
}

TEST_F(RigSearch, AnswersNothingWhereACameraIsSomewhereElse) {
  TurnCamera(0.12, &*rig_[1]);
  EXPECT_TRUE(Find(1).objects.empty());
  EXPECT_EQ(searched_, kViews);
}

TEST_F(RigSearch, ACameraThatSeesNoneOfThePartsSaysNothingAgainstThem) {
  // It looks past them, and its image is another one's.
  TurnCamera(0.9, &*rig_[0]);
  const LinkedScene scene = Find(1);
  EXPECT_EQ(scene.objects.size(), 2u);
  EXPECT_FALSE(scene.views[0]);
}

}  // namespace
}  // namespace horopter
