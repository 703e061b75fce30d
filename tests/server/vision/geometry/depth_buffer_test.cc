#include "server/vision/geometry/depth_buffer.h"

#include <gtest/gtest.h>

#include <cmath>
#include <limits>
#include <random>

namespace horopter {
namespace {

TriangleMesh UnitCube() {
  TriangleMesh mesh;
  for (int i = 0; i < 8; ++i) {
    mesh.vertices.emplace_back((i & 1) - 0.5, ((i >> 1) & 1) - 0.5, ((i >> 2) & 1) - 0.5);
  }
  const int quads[6][4] = {
      {0, 2, 3, 1}, {4, 5, 7, 6}, {0, 1, 5, 4}, {2, 6, 7, 3}, {0, 4, 6, 2}, {1, 3, 7, 5}};
  for (const auto& q : quads) {
    mesh.triangles.emplace_back(q[0], q[1], q[2]);
    mesh.triangles.emplace_back(q[0], q[2], q[3]);
  }
  return mesh;
}

Rigid3 RandomPose(std::mt19937* rng, double distance) {
  std::normal_distribution<double> normal;
  const Eigen::Vector4d q =
      Eigen::Vector4d(normal(*rng), normal(*rng), normal(*rng), normal(*rng)).normalized();
  const double w = q[0], x = q[1], y = q[2], z = q[3];
  Rigid3 pose;
  pose.R << 1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y), 2 * (x * y + w * z),
      1 - 2 * (x * x + z * z), 2 * (y * z - w * x), 2 * (x * z - w * y), 2 * (y * z + w * x),
      1 - 2 * (x * x + y * y);
  pose.t = {0.3 * normal(*rng), 0.3 * normal(*rng), distance};
  return pose;
}

// Nearest intersection of a pixel's viewing ray with the cube [-half, half]^3 of the object frame;
// < 0: none.
double CubeDepth(
    const PinholeCamera& camera, const Rigid3& camera_from_object, int x, int y, double half) {
  const Eigen::Vector3d ray(
      (x - camera.cx) / camera.focal_px, (y - camera.cy) / camera.focal_px, 1.0);
  const Rigid3 object_from_camera = camera_from_object.Inverse();
  const Eigen::Vector3d origin = object_from_camera.t;
  const Eigen::Vector3d direction = object_from_camera.R * ray;
  double near = 0.0;
  double far = 1e9;
  for (int k = 0; k < 3; ++k) {
    const double a = (-half - origin[k]) / direction[k];
    const double b = (half - origin[k]) / direction[k];
    near = std::max(near, std::min(a, b));
    far = std::min(far, std::max(a, b));
  }
  return near <= far ? near : -1.0;
}

TEST(RenderDepth, EqualsRayCastingOfACube) {
  const PinholeCamera camera = CenteredCamera(160, 120, 150.0);
  std::mt19937 rng(7);
  for (int trial = 0; trial < 50; ++trial) {
    SCOPED_TRACE(trial);
    const Rigid3 pose = RandomPose(&rng, 3.0);
    DepthBuffer buffer = MakeDepthBuffer(160, 120);
    RenderDepth(UnitCube(), camera, pose, &buffer);
    for (int y = 0; y < 120; y += 3) {
      for (int x = 0; x < 160; x += 3) {
        const double inner = CubeDepth(camera, pose, x, y, 0.4999);
        const double outer = CubeDepth(camera, pose, x, y, 0.5001);
        if (inner > 0.0) {
          EXPECT_NEAR(buffer.At(x, y), CubeDepth(camera, pose, x, y, 0.5), 1e-4);
        } else if (outer < 0.0) {
          EXPECT_EQ(buffer.At(x, y), DepthBuffer::kNoDepth);
        }
      }
    }
  }
}

TEST(RenderDepth, MergingIsTheMinimumInAnyOrder) {
  const PinholeCamera camera = CenteredCamera(160, 120, 150.0);
  std::mt19937 rng(11);
  const Rigid3 first = RandomPose(&rng, 3.0);
  const Rigid3 second = RandomPose(&rng, 3.4);
  DepthBuffer a = MakeDepthBuffer(160, 120), b = a, ab = a, ba = a;
  RenderDepth(UnitCube(), camera, first, &a);
  RenderDepth(UnitCube(), camera, second, &b);
  RenderDepth(UnitCube(), camera, first, &ab);
  RenderDepth(UnitCube(), camera, second, &ab);
  RenderDepth(UnitCube(), camera, second, &ba);
  RenderDepth(UnitCube(), camera, first, &ba);
  for (size_t i = 0; i < a.depth.size(); ++i) {
    ASSERT_EQ(ab.depth[i], std::min(a.depth[i], b.depth[i]));
    ASSERT_EQ(ab.depth[i], ba.depth[i]);
  }
}

TEST(RenderDepth, ClipsAtTheCameraInsteadOfWrappingRound) {
  const PinholeCamera camera = CenteredCamera(64, 48, 50.0);
  TriangleMesh floor;  // a large floor that runs through below the camera and far behind it
  floor.vertices = {{-50, 1, -50}, {50, 1, -50}, {50, 1, 50}, {-50, 1, 50}};
  floor.triangles = {{0, 1, 2}, {0, 2, 3}};
  DepthBuffer buffer = MakeDepthBuffer(64, 48);
  RenderDepth(floor, camera, {}, &buffer);
  for (int x = 0; x < 64; x += 7) {
    EXPECT_EQ(buffer.At(x, 5), DepthBuffer::kNoDepth) << "sky";
    const double expected = camera.focal_px / (45 - camera.cy);  // y = 1 m
    EXPECT_NEAR(buffer.At(x, 45), expected, 1e-3 * expected);
  }
}

TEST(RenderDepth, BadMeshesDrawNothing) {
  const PinholeCamera camera = CenteredCamera(64, 48, 50.0);
  const double nan = std::numeric_limits<double>::quiet_NaN();
  TriangleMesh mesh;
  mesh.vertices = {{nan, 0, 1}, {1, 0, 1}, {0, 1, 1}, {0, 0, -1}, {1e300, 0, 1}};
  mesh.triangles = {{0, 1, 2}, {1, 2, 9}, {-1, 1, 2}, {3, 3, 3}, {1, 1, 2}};
  DepthBuffer buffer = MakeDepthBuffer(64, 48);
  RenderDepth(mesh, camera, {}, &buffer);
  for (float z : buffer.depth) {
    ASSERT_EQ(z, DepthBuffer::kNoDepth);
  }
  mesh.triangles = {{1, 2, 4}};  // finite but absurd
  RenderDepth(mesh, camera, {}, &buffer);
  DepthBuffer empty = MakeDepthBuffer(0, -3);
  RenderDepth(UnitCube(), camera, {}, &empty);
  EXPECT_TRUE(empty.depth.empty());
  EXPECT_FALSE(IsVisible(empty, {0, 0}, 1.0, 0.1));
}

TEST(IsVisible, FrontCornerIsSeenAndBackCornerIsNot) {
  const PinholeCamera camera = CenteredCamera(160, 120, 150.0);
  std::mt19937 rng(5);
  const TriangleMesh cube = UnitCube();
  for (int trial = 0; trial < 50; ++trial) {
    SCOPED_TRACE(trial);
    const Rigid3 pose = RandomPose(&rng, 3.0);
    DepthBuffer buffer = MakeDepthBuffer(160, 120);
    RenderDepth(cube, camera, pose, &buffer);
    // The nearest corner is always visible (when in the image), the one opposite to it never.
    int nearest = 0;
    for (int i = 1; i < 8; ++i) {
      if ((pose * cube.vertices[i]).norm() < (pose * cube.vertices[nearest]).norm()) nearest = i;
    }
    const Eigen::Vector3d front = pose * cube.vertices[nearest];
    const Eigen::Vector3d back = pose * cube.vertices[7 - nearest];
    const Eigen::Vector2d front_px = Project(camera, front);
    if (front_px.x() > 0 && front_px.y() > 0 && front_px.x() < 159 && front_px.y() < 119) {
      EXPECT_TRUE(IsVisible(buffer, front_px, front.z(), 0.01));
    }
    EXPECT_FALSE(IsVisible(buffer, Project(camera, back), back.z(), 0.01));
  }
  DepthBuffer buffer = MakeDepthBuffer(160, 120);
  EXPECT_FALSE(IsVisible(buffer, {-1.0, 5.0}, 1.0, 0.0));
  EXPECT_FALSE(IsVisible(buffer, {std::nan(""), 5.0}, 1.0, 0.0));
}

}  // namespace
}  // namespace horopter
