#include "server/vision/recognition/aspect_scenes/faint_objects.h"

#include <gtest/gtest.h>

#include <Eigen/Geometry>
#include <opencv2/imgproc.hpp>
#include <random>

#include "tests/support/part_photos.h"

namespace horopter {
namespace {

constexpr int kAngle = 0, kBlock = 1;
constexpr int kWires = 12;  // before the block, in each image others

// An angle and a block on the plane z = 0 before four cameras, the block behind wires.
class FaintObjects : public testing::TestWithParam<unsigned> {
 protected:
  static void SetUpTestSuite() {
    parts_ = new std::vector<PhotoPart>(AngleBlockCylinder({0.03, 0.02, 0.012}, 0.018, 0.012));
    for (const PhotoPart& p : *parts_) {
      models_.push_back({&p.object, &p.fragments, p.model.symmetries});
      models_.back().resting = {{Eigen::Vector3d::UnitZ(), 0.012},
                                {-Eigen::Vector3d::UnitZ(), 0.012}};
    }
  }
  static void TearDownTestSuite() {
    delete parts_;
    models_.clear();
  }

  static PinholeCamera Camera() { return CenteredCamera(640, 480, 700.0); }

  static Rigid3 CameraFromScene(double turn) {
    return {(Eigen::AngleAxisd(M_PI - 0.75, Eigen::Vector3d::UnitX()) *
             Eigen::AngleAxisd(turn, Eigen::Vector3d::UnitZ()))
                .toRotationMatrix(),
            Eigen::Vector3d(0.0, 0.0, 0.36)};
  }

  static Rigid3 Standing(double x, double y, double yaw) {
    Rigid3 pose = Turn(Eigen::Vector3d::UnitZ(), yaw);
    pose.t = {x, y, 0.012};
    return pose;
  }
  static Rigid3 AngleThere() { return Standing(-0.05, 0.01, 0.4); }
  static Rigid3 BlockThere() { return Standing(0.055, -0.015, 1.1); }

  void TakePhotos(bool block) {
    std::mt19937 random(GetParam());
    std::uniform_real_distribution<double> px(-60.0, 60.0);
    for (const double turn : {-0.4, -0.1, 0.15, 0.4}) {
      const Rigid3 view = CameraFromScene(turn);
      std::vector<std::pair<const RenderMesh*, Rigid3>> there{
          {&(*parts_)[kAngle].object.mesh, view * AngleThere()}};
      if (block) there.emplace_back(&(*parts_)[kBlock].object.mesh, view * BlockThere());
      cv::Mat photo = PhotoOf(there, Camera());
      const Eigen::Vector2d at = Project(Camera(), view * BlockThere().t);
      for (int w = 0; w < kWires; ++w) {
        const auto end = [&] {
          return cv::Point(static_cast<int>(at.x() + px(random)),
                           static_cast<int>(at.y() + px(random)));
        };
        cv::line(photo, end(), end(), cv::Scalar(30, 30, 30), 1, cv::LINE_AA);
      }
      images_.push_back(MakeAspectImage(photo));
      views_.push_back(AspectSceneView{Camera(), view, std::log(700.0), 0.35});
    }
  }

  // The scene of the angle with what is added of the candidates.
  LinkedScene With(std::vector<AspectSceneObject> candidates) const {
    const std::vector<AspectViewPrior> priors(images_.size());
    const std::vector<std::vector<AspectHypothesis>> none(images_.size());
    const AspectLinkInput input{images_, priors, none, models_};
    const AspectLinkOptions options;
    const StopRequested never;
    const SceneObjects objects(input, options, never);
    AspectScene scene;
    scene.views = views_;
    scene.objects = {{kAngle, AngleThere()}};
    LinkedScene linked = objects.Result(scene);
    AddFaintObjects(input, options, objects, std::move(candidates), &linked);
    return linked;
  }

  static inline std::vector<PhotoPart>* parts_ = nullptr;
  static inline std::vector<AspectModel> models_;
  std::vector<AspectImage> images_;
  std::vector<std::optional<AspectSceneView>> views_;
};

TEST_P(FaintObjects, APartBehindWiresIsAddedWhereItLies) {
  TakePhotos(true);
  Rigid3 near = BlockThere();
  near.t += Eigen::Vector3d(0.001, -0.001, 0.0005);
  const LinkedScene linked = With({{kBlock, near}});
  ASSERT_EQ(linked.objects.size(), 2u) << "seed " << GetParam();
  const LinkedObject& block = linked.objects[1];
  EXPECT_EQ(block.object, kBlock);
  EXPECT_LT(block.score + kLyingBonus, 0.5) << "seed " << GetParam();
  EXPECT_GE(block.surface, 0.5);
  EXPECT_GE(block.surface_pairs, 6);
  EXPECT_TRUE(block.lies);
  EXPECT_LT((block.scene_from_object.t - BlockThere().t).norm(), 0.0015) << "seed " << GetParam();
}

TEST_P(FaintObjects, WiresAloneAreNoPart) {
  TakePhotos(false);
  const Rigid3 turned = BlockThere() * Turn(Eigen::Vector3d::UnitZ(), 0.7);
  EXPECT_EQ(With({{kBlock, BlockThere()}, {kBlock, turned}}).objects.size(), 1u)
      << "seed " << GetParam();
}

TEST_P(FaintObjects, TwoViewsAddNone) {
  TakePhotos(true);
  views_[1].reset();
  views_[2].reset();
  EXPECT_EQ(With({{kBlock, BlockThere()}}).objects.size(), 1u) << "seed " << GetParam();
}

INSTANTIATE_TEST_SUITE_P(Seeds, FaintObjects, testing::Values(1u, 2u, 3u, 4u, 5u));

}  // namespace
}  // namespace horopter
