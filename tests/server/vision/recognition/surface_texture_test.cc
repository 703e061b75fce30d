#include "server/vision/recognition/surface_texture.h"

#include <gtest/gtest.h>

#include <Eigen/Geometry>
#include <cmath>
#include <opencv2/imgproc.hpp>
#include <random>

#include "tests/support/synthetic_part.h"

namespace horopter {
namespace {

constexpr double kSide = 0.09, kHeight = 0.06;

// Smooth random texture over a plane, 0..1.
class Print {
 public:
  explicit Print(unsigned seed) : cells_(128, 128, CV_32F) {
    cv::RNG rng(seed);
    rng.fill(cells_, cv::RNG::UNIFORM, 0.0, 1.0);
    cv::GaussianBlur(cells_, cells_, {}, 1.0);
    cv::normalize(cells_, cells_, 0.0, 1.0, cv::NORM_MINMAX);
  }
  // x, y in metres; a cell is 2 mm.
  double At(double x, double y) const {
    const double u = x / 0.002 + 1000.0, v = y / 0.002 + 1000.0;
    const int i = static_cast<int>(u), k = static_cast<int>(v);
    const double fx = u - i, fy = v - k;
    const auto cell = [&](int a, int b) { return cells_.at<float>(b % 128, a % 128); };
    return (1 - fy) * ((1 - fx) * cell(i, k) + fx * cell(i + 1, k)) +
           fy * ((1 - fx) * cell(i, k + 1) + fx * cell(i + 1, k + 1));
  }

 private:
  cv::Mat cells_;
};

struct Looks {
  bool printed_box = true;
  bool printed_table = false;
  bool box_is_there = true;
  double noise = 2.0;  // grey levels
  unsigned seed = 1;
};

// A box that stands on the table z = 0 of the scene, seen by four cameras that know where they are.
struct Scene {
  std::vector<std::shared_ptr<const PreparedObject>> objects{
      PrepareObject(
          Prism("box", {{0, 0}, {kSide, 0}, {kSide, 0.8 * kSide}, {0, 0.8 * kSide}}, kHeight))
          .value()};
  std::vector<cv::Mat> images;
  JointContext context;
  SceneModel scene;

  explicit Scene(const Looks& looks) {
    for (int v = 0; v < 4; ++v) {
      const double a = 0.35 + 0.2 * v;
      const PinholeCamera camera = CenteredCamera(640, 480, 900 + 20 * v);
      const Rigid3 camera_from_scene =
          LookAt({0.5 * std::sin(a), -0.5 * std::cos(a), 0.4}, {0.04, 0.03, 0.03});
      scene.views.push_back(RecognizedView{camera, camera_from_scene});
      images.push_back(Render(looks, camera, camera_from_scene, looks.seed + v));
    }
    context.objects = objects;
    context.surface_images = MakeSurfaceImages(images, 1);
    scene.plane = ScenePlane{Eigen::Vector3d::UnitZ(), 0.0};
    scene.objects.resize(1);
    scene.objects[0].object = 0;
  }

  // Box faces and table by the nearest hit of each pixel's ray.
  static cv::Mat Render(const Looks& looks,
                        const PinholeCamera& camera,
                        const Rigid3& camera_from_scene,
                        unsigned seed) {
    const Print print(looks.seed), table(looks.seed + 100);
    const Rigid3 scene_from_camera = camera_from_scene.Inverse();
    const Eigen::Vector3d c = scene_from_camera.t, high(kSide, 0.8 * kSide, kHeight);
    cv::Mat image(camera.height, camera.width, CV_32F);
    for (int y = 0; y < camera.height; ++y) {
      for (int x = 0; x < camera.width; ++x) {
        const Eigen::Vector3d ray =
            scene_from_camera.R * NormalizedPoint(camera, {x, y}).homogeneous();
        double near = -c.z() / ray.z();
        const Eigen::Vector3d foot = c + near * ray;
        double value = looks.printed_table ? 60 + 120 * table.At(foot.x(), foot.y()) : 120;
        for (int axis = 0; axis < 3 && looks.box_is_there; ++axis) {
          for (const double side : {0.0, high[axis]}) {
            const double t = (side - c[axis]) / ray[axis];
            const Eigen::Vector3d p = c + t * ray;
            const int i = (axis + 1) % 3, k = (axis + 2) % 3;
            if (!(t > 0) || t >= near || p[i] < 0 || p[k] < 0 || p[i] > high[i] || p[k] > high[k])
              continue;
            near = t;
            value = 80 + 20 * axis + (looks.printed_box ? 100 * print.At(p[i], p[k] + axis) : 0);
          }
        }
        image.at<float>(y, x) = static_cast<float>(value);
      }
    }
    cv::Mat noise(image.size(), CV_32F), grey;
    cv::RNG rng(seed);
    rng.fill(noise, cv::RNG::NORMAL, 0.0, looks.noise);
    cv::Mat(image + noise).convertTo(grey, CV_8U);
    return grey;
  }

