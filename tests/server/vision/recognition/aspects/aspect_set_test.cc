#include "server/vision/recognition/aspects/aspect_set.h"

#include <gtest/gtest.h>

#include <Eigen/Dense>
#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>

#include "tests/support/random.h"
#include "tests/support/solid_meshes.h"

namespace horopter {
namespace {

using Eigen::Vector2d;
using Eigen::Vector3d;

RenderMesh Made(const TriangleMesh& mesh) {
  absl::StatusOr<RenderMesh> made = MakeRenderMesh(mesh);
  EXPECT_TRUE(made.ok()) << made.status();
  return *made;
}

// Where a view's camera is, from the object's centre.
Vector3d DirectionOf(const AspectSet& set, int aspect) {
  return -set.aspects[aspect].camera_from_object.row(2).cast<double>().transpose();
}

std::vector<Rigid3> Turns(int count, const Vector3d& axis) {
  std::vector<Rigid3> out;
  for (int i = 1; i < count; ++i) {
    Rigid3 turn;
    turn.R = Eigen::AngleAxisd(2.0 * M_PI * i / count, axis).toRotationMatrix();
    out.push_back(turn);
  }
  return out;
}

double WorstAngle(const AspectSet& set, const std::vector<Rigid3>& symmetries) {
  Random random(7);
  double worst = 0.0;
  for (int i = 0; i < 500; ++i) {
    const Vector3d d = Vector3d(random.Normal(), random.Normal(), random.Normal()).normalized();
    double best = M_PI;
    for (std::size_t a = 0; a < set.aspects.size(); ++a) {
      const Vector3d view = DirectionOf(set, static_cast<int>(a));
      best = std::min(best, std::acos(std::clamp(view.dot(d), -1.0, 1.0)));
      for (const Rigid3& s : symmetries) {
        best = std::min(best, std::acos(std::clamp(view.dot(s.R * d), -1.0, 1.0)));
      }
    }
    worst = std::max(worst, best);
  }
  return worst;
}

TEST(Aspects, SeeEveryDirectionFromNearby) {
  const RenderMesh mesh = Made(BoxMesh({0.03, 0.022, 0.015}));
  const AspectSet set = MakeAspects(mesh, {}, {.directions = 150});
  EXPECT_EQ(set.aspects.size(), 150u);
  EXPECT_LT(WorstAngle(set, {}), 0.25);
}

TEST(Aspects, OfASymmetricPartCoverOneOfItsEqualParts) {
  const RenderMesh mesh = Made(BoxMesh({0.03, 0.03, 0.01}));
  const std::vector<Rigid3> turns = Turns(4, Vector3d::UnitZ());
  const AspectSet set = MakeAspects(mesh, turns, {.directions = 300});
  EXPECT_NEAR(static_cast<double>(set.aspects.size()), 75.0, 10.0);
  EXPECT_LT(WorstAngle(set, turns), 0.2);

  // A body of revolution: a meridian of views, dense enough.
  const std::vector<Rigid3> round = Turns(36, Vector3d::UnitZ());
  const RenderMesh ring = Made(RingMesh(0.03, 0.015, 0.008, 36));
  const AspectSet views = MakeAspects(ring, round, {.directions = 300});
  EXPECT_GE(views.aspects.size(), 14u);
  EXPECT_LE(views.aspects.size(), 24u);
  EXPECT_LT(WorstAngle(views, round), 0.2);
}

TEST(Aspects, LookAtTheCentre) {
  TriangleMesh shifted;
  Append(BoxMesh({0.03, 0.022, 0.015}), {0.1, -0.2, 0.3}, &shifted);
  const AspectSet set = MakeAspects(Made(shifted), {}, {.directions = 20});
  const PinholeCamera camera = AspectCamera(set);
  for (int a = 0; a < 20; ++a) {
    const Rigid3 pose = AspectPose(set, a);
    EXPECT_NEAR(pose.R.determinant(), 1.0, 1e-5);
    const Vector3d center = pose * set.center.cast<double>();
    EXPECT_NEAR(center.z(), 4.0 * set.diameter_m, 1e-6);
    EXPECT_LT((Project(camera, center) - Vector2d(camera.cx, camera.cy)).norm(), 1e-3);
  }
  EXPECT_NEAR(camera.focal_px * set.diameter_m / set.distance_m, set.render_px, 1e-9);
}

TEST(Aspects, PointsLieOnTheEdgesOfTheirView) {
  const RenderMesh mesh = Made(RingMesh(0.03, 0.015, 0.008, 60));
  const AspectSet set = MakeAspects(mesh, {}, {.directions = 30});
  const PinholeCamera camera = AspectCamera(set);
  for (int a = 0; a < 30; ++a) {
    const VisibleEdges edges = AspectEdges(mesh, set, a);
    const Rigid3 pose = AspectPose(set, a);
    const std::vector<AspectPoint> points = AspectPoints(set, a);
    EXPECT_EQ(points.size(), std::min<std::size_t>(220, edges.points.size()));
    for (const AspectPoint& p : points) {
      const Vector2d at = Project(camera, pose * p.point.cast<double>());
      double nearest = 1e9, cosine = 0.0;
      for (const VisibleEdgePoint& e : edges.points) {
        const double distance = (e.image.cast<double>() - at).norm();
        if (e.kind != p.kind || distance >= nearest) continue;
        nearest = distance;
        cosine = e.direction.dot(p.direction);
      }
      EXPECT_LT(nearest, 0.15);
      EXPECT_GT(cosine, 0.99);
    }
  }
}

TEST(Aspects, FirstPointsAreSpreadFarApart) {
  const RenderMesh mesh = Made(RingMesh(0.03, 0.015, 0.008, 60));
  const AspectSet set = MakeAspects(mesh, {}, {.directions = 10});
  const PinholeCamera camera = AspectCamera(set);
  for (int a = 0; a < 10; ++a) {
    const Rigid3 pose = AspectPose(set, a);
    std::vector<Vector2d> at;
    for (const AspectPoint& p : AspectPoints(set, a)) {
      at.push_back(Project(camera, pose * p.point.cast<double>()));
    }
    ASSERT_GE(at.size(), 64u);
    // Each is about as far from all before it as any point is, so distances never grow.
    double before = 1e9;
    for (int i = 1; i < 64; ++i) {
      double nearest = 1e9;
      for (int j = 0; j < i; ++j) nearest = std::min(nearest, (at[i] - at[j]).norm());
      EXPECT_LT(nearest, before + 0.3);
      before = nearest;
      for (std::size_t k = 64; k < at.size(); ++k) {
        double other = 1e9;
        for (int j = 0; j < i; ++j) other = std::min(other, (at[k] - at[j]).norm());
        EXPECT_LT(other, nearest + 0.3);
      }
    }
  }
}

}  // namespace
}  // namespace horopter
