#include "server/vision/recognition/aspect_search/pose_rendering.h"

#include <gtest/gtest.h>

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <limits>
#include <random>
#include <vector>

#include "tests/support/solid_meshes.h"

namespace horopter {
namespace {

constexpr double kStalePx = 3.0;

PinholeCamera Camera() {
  return CenteredCamera(640, 480, 700.0);
}

RenderMesh Cylinder() {
  return *MakeRenderMesh(CylinderMesh(0.02, 0.035, 64));
}

Rigid3 Pose() {
  Rigid3 pose;
  pose.R = (Eigen::AngleAxisd(0.4, Eigen::Vector3d::UnitZ()) *
            Eigen::AngleAxisd(-2.2, Eigen::Vector3d::UnitX()))
               .toRotationMatrix();
  pose.t = {0.02, -0.01, 0.28};
  return pose;
}

Rigid3 Moved(double turn_rad, const Eigen::Vector3d& shift) {
  Rigid3 pose = Pose();
  pose.R = Eigen::AngleAxisd(turn_rad, Eigen::Vector3d(1, 2, -1).normalized()) * pose.R;
  pose.t += shift;
  return pose;
}

VisibleEdgeOptions Options() {
  VisibleEdgeOptions options;
  options.render_px = 200.0;
  return options;
}

bool SamePoints(const VisibleEdges& a, const VisibleEdges& b) {
  return std::equal(a.points.begin(),
                    a.points.end(),
                    b.points.begin(),
                    b.points.end(),
                    [](const auto& p, const auto& q) { return p.image == q.image; });
}

// Largest distance from edge points of `a`, but one in fifty, to the nearest of `b`.
double Distance(const VisibleEdges& a, const VisibleEdges& b) {
  std::vector<double> nearest;
  for (const VisibleEdgePoint& p : a.points) {
    double best = std::numeric_limits<double>::infinity();
    for (const VisibleEdgePoint& q : b.points) {
      if (std::abs(p.tangent.dot(q.tangent)) < 0.9f) continue;
      // Across the edge: points of two renderings lie anywhere along it.
      const Eigen::Vector2f off = q.image - p.image;
      if (off.norm() > 3.0f) continue;
      best = std::min<double>(best, std::abs(off.x() * p.tangent.y() - off.y() * p.tangent.x()));
    }
    nearest.push_back(best);
  }
  const auto at = nearest.begin() + static_cast<std::ptrdiff_t>(nearest.size() * 49 / 50);
  std::nth_element(nearest.begin(), at, nearest.end());
  return *at;
}

TEST(PoseRendering, FirstEdgesAreARendering) {
  const RenderMesh mesh = Cylinder();
  PoseRendering rendering(mesh, Options(), kStalePx);
  EXPECT_TRUE(SamePoints(rendering.At(Camera(), Pose()),
                         FindVisibleEdges(mesh, Camera(), Pose(), Options())));
}

TEST(PoseRendering, EdgesFollowAPoseThatShiftsLittle) {
  const RenderMesh mesh = Cylinder();
  const unsigned seed = std::random_device{}();
  SCOPED_TRACE(testing::Message() << "seed " << seed);
  std::mt19937 random(seed);
  std::uniform_real_distribution<double> unit(-1.0, 1.0);
  PoseRendering rendering(mesh, Options(), kStalePx);
  rendering.At(Camera(), Pose());
  int followed = 0;
  for (int i = 0; i < 40; ++i) {
    const Rigid3 pose = Moved(0.02 * unit(random),
                              0.001 * Eigen::Vector3d(unit(random), unit(random), unit(random)));
    PinholeCamera camera = Camera();
    camera.focal_px *= 1.0 + 0.005 * unit(random);
    if (PoseShiftPx(mesh, Camera(), Pose(), camera, pose) > kStalePx) continue;
    ++followed;
    const VisibleEdges& moved = rendering.At(camera, pose);
    const VisibleEdges fresh = FindVisibleEdges(mesh, camera, pose, Options());
    EXPECT_FALSE(SamePoints(moved, fresh));
    EXPECT_LT(Distance(moved, fresh), 0.35);
    // The window goes with the part.
    const auto center = [&](const RenderedView& view) {
      Eigen::Vector2d sum = Eigen::Vector2d::Zero();
      int n = 0;
      for (int y = 0; y < view.height; ++y) {
        for (int x = 0; x < view.width; ++x) {
          if (!view.Covered(x, y)) continue;
          sum += view.origin + Eigen::Vector2d(x, y) / view.scale;
          ++n;
        }
      }
      return Eigen::Vector2d(sum / n);
    };
    EXPECT_LT((center(moved.view) - center(fresh.view)).norm(), 1.0);
  }
  EXPECT_GT(followed, 10);
}

TEST(PoseRendering, RendersAnewWhenThePoseHasLeft) {
  const RenderMesh mesh = Cylinder();
  PoseRendering rendering(mesh, Options(), kStalePx);
  rendering.At(Camera(), Pose());
  const Rigid3 far = Moved(0.2, {0.01, 0, 0});
  ASSERT_GT(PoseShiftPx(mesh, Camera(), Pose(), Camera(), far), kStalePx);
  EXPECT_TRUE(
      SamePoints(rendering.At(Camera(), far), FindVisibleEdges(mesh, Camera(), far, Options())));
  // Small steps add up to a large one.
  PoseRendering creeping(mesh, Options(), kStalePx);
  int rendered = 0;
  for (int i = 0; i < 30; ++i) {
    const Rigid3 pose = Moved(0.0, {0.0005 * i, 0, 0});
    rendered +=
        SamePoints(creeping.At(Camera(), pose), FindVisibleEdges(mesh, Camera(), pose, Options()));
  }
  EXPECT_GE(rendered, 5);
  EXPECT_LE(rendered, 15);
}

TEST(PoseRendering, BehindTheCameraShiftsWithoutEnd) {
  const RenderMesh mesh = Cylinder();
  Rigid3 behind = Pose();
  behind.t.z() = -0.3;
  EXPECT_TRUE(std::isinf(PoseShiftPx(mesh, Camera(), Pose(), Camera(), behind)));
  PoseRendering rendering(mesh, Options(), kStalePx);
  rendering.At(Camera(), Pose());
  EXPECT_TRUE(rendering.At(Camera(), behind).points.empty());
  EXPECT_FALSE(rendering.At(Camera(), Pose()).points.empty());
}

}  // namespace
}  // namespace horopter