  SurfaceTexture At(const Rigid3& pose) {
    scene.objects[0].scene_from_object = pose;
    const int first = 0;
    return CompareSurfaces(context, scene, {&first, 1})[0];
  }
};

Rigid3 Shifted(double x, double y, double z) {
  return {Eigen::Matrix3d::Identity(), {x, y, z}};
}

TEST(SurfaceTexture, OfARightPoseIsAlikeOfAWrongOneUnlike) {
  for (const double noise : {0.0, 2.0, 5.0}) {
    SCOPED_TRACE(noise);
    Looks looks;
    looks.noise = noise;
    Scene scene(looks);
    const SurfaceTexture right = scene.At({});
    EXPECT_GT(right.alike, 40);
    EXPECT_LE(right.unlike, right.alike / 20);
    const SurfaceTexture far = scene.At(Shifted(-0.02, 0.03, 0.02));
    EXPECT_GT(far.unlike, 3 * far.alike);
    const SurfaceTexture high = scene.At(Shifted(0, 0, 0.008));  // its sides stay where they were
    EXPECT_LT(high.alike, 0.8 * right.alike);
    EXPECT_GT(high.unlike, right.unlike + 10);
    // Along its faces a printed box may slide: the planes are where they were.
    EXPECT_GT(scene.At(Shifted(0.004, 0, 0)).alike, 0);
  }
}

TEST(SurfaceTexture, OfAPlainPartSaysNothing) {
  for (const unsigned seed : {1u, 2u, 3u}) {
    Looks looks;
    looks.printed_box = false;
    looks.noise = 5.0;
    looks.seed = seed;
    Scene scene(looks);
    const SurfaceTexture found = scene.At({});
    EXPECT_EQ(found.alike, 0) << "seed " << seed;
    EXPECT_EQ(found.unlike, 0) << "seed " << seed;
  }
}

TEST(SurfaceTexture, OfTheTableDoesNotSpeakForWhatIsNotThere) {
  Looks looks;
  looks.printed_table = true;
  looks.box_is_there = false;
  Scene scene(looks);
  for (const double sunk : {0.0, 0.03, 0.059}) {  // the last: its top hardly above the table
    const SurfaceTexture found = scene.At(Shifted(0, 0, -sunk));
    EXPECT_LE(found.alike, found.unlike) << sunk;
    EXPECT_LT(found.alike, 4) << sunk;
  }
  EXPECT_GT(scene.At({}).unlike, 10);
}

TEST(SurfaceTexture, BehindAnotherObjectDoesNotCount) {
  Scene scene({});
  const int all = scene.At({}).alike;
  PlacedObject front;
  front.object = 0;
  front.scene_from_object = Shifted(0.03, -0.12, 0.05);
  scene.scene.objects.push_back(front);
  const SurfaceTexture hidden = scene.At({});
  EXPECT_LT(hidden.alike, all);
  EXPECT_LE(hidden.unlike, hidden.alike / 10);
}

TEST(SurfaceTexture, NeedsParallaxAndImages) {
  Scene scene({});
  Scene still({});
  for (int v = 0; v < 4; ++v) {
    still.scene.views[v] = still.scene.views[0];
    still.images[v] = still.images[0];
  }
  const SurfaceTexture none = still.At({});
  EXPECT_EQ(none.alike + none.unlike, 0);
  scene.context.surface_images = nullptr;
  const SurfaceTexture blind = scene.At({});
  EXPECT_EQ(blind.alike + blind.unlike, 0);
  scene.scene.views.assign(4, std::nullopt);
  scene.context.surface_images = MakeSurfaceImages(scene.images, 1);
  const SurfaceTexture lost = scene.At({});
  EXPECT_EQ(lost.alike + lost.unlike, 0);
}

TEST(SurfaceTexture, IsTheSameInLargeImages) {
  Scene scene({});
  const SurfaceTexture small = scene.At({});
  for (int v = 0; v < 4; ++v) {
    cv::resize(scene.images[v], scene.images[v], {}, 3.0, 3.0, cv::INTER_CUBIC);
    PinholeCamera& c = scene.scene.views[v]->camera;
    c = {3 * c.width, 3 * c.height, 3 * c.focal_px, 3 * c.cx + 1, 3 * c.cy + 1, c.k1};
  }
  const SurfaceTexture large = scene.At({});
  EXPECT_NEAR(large.alike, small.alike, 0.2 * small.alike);
  EXPECT_LE(large.unlike, large.alike / 20);
}

TEST(TextureEvidence, GrowsWithAgreementAndIsBounded) {
  EXPECT_EQ(TextureEvidence({0, 0}), 0.0);
  EXPECT_GT(TextureEvidence({12, 0}), 1.0);
  EXPECT_GT(TextureEvidence({12, 0}), TextureEvidence({12, 3}));
  EXPECT_LT(TextureEvidence({3, 6}), -1.0);
  EXPECT_EQ(TextureEvidence({1000, 0}), TextureEvidence({2000, 0}));
  EXPECT_EQ(TextureEvidence({0, 1000}), TextureEvidence({0, 2000}));
}

}  // namespace
}  // namespace horopter
