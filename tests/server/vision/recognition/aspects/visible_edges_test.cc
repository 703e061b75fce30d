#include "server/vision/recognition/aspects/visible_edges.h"

#include <gtest/gtest.h>

#include <Eigen/Dense>
#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <numbers>

#include "tests/support/random.h"
#include "tests/support/solid_meshes.h"

namespace horopter {
namespace {

using Eigen::Vector2d;
using Eigen::Vector2f;
using Eigen::Vector3d;
using Kind = VisibleEdgeKind;

RenderMesh Made(const TriangleMesh& mesh) {
  absl::StatusOr<RenderMesh> made = MakeRenderMesh(mesh);
  EXPECT_TRUE(made.ok()) << made.status();
  return *made;
}

Rigid3 RandomPose(Random* random, double distance) {
  Eigen::Quaterniond q(random->Normal(), random->Normal(), random->Normal(), random->Normal());
  Rigid3 pose;
  pose.R = q.normalized().toRotationMatrix();
  pose.t = {random->Uniform(-0.02, 0.02), random->Uniform(-0.02, 0.02), distance};
  return pose;
}

// Looks down the object's z axis from above, x to the right.
Rigid3 FromAbove(double distance) {
  Rigid3 pose;
  pose.R = Vector3d(1, -1, -1).asDiagonal();
  pose.t = {0, 0, distance};
  return pose;
}

PinholeCamera Camera() {
  PinholeCamera camera = CenteredCamera(640, 480, 800.0);
  camera.cx += 7.3;
  camera.cy -= 4.1;
  return camera;
}

double DistanceToSegment(const Vector2d& p, const Vector2d& a, const Vector2d& b) {
  const double t = std::clamp((p - a).dot(b - a) / (b - a).squaredNorm(), 0.0, 1.0);
  return (p - a - t * (b - a)).norm();
}

// The edges of a box as a camera sees them: a silhouette where one of the two faces is seen, a
// crease where both are.
struct BoxEdge {
  Vector2d a, b;
  Kind kind;
};

std::vector<BoxEdge> EdgesOfBox(const Vector3d& half,
                                const PinholeCamera& camera,
                                const Rigid3& pose) {
  const Vector3d eye = pose.Inverse().t;
  std::vector<BoxEdge> out;
  for (int axis = 0; axis < 3; ++axis) {
    const int u = (axis + 1) % 3, v = (axis + 2) % 3;
    for (const double su : {-1.0, 1.0}) {
      for (const double sv : {-1.0, 1.0}) {
        const bool sees_u = su * eye[u] > half[u], sees_v = sv * eye[v] > half[v];
        if (!sees_u && !sees_v) continue;
        Vector3d p = Vector3d::Zero();
        p[u] = su * half[u];
        p[v] = sv * half[v];
        Vector3d a = p, b = p;
        a[axis] = -half[axis];
        b[axis] = half[axis];
        out.push_back({Project(camera, pose * a),
                       Project(camera, pose * b),
                       sees_u && sees_v ? Kind::kCrease : Kind::kSilhouette});
      }
    }
  }
  return out;
}

TEST(VisibleEdges, OfABoxLieOnItsEdgesAndCoverThem) {
  Random random(1);
  const Vector3d half(0.03, 0.022, 0.015);
  const RenderMesh mesh = Made(BoxMesh(half));
  const PinholeCamera camera = Camera();
  int missing = 0, expected = 0;
  for (int i = 0; i < 40; ++i) {
    const Rigid3 pose = RandomPose(&random, random.Uniform(0.2, 0.6));
    const std::vector<BoxEdge> truth = EdgesOfBox(half, camera, pose);
    const VisibleEdges edges = FindVisibleEdges(mesh, camera, pose);
    for (const VisibleEdgePoint& p : edges.points) {
      double nearest = 1e9;
      for (const BoxEdge& e : truth) {
        if (e.kind != p.kind) continue;
        nearest = std::min(nearest, DistanceToSegment(p.image.cast<double>(), e.a, e.b));
      }
      EXPECT_LT(nearest, 0.1) << "pose " << i;
    }
    for (const BoxEdge& e : truth) {
      const double length = (e.b - e.a).norm();
      for (double at = 4.0; at < length - 4.0; at += 1.0) {
        const Vector2d q = e.a + at / length * (e.b - e.a);
        double nearest = 1e9;
        for (const VisibleEdgePoint& p : edges.points) {
          if (p.kind == e.kind) nearest = std::min(nearest, (p.image.cast<double>() - q).norm());
        }
        ++expected;
        // Faces narrower than the filter of normals hide their creases.
        missing += nearest > 2.0;
      }
    }
  }
  EXPECT_GT(expected, 10000);
  EXPECT_LT(missing, expected / 50);
}

// What every edge point promises.
void ExpectConsistent(const RenderMesh& mesh,
                      const PinholeCamera& camera,
                      const Rigid3& pose,
                      const VisibleEdges& edges) {
  int chain = 0, bent = 0, outward = 0, contours = 0;
  for (std::size_t i = 0; i < edges.points.size(); ++i) {
    const VisibleEdgePoint& p = edges.points[i];
    EXPECT_TRUE(p.chain == chain || (i > 0 && p.chain == chain + 1));
    chain = p.chain;
    if (i > 0 && edges.points[i - 1].chain == chain) {
      EXPECT_LT((edges.points[i - 1].image - p.image).norm() * edges.view.scale, 3.0);
    }
    const Vector3d in_camera = pose * p.point.cast<double>();
    EXPECT_LT((Project(camera, in_camera) - p.image.cast<double>()).norm(), 1e-2);
    EXPECT_NEAR(p.tangent.norm(), 1.0f, 1e-3f);
    EXPECT_NEAR(p.direction.norm(), 1.0f, 1e-3f);
    const Vector3d ahead = in_camera + 1e-5 * (pose.R * p.direction.cast<double>());
    const Vector2d shown = (Project(camera, ahead) - p.image.cast<double>());
    const Vector2d at = Project(camera, in_camera);
    bent += (Project(camera, ahead) - at).normalized().dot(p.tangent.cast<double>()) < 0.95;
    (void)shown;
    if (p.kind == Kind::kCrease) continue;
    ++contours;
    const Vector2d near =
        p.image.cast<double>() + 1.5 / edges.view.scale * Vector2d(-p.tangent.y(), p.tangent.x());
    const Vector2d r = RenderedFromImage(edges.view, camera)(near);
    const int x = static_cast<int>(std::lround(r.x())), y = static_cast<int>(std::lround(r.y()));
    if (x < 0 || y < 0 || x >= edges.view.width || y >= edges.view.height) continue;
    const double depth =
        edges.view.inverse_depth[static_cast<std::size_t>(y) * edges.view.width + x];
    outward += depth <= 0.0 || 1.0 / depth > in_camera.z() + 0.1 * mesh.diameter_m;
  }
  EXPECT_EQ(chain + 1, edges.chains);
  // Corners round tangents off, and thin places leave no room beside them.
  EXPECT_LE(bent, 2 + static_cast<int>(edges.points.size()) / 20);
  EXPECT_LE(outward, 2 + contours / 20);
}

TEST(VisibleEdges, PointsProjectToTheirImagesAndNearSidesAreNear) {
  Random random(2);
  TriangleMesh two = BoxMesh({0.03, 0.03, 0.004});
  Append(CylinderMesh(0.012, 0.02, 48), {0, 0, 0.0239}, &two);
  PinholeCamera camera = Camera();
  for (const double k1 : {0.0, -0.15, 0.1}) {
    camera.k1 = k1;
    for (const TriangleMesh& mesh : {two, RingMesh(0.03, 0.015, 0.008, 60)}) {
      const RenderMesh made = Made(mesh);
      for (int i = 0; i < 5; ++i) {
        const Rigid3 pose = RandomPose(&random, 0.3);
        const VisibleEdges edges = FindVisibleEdges(made, camera, pose);
        EXPECT_GT(edges.points.size(), 200u);
        ExpectConsistent(made, camera, pose, edges);
      }
    }
  }
}

TEST(VisibleEdges, SphereShowsItsOutlineOnly) {
  const double radius = 0.04, z = 0.5;
  const RenderMesh mesh = Made(SphereMesh(radius, 60));
  const PinholeCamera camera = Camera();
  const VisibleEdges edges = FindVisibleEdges(mesh, camera, FromAbove(z), {.render_px = 200});
  const double expected = camera.focal_px * radius / std::sqrt(z * z - radius * radius);
  EXPECT_EQ(edges.chains, 1);
  for (const VisibleEdgePoint& p : edges.points) {
    EXPECT_EQ(p.kind, Kind::kSilhouette);
    const double r = (p.image.cast<double>() - Vector2d(camera.cx, camera.cy)).norm();
    EXPECT_NEAR(r, expected, 0.25);
  }
  EXPECT_GT(static_cast<double>(edges.points.size()),
            0.9 * 2.0 * std::numbers::pi * expected * edges.view.scale);
}

TEST(VisibleEdges, FacetsOfACylinderAreNoCreases) {
  Random random(3);
  const PinholeCamera camera = Camera();
  const auto creases_along = [&](int sides) {
    const RenderMesh mesh = Made(CylinderMesh(0.02, 0.03, sides));
    int count = 0;
    for (int i = 0; i < 20; ++i) {
      const VisibleEdges edges = FindVisibleEdges(mesh, camera, RandomPose(&random, 0.35));
      for (const VisibleEdgePoint& p : edges.points) {
        count += p.kind == Kind::kCrease && std::abs(p.direction.z()) > 0.9f &&
                 std::abs(p.point.z()) < 0.028f;
      }
    }
    return count;
  };
  EXPECT_EQ(creases_along(64), 0);
  EXPECT_EQ(creases_along(24), 0);
  EXPECT_GT(creases_along(6), 500);
}

TEST(VisibleEdges, RimOfAHoleIsSeenAllAround) {
  const double outer = 0.03, inner = 0.012, half = 0.008;
  const RenderMesh mesh = Made(RingMesh(outer, inner, half, 128));
  const PinholeCamera camera = Camera();
  Rigid3 pose = FromAbove(0.3);
  pose.R = Eigen::AngleAxisd(0.6, Vector3d::UnitX()).toRotationMatrix() * pose.R;
  const VisibleEdges edges = FindVisibleEdges(mesh, camera, pose);
  int seen = 0;
  constexpr int kAround = 72;
  for (int i = 0; i < kAround; ++i) {
    const double a = 2.0 * std::numbers::pi * i / kAround;
    const Vector2d rim =
        Project(camera, pose * Vector3d(inner * std::cos(a), inner * std::sin(a), half));
    double nearest = 1e9;
    for (const VisibleEdgePoint& p : edges.points) {
      // The nearest point of the edge's tangent, not of the edge.
      const Vector2d off = rim - p.image.cast<double>();
      if (off.norm() < 2.0) {
        nearest = std::min(nearest, std::abs(off.x() * p.tangent.y() - off.y() * p.tangent.x()));
      }
    }
    seen += nearest < 0.5;
  }
  EXPECT_GE(seen, kAround - 2);
}

// Points of creases near the middle of a bar's rounded edge.
std::vector<VisibleEdgePoint> FilletCreases(double radius, double render_px) {
  const double side = 0.02, half = 0.03;
  const RenderMesh mesh = Made(FilletedBarMesh(side, radius, half));
  Rigid3 pose;
  // The rounded edge in front, its z axis to the right.
  pose.R.row(0) = Vector3d::UnitZ();
  pose.R.row(2) = Vector3d(-1, -1, 0).normalized();
  pose.R.row(1) = pose.R.row(2).cross(pose.R.row(0));
  pose.t = {0, 0, 0.3};
  const PinholeCamera camera = Camera();
  const VisibleEdges edges =
      FindVisibleEdges(mesh, camera, pose, {.render_px = render_px, .max_scale = 100.0});
  std::vector<VisibleEdgePoint> out;
  for (const VisibleEdgePoint& p : edges.points) {
    if (p.kind == Kind::kCrease && std::abs(p.point.z()) < 0.8 * half) out.push_back(p);
  }
  return out;
}

TEST(VisibleEdges, FilletIsOneEdgeInItsMiddleFromAfarAndNoneFromNear) {
  // Diameter 83 mm: a fillet of 1 mm is 2 rendered pixels at 180 px.
  const std::vector<VisibleEdgePoint> far = FilletCreases(0.001, 180);
  ASSERT_GT(far.size(), 60u);
  for (const VisibleEdgePoint& p : far) {
    EXPECT_EQ(p.chain, far.front().chain);
    EXPECT_NEAR(p.image.y(), Camera().cy, 0.5);
    EXPECT_NEAR(std::abs(p.direction.z()), 1.0, 0.02);
  }
  EXPECT_TRUE(FilletCreases(0.008, 180).empty());
  EXPECT_FALSE(FilletCreases(0.008, 40).empty());
}

TEST(VisibleEdges, InsideOutOrOpenMeshesShowTheSameOutline) {
  Random random(4);
  const Vector3d half(0.03, 0.022, 0.015);
  TriangleMesh mixed = BoxMesh(half);
  for (std::size_t t = 0; t < mixed.triangles.size(); t += 3) {
    std::swap(mixed.triangles[t][0], mixed.triangles[t][1]);
  }
  TriangleMesh inverted = BoxMesh(half);
  TurnInsideOut(&inverted);
  TriangleMesh soup;  // without the lower cap, which is not seen
  for (const Eigen::Vector3i& t : BoxMesh(half).triangles) {
    const TriangleMesh box = BoxMesh(half);
    if (box.vertices[t[0]].z() + box.vertices[t[1]].z() + box.vertices[t[2]].z() <
        -2.9 * half.z()) {
      continue;
    }
    const int first = static_cast<int>(soup.vertices.size());
    for (const int v : t) soup.vertices.push_back(box.vertices[v]);
    soup.triangles.emplace_back(first, first + 2, first + 1);
  }
  const RenderMesh plain = Made(BoxMesh(half));
  const PinholeCamera camera = Camera();
  for (int i = 0; i < 10; ++i) {
    Rigid3 pose = FromAbove(0.3);
    pose.R = pose.R * Eigen::AngleAxisd(random.Uniform(-1, 1), Vector3d::UnitX()).matrix() *
             Eigen::AngleAxisd(random.Uniform(-1, 1), Vector3d::UnitY()).matrix();
    const std::vector<BoxEdge> truth = EdgesOfBox(half, camera, pose);
    const std::size_t wanted = FindVisibleEdges(plain, camera, pose).points.size();
    for (const TriangleMesh& mesh : {mixed, inverted, soup}) {
      const VisibleEdges edges = FindVisibleEdges(Made(mesh), camera, pose);
      EXPECT_NEAR(static_cast<double>(edges.points.size()),
                  static_cast<double>(wanted),
                  0.05 * static_cast<double>(wanted));
      for (const VisibleEdgePoint& p : edges.points) {
        double nearest = 1e9;
        for (const BoxEdge& e : truth) {
          nearest = std::min(nearest, DistanceToSegment(p.image.cast<double>(), e.a, e.b));
        }
        EXPECT_LT(nearest, 0.5);
      }
    }
  }
}

TEST(VisibleEdges, AThingBeforeAnotherOccludesIt) {
  TriangleMesh two = BoxMesh({0.04, 0.04, 0.005});
  Append(BoxMesh({0.01, 0.01, 0.005}), {0, 0, 0.04}, &two);
  const RenderMesh mesh = Made(two);
  const VisibleEdges edges = FindVisibleEdges(mesh, Camera(), FromAbove(0.4));
  int occlusions = 0;
  for (const VisibleEdgePoint& p : edges.points) {
    if (p.kind != Kind::kOcclusion) continue;
    ++occlusions;
    EXPECT_NEAR(p.point.cwiseAbs().head<2>().maxCoeff(), 0.01f, 1e-4f);
    EXPECT_NEAR(p.point.z(), 0.045f, 1e-4f);
  }
  const double side = edges.view.scale * 800.0 * 0.02 / 0.355;
  EXPECT_GT(occlusions, 0.9 * 4.0 * side);
}

TEST(VisibleEdges, SameInputSamePoints) {
  Random random(5);
  const RenderMesh mesh = Made(RingMesh(0.03, 0.015, 0.008, 60));
  const Rigid3 pose = RandomPose(&random, 0.3);
  const VisibleEdges a = FindVisibleEdges(mesh, Camera(), pose);
  const VisibleEdges b = FindVisibleEdges(mesh, Camera(), pose);
  ASSERT_EQ(a.points.size(), b.points.size());
  for (std::size_t i = 0; i < a.points.size(); ++i) {
    EXPECT_EQ(a.points[i].point, b.points[i].point);
    EXPECT_EQ(a.points[i].image, b.points[i].image);
    EXPECT_EQ(a.points[i].chain, b.points[i].chain);
  }
  EXPECT_EQ(a.view.inverse_depth, b.view.inverse_depth);
}

TEST(VisibleEdges, StayInsideTheImageWhateverThePose) {
  Random random(6);
  const RenderMesh mesh = Made(RingMesh(0.03, 0.015, 0.008, 60));
  const PinholeCamera camera = Camera();
  int seen = 0;
  for (int i = 0; i < 60; ++i) {
    Rigid3 pose = RandomPose(&random, 0.0);
    pose.t = {random.Uniform(-0.2, 0.2), random.Uniform(-0.2, 0.2), random.Uniform(-0.05, 0.4)};
    const VisibleEdges edges = FindVisibleEdges(mesh, camera, pose);
    seen += !edges.points.empty();
    for (const VisibleEdgePoint& p : edges.points) {
      EXPECT_TRUE(p.point.allFinite() && p.direction.allFinite() && p.tangent.allFinite());
      EXPECT_TRUE(p.image.x() >= -0.5f && p.image.x() <= 639.5f);
      EXPECT_TRUE(p.image.y() >= -0.5f && p.image.y() <= 479.5f);
    }
    EXPECT_TRUE(pose.t.z() > 0.0 || edges.points.empty());
  }
  EXPECT_GT(seen, 15);
  Rigid3 away = FromAbove(0.3);
  away.t.x() = 1.0;
  EXPECT_EQ(FindVisibleEdges(mesh, camera, away).view.width, 0);
}

TEST(RenderedFromImage, UndoesTheLensAsTheCameraDoes) {
  RenderedView view;
  view.scale = 0.7;
  view.origin = {20.0, -5.0};
  for (const double k1 : {-0.3, -0.05, 0.0, 0.1, 0.3}) {
    PinholeCamera camera = Camera();
    camera.k1 = k1;
    const RenderedFromImage rendered_from_image(view, camera);
    for (double x = 0.0; x < camera.width; x += 37.0) {
      for (double y = 0.0; y < camera.height; y += 37.0) {
        const Vector2d n = NormalizedPoint(camera, {x, y});
        const Vector2d straight(camera.focal_px * n.x() + camera.cx,
                                camera.focal_px * n.y() + camera.cy);
        EXPECT_LT((rendered_from_image({x, y}) - (straight - view.origin) * view.scale).norm(),
                  1e-3)
            << k1 << " at " << x << ", " << y;
      }
    }
  }
}

TEST(VisibleEdges, RenderedDepthIsTheSurfaces) {
  const double radius = 0.04, z = 0.5;
  const RenderMesh mesh = Made(SphereMesh(radius, 60));
  const PinholeCamera camera = Camera();
  const RenderedView view = RenderView(mesh, camera, FromAbove(z));
  const Vector2d r = RenderedFromImage(view, camera)({camera.cx, camera.cy});
  const int x = static_cast<int>(std::lround(r.x())), y = static_cast<int>(std::lround(r.y()));
  ASSERT_TRUE(view.Covered(x, y));
  EXPECT_NEAR(
      1.0 / view.inverse_depth[static_cast<std::size_t>(y) * view.width + x], z - radius, 2e-4);
  // The diameter is the box's diagonal: 180 / sqrt(3) and the margins.
  EXPECT_NEAR(view.width, 180 / std::sqrt(3.0) + 9, 4);
  EXPECT_FALSE(view.Covered(0, 0));
}

}  // namespace
}  // namespace horopter
