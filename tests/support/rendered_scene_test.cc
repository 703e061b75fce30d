#include "tests/support/rendered_scene.h"

#include <gtest/gtest.h>

#include <Eigen/Geometry>
#include <algorithm>
#include <array>
#include <cmath>

#include "tests/support/solid_meshes.h"
#include "tests/support/staged_scene.h"

namespace horopter {
namespace {

using Eigen::Vector2d;
using Eigen::Vector3d;

constexpr double kGamma = 2.2;

Rigid3 CameraAt(const Vector3d& from) {
  const Vector3d z = -from.normalized(), x = z.cross(Vector3d::UnitZ()).normalized();
  Rigid3 out;
  out.R << x.transpose(), z.cross(x).transpose(), z.transpose();
  out.t = -(out.R * from);
  return out;
}

// A camera of 320 x 240 pixels that sees 20 cm from 60 cm away.
PinholeCamera SmallCamera(double k1) {
  PinholeCamera camera = CenteredCamera(320, 240, 640.0);
  camera.cx += 2.3;
  camera.cy -= 1.7;
  camera.k1 = k1;
  return camera;
}

CameraLook PlainLook() {
  CameraLook look;
  look.blur_px = 0.0;
  look.noise = 0.0;
  return look;
}

PaintedTable EvenTable(float reflectance) {
  PaintedTable table;
  table.reflectance.create(8, 8);
  table.reflectance.setTo(cv::Scalar::all(reflectance));
  return table;
}

LightSource Above() {
  LightSource light;
  light.position = {0.3, 0.2, 2.0};
  light.radiance.setConstant(0.6f);
  return light;
}

PaintedPart On(const RenderMesh& mesh, double x, double y, double half_height) {
  PaintedPart part;
  part.mesh = &mesh;
  part.world_from_object.t = {x, y, half_height};
  part.color.setConstant(0.9f);
  return part;
}

// Linear light of a pixel between pixels; green.
double LightAt(const cv::Mat& image, const Vector2d& at) {
  const int x = static_cast<int>(std::floor(at.x())), y = static_cast<int>(std::floor(at.y()));
  const double a = at.x() - x, b = at.y() - y;
  const auto light = [&](int dx, int dy) {
    return std::pow(image.at<cv::Vec3b>(y + dy, x + dx)[1] / 255.0, kGamma);
  };
  return (1 - b) * ((1 - a) * light(0, 0) + a * light(1, 0)) +
         b * ((1 - a) * light(0, 1) + a * light(1, 1));
}

// Where light passes half its step along the normal through a point, pixels from the point.
double StepAt(const cv::Mat& image, const Vector2d& at, const Vector2d& normal) {
  constexpr double kReach = 3.0, kStep = 0.05;
  const double low = LightAt(image, at - kReach * normal);
  const double high = LightAt(image, at + kReach * normal);
  const double middle = 0.5 * (low + high);
  for (double s = -kReach; s < kReach; s += kStep) {
    const double here = LightAt(image, at + s * normal) - middle;
    const double next = LightAt(image, at + (s + kStep) * normal) - middle;
    if (here * next <= 0.0) return s + kStep * here / (here - next);
  }
  return kReach;
}

TEST(RenderedScene, SilhouettesLieWhereTheProjectionSays) {
  const Vector3d half(0.04, 0.03, 0.02);
  const RenderMesh mesh = *ExactRenderMesh(BoxMesh(half), 0.0);
  for (const double k1 : {0.0, -0.06}) {
    PaintedScene scene;
    scene.parts.push_back(On(mesh, 0.0, 0.0, half.z()));
    scene.table = EvenTable(0.1f);
    scene.lights.push_back(Above());
    const SceneRenderer renderer(scene);
    const PinholeCamera camera = SmallCamera(k1);
    const Vector3d eye(0.35, -0.35, 0.4);
    const Rigid3 pose = CameraAt(eye);
    const Photograph photograph = renderer.Take(camera, pose, PlainLook());
    // Edges of the top beyond which the table is seen: of the sides that face away.
    const double top = 2.0 * half.z();
    const std::array<std::array<Vector3d, 2>, 2> edges = {
        {{Vector3d(-half.x(), -half.y(), top), Vector3d(-half.x(), half.y(), top)},
         {Vector3d(-half.x(), half.y(), top), Vector3d(half.x(), half.y(), top)}}};
    int measured = 0;
    for (const auto& [a, b] : edges) {
      for (double s = 0.1; s < 0.95; s += 0.05) {
        const auto pixel = [&](double share) {
          return Project(camera, pose * Vector3d(a + share * (b - a)));
        };
        const Vector2d at = pixel(s), along = (pixel(s + 0.01) - pixel(s - 0.01)).normalized();
        EXPECT_NEAR(StepAt(photograph.image, at, {-along.y(), along.x()}), 0.0, 0.2)
            << "k1 " << k1 << " at " << at.transpose();
        ++measured;
      }
    }
    EXPECT_GT(measured, 30);
  }
}

TEST(RenderedScene, TheTableIsThereInAllViews) {
  Random random(7);
  PaintedScene scene;
  scene.table = MakeTable(TableKind::kMottled, 0.2, &random);
  scene.lights.push_back(Above());
  const SceneRenderer renderer(scene);
  const PinholeCamera camera = SmallCamera(-0.05);
  const Rigid3 poses[2] = {CameraAt({0.35, -0.35, 0.4}), CameraAt({0.45, 0.0, 0.42})};
  cv::Mat images[2];
  for (int v = 0; v < 2; ++v) images[v] = renderer.Take(camera, poses[v], PlainLook()).image;
  // The shift of the second image that makes both alike, by one linear step.
  Eigen::Matrix2d A = Eigen::Matrix2d::Zero();
  Vector2d b = Vector2d::Zero();
  double difference = 0.0, spread = 0.0;
  for (int i = 0; i < 4000; ++i) {
    const Vector3d point(random.Uniform(-0.06, 0.06), random.Uniform(-0.06, 0.06), 0.0);
    const Vector2d first = Project(camera, poses[0] * point),
                   second = Project(camera, poses[1] * point);
    const auto light = [&](double dx, double dy) {
      return LightAt(images[1], second + Vector2d(dx, dy));
    };
    const Vector2d slope(0.5 * (light(1, 0) - light(-1, 0)), 0.5 * (light(0, 1) - light(0, -1)));
    const double off = LightAt(images[0], first) - light(0, 0);
    A += slope * slope.transpose();
    b += slope * off;
    difference += std::abs(off);
    spread += slope.norm();
  }
  EXPECT_LT(A.ldlt().solve(b).norm(), 0.1);
  EXPECT_LT(difference, 0.5 * spread);  // less than half a pixel's worth everywhere
}

TEST(RenderedScene, LightIsKeptFromTheTableAndViewsFromWhatIsBehind) {
  const RenderMesh mesh = *ExactRenderMesh(BoxMesh({0.02, 0.02, 0.03}), 0.0);
  PaintedScene scene;
  scene.parts = {On(mesh, 0.0, 0.0, 0.03), On(mesh, -0.05, 0.0, 0.03)};
  scene.table = EvenTable(0.5f);
  scene.lights.push_back(Above());
  scene.lights[0].position = {0.0, -1.2, 1.2};
  const SceneRenderer renderer(scene);
  const PinholeCamera camera = SmallCamera(0.0);
  const Rigid3 pose = CameraAt({0.5, 0.0, 0.35});
  const Photograph photograph = renderer.Take(camera, pose, PlainLook());
  const auto seen = [&](double x, double y) {
    return LightAt(photograph.image, Project(camera, pose * Vector3d(x, y, 0.0)));
  };
  EXPECT_LT(seen(0.0, 0.045), 0.1 * seen(0.0, -0.045));
  EXPECT_GT(photograph.visible_share[0], 0.97);
  EXPECT_LT(photograph.visible_share[1], 0.7);
  EXPECT_GT(photograph.visible_share[1], 0.1);
}

TEST(StagedScene, PartsStandOnTheTableApartAndAlikeForTheSameSeed) {
  std::vector<StageablePart> parts;
  for (int i = 0; i < 4; ++i)
    parts.push_back(*MakeStageable(i, BoxMesh({0.03 + 0.005 * i, 0.02, 0.015}), 0.0));
  for (unsigned seed = 1; seed <= 20; ++seed) {
    Random random(seed), again(seed);
    const std::vector<StagedPart> standing = StandParts(parts, 4, &random);
    const std::vector<StagedPart> same = StandParts(parts, 4, &again);
    ASSERT_EQ(standing.size(), same.size());
    ASSERT_GE(standing.size(), 2u) << "seed " << seed;
    for (std::size_t i = 0; i < standing.size(); ++i) {
      EXPECT_EQ(standing[i].world_from_object.t, same[i].world_from_object.t);
      double lowest = 1.0;
      for (const Eigen::Vector3f& v : parts[standing[i].part].mesh.vertices)
        lowest = std::min(lowest, (standing[i].world_from_object * v.cast<double>()).z());
      EXPECT_NEAR(lowest, 0.0, 1e-5) << "seed " << seed;
      for (std::size_t j = 0; j < i; ++j) {
        EXPECT_NE(standing[i].part, standing[j].part);
        const Vector3d between = standing[i].world_from_object.t - standing[j].world_from_object.t;
        EXPECT_GT(between.head<2>().norm(), 0.04) << "seed " << seed;
      }
    }
  }
}

}  // namespace
}  // namespace horopter
