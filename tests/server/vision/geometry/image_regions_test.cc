// Boxes of images, and what of an image a box in space fills.
#include "server/vision/geometry/image_regions.h"

#include <gtest/gtest.h>

#include <Eigen/Geometry>
#include <random>
#include <vector>

namespace horopter {
namespace {

constexpr unsigned kSeed = 104;

struct Drawn {
  SpaceBox box;
  CalibratedCamera view;
};

// A camera somewhere about the origin that looks at it, and a box that lies near it.
Drawn Draw(std::mt19937* random, double k1) {
  std::normal_distribution<double> normal;
  const auto direction = [&] {
    return Eigen::Vector3d(normal(*random), normal(*random), normal(*random)).normalized();
  };
  Drawn out;
  out.view.camera = CenteredCamera(1280, 960, 1100.0);
  out.view.camera.k1 = k1;
  Eigen::Matrix3d R =
      Eigen::Quaterniond::FromTwoVectors(direction(), Eigen::Vector3d::UnitZ()).toRotationMatrix();
  out.view.camera_from_scene = {R, Eigen::Vector3d(0.0, 0.0, 0.8)};
  out.box.base_from_box = {Eigen::AngleAxisd(normal(*random), direction()).toRotationMatrix(),
                           0.2 * direction()};
  out.box.size_m = {0.1, 0.2, 0.05};
  return out;
}

TEST(BoxInImage, HoldsAllThatLiesInTheBox) {
  std::mt19937 random(kSeed);
  std::uniform_real_distribution<double> share(-0.5, 0.5);
  int seen = 0;
  for (int i = 0; i < 200; ++i) {
    const Drawn drawn = Draw(&random, i % 2 == 0 ? 0.0 : -0.15);
    const auto found = BoxInImage(drawn.box, drawn.view, {});
    const ImageBox whole = WholeImage(1280, 960);
    ImageBox tight;
    for (int k = 0; k < 400; ++k) {
      const Eigen::Vector3d in_box = Eigen::Vector3d(share(random), share(random), share(random))
                                         .cwiseProduct(drawn.box.size_m);
      const Eigen::Vector2d at = Project(
          drawn.view.camera, drawn.view.camera_from_scene * (drawn.box.base_from_box * in_box));
      if (!whole.contains(at)) continue;
      ASSERT_TRUE(found.has_value());
      EXPECT_TRUE(found->contains(at)) << at.transpose();
      tight.extend(at);
      ++seen;
    }
    if (!found) continue;
    EXPECT_TRUE(whole.contains(*found));
    if (!tight.isEmpty() && whole.contains(found->min() - Eigen::Vector2d::Ones()) &&
        whole.contains(found->max() + Eigen::Vector2d::Ones())) {
      EXPECT_LT((found->sizes() - tight.sizes()).maxCoeff(), 0.5 * found->sizes().maxCoeff());
    }
  }
  EXPECT_GT(seen, 20'000);
}

TEST(BoxInImage, OfABoxBehindOrBesideTheCameraThereIsNothing) {
  std::mt19937 random(kSeed);
  Drawn drawn = Draw(&random, 0.0);
  drawn.view.camera_from_scene = {};
  drawn.box.base_from_box.t = {0.0, 0.0, -1.0};
  EXPECT_FALSE(BoxInImage(drawn.box, drawn.view, {}));
  drawn.box.base_from_box.t = {5.0, 0.0, 1.0};
  EXPECT_FALSE(BoxInImage(drawn.box, drawn.view, {}));
}

TEST(BoxInImage, AroundTheCameraIsAllOfTheImage) {
  Drawn drawn;
  drawn.view.camera = CenteredCamera(640, 480, 500.0);
  drawn.box.size_m = {2.0, 2.0, 2.0};
  const auto found = BoxInImage(drawn.box, drawn.view, {});
  ASSERT_TRUE(found);
  EXPECT_TRUE(found->isApprox(WholeImage(640, 480)));
}

TEST(BoxInImage, GrowsByWhatIsNotKnownOfTheCamera) {
  Drawn drawn;
  drawn.view.camera = CenteredCamera(1280, 960, 1000.0);
  drawn.box.base_from_box.t = {0.0, 0.0, 1.0};
  drawn.box.size_m = {0.1, 0.1, 0.002};
  const auto exact = BoxInImage(drawn.box, drawn.view, {});
  ASSERT_TRUE(exact);
  EXPECT_NEAR(exact->sizes().x(), 100.0, 1.0);
  for (const CameraDeviation& deviation :
       {CameraDeviation{.turn_rad = 0.01}, CameraDeviation{.shift_m = 0.01}}) {
    const auto grown = BoxInImage(drawn.box, drawn.view, deviation);
    ASSERT_TRUE(grown);
    // Two deviations of ten pixels on both sides, and what the tilt to the corners adds.
    EXPECT_NEAR(grown->sizes().x() - exact->sizes().x(), 40.0, 6.0);
    EXPECT_LT((grown->center() - exact->center()).norm(), 1e-6);
  }
  const auto zoomed = BoxInImage(drawn.box, drawn.view, {.log_focal = 0.1});
  ASSERT_TRUE(zoomed);
  EXPECT_GT(zoomed->sizes().x(), 1.15 * exact->sizes().x());
}

TEST(ShareInBoxes, IsThatOfTheArea) {
  const ImageBox box(Eigen::Vector2d(10, 10), Eigen::Vector2d(20, 30));
  const ImageBox left(Eigen::Vector2d(0, 0), Eigen::Vector2d(15, 100));
  const ImageBox corner(Eigen::Vector2d(15, 10), Eigen::Vector2d(20, 15));
  EXPECT_DOUBLE_EQ(ShareInBoxes(box, {}), 0.0);
  EXPECT_DOUBLE_EQ(ShareInBoxes(box, std::vector{left}), 0.5);
  EXPECT_DOUBLE_EQ(ShareInBoxes(box, std::vector{left, corner}), 0.625);
  EXPECT_DOUBLE_EQ(ShareInBoxes(box, std::vector{box, left}), 1.0);
  EXPECT_DOUBLE_EQ(ShareInBoxes(ImageBox(), std::vector{left}), 0.0);
  EXPECT_TRUE(InBoxes({15, 15}, std::vector{corner}));
  EXPECT_FALSE(InBoxes({14.9, 15}, std::vector{corner}));
}

}  // namespace
}  // namespace horopter
