#include "server/vision/recognition/aspect_scenes/agreeing_poses.h"

#include <gtest/gtest.h>

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <numbers>
#include <random>

#include "server/vision/recognition/aspects/render_mesh.h"
#include "tests/support/solid_meshes.h"

namespace horopter {
namespace {

constexpr int kWidth = 320, kHeight = 240;
constexpr double kSideM = 0.06, kHeightM = 0.004;

// Of a place of the plane z = 0.
double Brightness(const Eigen::Vector3d& x) {
  return 128 + 50 * std::sin(900 * x.x() + 3 * std::sin(310 * x.y())) +
         50 * std::cos(740 * x.y() + 2 * std::sin(450 * x.x()));
}

// A square plate sunk into the plane z = 0, which it continues: after a quarter turn it looks the
// same but for what is painted on both.
RenderMesh Plate() {
  TriangleMesh mesh = BoxMesh({kSideM / 2, kSideM / 2, kHeightM / 2});
  for (Eigen::Vector3d& x : mesh.vertices) x.z() -= kHeightM / 2;
  return *MakeRenderMesh(mesh, kSideM * std::numbers::sqrt2);
}

const std::vector<RestingFace> kResting = {{Eigen::Vector3d::UnitZ(), 0.0}};

PinholeCamera Camera() {
  return CenteredCamera(kWidth, kHeight, 400.0);
}

Rigid3 CameraFromPlate(double turn_rad) {
  return {(Eigen::AngleAxisd(std::numbers::pi - 0.5, Eigen::Vector3d::UnitX()) *
           Eigen::AngleAxisd(turn_rad, Eigen::Vector3d::UnitZ()))
              .toRotationMatrix(),
          Eigen::Vector3d(0, 0, 0.35)};
}

Rigid3 QuarterTurns(int count) {
  return {
      Eigen::AngleAxisd(count * std::numbers::pi / 2, Eigen::Vector3d::UnitZ()).toRotationMatrix(),
      Eigen::Vector3d::Zero()};
}

AspectImage ImageFrom(const Rigid3& camera_from_plate, double noise, std::mt19937* random) {
  std::normal_distribution<double> error(0.0, 1.0);
  AspectImage image;
  image.width = image.image_width = kWidth;
  image.height = image.image_height = kHeight;
  const Rigid3 back = camera_from_plate.Inverse();
  for (int y = 0; y < kHeight; ++y) {
    for (int x = 0; x < kWidth; ++x) {
      const Eigen::Vector3d ray =
          back.R * NormalizedPoint(Camera(), Eigen::Vector2d(x, y)).homogeneous();
      const double depth = -back.t.z() / ray.z();
      const double grey =
          (depth > 0 ? Brightness(back.t + depth * ray) : 0.0) + noise * error(*random);
      image.grey.push_back(static_cast<std::uint8_t>(std::clamp(grey, 0.0, 255.0)));
    }
  }
  image.detail = image.grey;
  return image;
}

struct Scene {
  std::vector<AspectImage> images;
  std::vector<PinholeCamera> cameras;
  std::vector<std::vector<AllowedPose>> allowed;
  std::vector<int> right;  // in each list, by the same turn as in the first view
};

// Four views of the plate. In each the four quarter turns are allowed, in an order of its own.
Scene MakeScene(unsigned seed, double noise) {
  Scene out;
  std::mt19937 random(seed);
  std::uniform_int_distribution<int> quarter(0, 3);
  int first = 0;
  for (int v = 0; v < 4; ++v) {
    const Rigid3 pose = CameraFromPlate(0.35 * v);
    out.images.push_back(ImageFrom(pose, noise, &random));
    out.cameras.push_back(Camera());
    const int stated = quarter(random);
    if (v == 0) first = stated;
    auto& list = out.allowed.emplace_back();
    for (int k = 0; k < 4; ++k) list.push_back({pose * QuarterTurns(stated + k), 0.7});
    out.right.push_back((first - stated + 4) % 4);
  }
  return out;
}

AgreeingPoses Find(const Scene& scene, const AgreeingPosesOptions& options = {}) {
  return FindAgreeingPoses(scene.images, scene.cameras, Plate(), kResting, scene.allowed, options);
}

// The choice turns all views alike.
void ExpectRight(const Scene& scene, const ChosenPoses& chosen, unsigned seed) {
  ASSERT_EQ(chosen.poses.size(), scene.right.size());
  const int turn = chosen.poses[0];
  for (std::size_t v = 0; v < scene.right.size(); ++v)
    EXPECT_EQ(chosen.poses[v], (scene.right[v] + turn) % 4) << "view " << v << " seed " << seed;
}

class QuarterTurned : public testing::TestWithParam<std::tuple<unsigned, double>> {};

TEST_P(QuarterTurned, ViewsAreTurnedUntilSurfaceAndGroundAgree) {
  const auto [seed, noise] = GetParam();
  const Scene scene = MakeScene(seed, noise);
  const AgreeingPoses found = Find(scene);
  ExpectRight(scene, found.best, seed);
  EXPECT_GT(found.best.surface, 0.85);
  EXPECT_GT(found.best.ground, 0.75);
  EXPECT_NEAR(found.best.score, 0.7, 1e-9);
  EXPECT_GE(found.best.Agreement(), found.first.Agreement());
}

TEST_P(QuarterTurned, TheGroundAloneTellsWhereTheSurfaceDoesNot) {
  const auto [seed, noise] = GetParam();
  const Scene scene = MakeScene(seed, noise);
  AgreeingPosesOptions options;
  options.surface_tells = false;
  ExpectRight(scene, Find(scene, options).best, seed);
}

INSTANTIATE_TEST_SUITE_P(SeedsAndNoise,
                         QuarterTurned,
                         testing::Combine(testing::Values(1u, 2u, 3u, 4u),
                                          testing::Values(0.0, 6.0, 12.0)));

TEST(AgreeingPoses, AWorseScoreCountsLessThanAgreement) {
  Scene scene = MakeScene(5, 2.0);
  for (std::size_t v = 0; v < scene.right.size(); ++v) scene.allowed[v][scene.right[v]].score = 0.6;
  ExpectRight(scene, Find(scene).best, 5);
}

TEST(AgreeingPoses, PlainImagesLeaveTheStatedPoses) {
  Scene scene = MakeScene(6, 0.0);
  for (AspectImage& image : scene.images) {
    image.grey.assign(image.grey.size(), 100);
    image.detail = image.grey;
  }
  const AgreeingPoses found = Find(scene);
  EXPECT_EQ(found.best.poses, (std::vector<int>{0, 0, 0, 0}));
  EXPECT_NEAR(found.best.Agreement(), 0.0, 1e-9);
}

TEST(AgreeingPoses, AViewWithoutPosesHasNone) {
  Scene scene = MakeScene(7, 0.0);
  scene.allowed[1].clear();
  const AgreeingPoses found = Find(scene);
  EXPECT_EQ(found.best.poses[1], -1);
  EXPECT_EQ(found.first.poses[1], -1);
  for (const std::size_t v : {0u, 2u, 3u}) EXPECT_GE(found.best.poses[v], 0);
  EXPECT_GT(found.best.surface, 0.85);
}

TEST(AgreeingPoses, NoViewsNothing) {
  Scene scene = MakeScene(8, 0.0);
  for (auto& list : scene.allowed) list.clear();
  const AgreeingPoses found = Find(scene);
  EXPECT_EQ(found.best.poses, (std::vector<int>{-1, -1, -1, -1}));
  EXPECT_EQ(found.best.Agreement(), 0.0);
}

}  // namespace
}  // namespace horopter
