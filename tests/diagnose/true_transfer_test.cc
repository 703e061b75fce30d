#include "tests/diagnose/true_transfer.h"

#include <gtest/gtest.h>

#include <Eigen/Geometry>

namespace horopter {
namespace {

using Eigen::Vector2d;
using Eigen::Vector3d;

// A square plate, 20 cm wide, 60 cm before two cameras 10 cm apart.
struct Plate {
  TrueModels models;
  TrueWorld world;

  explicit Plate(bool posed = true) {
    TriangleMesh& mesh = models[1].mesh;
    mesh.vertices = {{-0.1, -0.1, 0}, {0.1, -0.1, 0}, {0.1, 0.1, 0}, {-0.1, 0.1, 0}};
    mesh.triangles = {{0, 1, 2}, {0, 2, 3}};
    for (int v = 0; v < 2; ++v) {
      BopImage image;
      image.camera = CenteredCamera(640, 480, 800.0);
      image.camera.k1 = -0.1;
      image.has_pose = posed;
      image.camera_from_world.t = {0.05 - 0.1 * v, 0.0, 0.6};
      image.instances.push_back({1, image.camera_from_world, 1.0});
      if (!posed) image.camera_from_world = {};
      world.scene.images.push_back(image);
    }
  }

  Vector2d Seen(int v, const Vector3d& point) const {
    const BopImage& image = world.scene.images[v];
    return ProjectTrue(image, image.instances[0].camera_from_object * point);
  }
};

TEST(TrueTransfer, OnAPartThePointItselfCounts) {
  const Plate plate;
  const TrueTransfer transfer(plate.world, plate.models);
  const Vector2d a = plate.Seen(0, {0.02, 0.03, 0}), b = plate.Seen(1, {0.02, 0.03, 0});
  EXPECT_EQ(transfer.Judge(0, a, 1, b), MatchTruth::kRight);
  EXPECT_EQ(transfer.Judge(1, b, 0, a), MatchTruth::kRight);
  // Along the epipolar line, but elsewhere on the plate.
  EXPECT_EQ(transfer.Judge(0, a, 1, b + Vector2d(10, 0)), MatchTruth::kWrong);
  EXPECT_EQ(transfer.Judge(0, a, 1, b + Vector2d(0, 5)), MatchTruth::kWrong);
}

TEST(TrueTransfer, BesidePartsTheEpipolarGeometryDecides) {
  const Plate plate;
  const TrueTransfer transfer(plate.world, plate.models);
  const Vector3d behind(-0.2, 0.02, 0.4);
  const Vector2d a = plate.Seen(0, behind), b = plate.Seen(1, behind);
  EXPECT_EQ(transfer.Judge(0, a, 1, b), MatchTruth::kRight);
  EXPECT_EQ(transfer.Judge(0, a, 1, b + Vector2d(0, 5)), MatchTruth::kWrong);
}

TEST(TrueTransfer, ATruthThatIsOffByPixelsForgivesThem) {
  Plate plate;
  plate.world.rms_px = 4.0;
  const TrueTransfer transfer(plate.world, plate.models);
  const Vector2d a = plate.Seen(0, {0.02, 0.03, 0}), b = plate.Seen(1, {0.02, 0.03, 0});
  EXPECT_EQ(transfer.Judge(0, a, 1, b + Vector2d(0, 5)), MatchTruth::kRight);
}

TEST(TrueTransfer, WithoutAWorldPartsAloneSpeak) {
  Plate plate(false);
  const Vector2d a = plate.Seen(0, {0.02, 0.03, 0}), b = plate.Seen(1, {0.02, 0.03, 0});
  {
    const TrueTransfer transfer(plate.world, plate.models);
    EXPECT_EQ(transfer.Judge(0, a, 1, b), MatchTruth::kRight);
    EXPECT_EQ(transfer.Judge(0, a, 1, b + Vector2d(10, 0)), MatchTruth::kWrong);
    EXPECT_EQ(transfer.Judge(0, {20, 20}, 1, {30, 30}), MatchTruth::kUnknown);
  }
  plate.models[1].symmetries.push_back(Rigid3());
  const TrueTransfer transfer(plate.world, plate.models);
  EXPECT_EQ(transfer.Judge(0, a, 1, b), MatchTruth::kUnknown);
}

}  // namespace
}  // namespace horopter
