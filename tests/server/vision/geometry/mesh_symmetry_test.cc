#include "server/vision/geometry/mesh_symmetry.h"

#include <gtest/gtest.h>

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <random>
#include <set>
#include <utility>

#include "server/vision/geometry/surface_distance.h"
#include "tests/support/solid_meshes.h"

namespace horopter {
namespace {

using Eigen::Vector3d;

double Diameter(const TriangleMesh& mesh) {
  double squared = 0.0;
  for (const Vector3d& a : mesh.vertices) {
    for (const Vector3d& b : mesh.vertices) squared = std::max(squared, (a - b).squaredNorm());
  }
  return std::sqrt(squared);
}

MeshSymmetries Found(const TriangleMesh& mesh) {
  return FindMeshSymmetries(mesh, Diameter(mesh));
}

// A square plate of n x n cells about the origin; cells named by their column and row are holes.
TriangleMesh PlateWithHoles(int n, double cell, double half, std::set<std::pair<int, int>> holes) {
  TriangleMesh mesh;
  const auto full = [&](int x, int y) {
    return x >= 0 && y >= 0 && x < n && y < n && holes.count({x, y}) == 0;
  };
  const auto quad =
      [&](const Vector3d& a, const Vector3d& b, const Vector3d& c, const Vector3d& d) {
        const int first = static_cast<int>(mesh.vertices.size());
        for (const Vector3d& p : {a, b, c, d}) mesh.vertices.push_back(p);
        mesh.triangles.emplace_back(first, first + 1, first + 2);
        mesh.triangles.emplace_back(first, first + 2, first + 3);
      };
  for (int x = 0; x < n; ++x) {
    for (int y = 0; y < n; ++y) {
      if (!full(x, y)) continue;
      const double u = (x - 0.5 * n) * cell, v = (y - 0.5 * n) * cell, s = cell, h = half;
      quad({u, v, h}, {u + s, v, h}, {u + s, v + s, h}, {u, v + s, h});
      quad({u, v, -h}, {u, v + s, -h}, {u + s, v + s, -h}, {u + s, v, -h});
      if (!full(x - 1, y)) quad({u, v, -h}, {u, v, h}, {u, v + s, h}, {u, v + s, -h});
      if (!full(x + 1, y)) {
        quad({u + s, v, -h}, {u + s, v + s, -h}, {u + s, v + s, h}, {u + s, v, h});
      }
      if (!full(x, y - 1)) quad({u, v, -h}, {u + s, v, -h}, {u + s, v, h}, {u, v, h});
      if (!full(x, y + 1)) {
        quad({u, v + s, -h}, {u, v + s, h}, {u + s, v + s, h}, {u + s, v + s, -h});
      }
    }
  }
  return mesh;
}

std::vector<Eigen::Vector2d> Star(int teeth, double outer, double inner) {
  std::vector<Eigen::Vector2d> out;
  for (int i = 0; i < 4 * teeth; ++i) {
    const double a = 2.0 * M_PI * i / (4 * teeth), r = i % 4 < 2 ? outer : inner;
    out.emplace_back(r * std::cos(a), r * std::sin(a));
  }
  return out;
}

Rigid3 RandomMotion(unsigned seed) {
  std::mt19937 rng(seed);
  std::normal_distribution<double> normal;
  Rigid3 motion;
  motion.R = Eigen::Quaterniond(normal(rng), normal(rng), normal(rng), normal(rng))
                 .normalized()
                 .toRotationMatrix();
  motion.t = 0.1 * Vector3d(normal(rng), normal(rng), normal(rng));
  return motion;
}

TriangleMesh Moved(TriangleMesh mesh, const Rigid3& motion) {
  for (Vector3d& v : mesh.vertices) v = motion * v;
  return mesh;
}

TEST(SurfaceDistance, IsThatOfAllTriangles) {
  const TriangleMesh mesh = RingMesh(0.03, 0.014, 0.008, 24);
  const double reach = 0.006;
  const SurfaceDistance surface(mesh, reach);
  std::mt19937 rng(5);
  std::uniform_real_distribution<double> place(-0.04, 0.04);
  for (int i = 0; i < 2000; ++i) {
    const Vector3d p(place(rng), place(rng), 0.4 * place(rng));
    double least = reach;
    for (const Eigen::Vector3i& t : mesh.triangles) {
      least = std::min(
          least,
          (NearestInTriangle(p, mesh.vertices[t[0]], mesh.vertices[t[1]], mesh.vertices[t[2]]) - p)
              .norm());
    }
    ASSERT_NEAR(surface.At(p).distance, least, 1e-12) << p.transpose();
  }
}

TEST(MeshSymmetry, GroupsAreKnownInAnyPose) {
  const std::pair<TriangleMesh, std::size_t> parts[] = {
      {BoxMesh({0.03, 0.02, 0.012}), 4},
      {BoxMesh({0.02, 0.02, 0.02}), 24},
      {SweptMesh(Circle(0.03, 6), 0.01), 12},
      {CylinderMesh(0.02, 0.03, 64), 72},
      {SweptMesh(Star(24, 0.03, 0.027), 0.006), 48},
  };
  for (unsigned seed = 0; seed < 3; ++seed) {
    for (const auto& [mesh, order] : parts) {
      const Rigid3 motion = seed == 0 ? Rigid3{} : RandomMotion(seed);
      const auto group = SymmetryGroup(Found(Moved(mesh, motion)));
      EXPECT_EQ(group.size() + 1, order) << "seed " << seed;
    }
  }
}

TEST(MeshSymmetry, ASphereHasNoOrientation) {
  const MeshSymmetries found = Found(SphereMesh(0.02, 24));
  EXPECT_TRUE(found.sphere);
  EXPECT_EQ(SymmetryGroup(found).size(), 59u);
  EXPECT_FALSE(Found(CylinderMesh(0.02, 0.02, 64)).sphere);
}

TEST(MeshSymmetry, FourfoldButForOneHoleNamesTheHole) {
  constexpr double kCell = 0.002;
  const TriangleMesh mesh = PlateWithHoles(20, kCell, 0.002, {{16, 13}});
  const Vector3d hole((16.5 - 10) * kCell, (13.5 - 10) * kCell, 0.0);
  const MeshSymmetries found = Found(mesh);
  EXPECT_TRUE(found.exact.empty());
  const auto fourfold = std::find_if(found.near.begin(), found.near.end(), [](const auto& n) {
    return n.axis.order == 4 && std::abs(n.axis.axis.z()) > 0.999;
  });
  ASSERT_NE(fourfold, found.near.end());
  EXPECT_LT((fourfold->mismatch.place - hole).norm(), kCell);
  EXPECT_LT(fourfold->mismatch.size_m, 3 * kCell);
  EXPECT_GT(fourfold->mismatch.size_m, kCell);
  EXPECT_LT(fourfold->mismatch.area_share, 0.03);
  EXPECT_LT(fourfold->axis.point.head<2>().norm(), 0.1 * kCell);  // not the centroid of the holed
}

TEST(MeshSymmetry, TurnedButForOneBossIsNearlyOfRevolution) {
  TriangleMesh mesh = CylinderMesh(0.03, 0.01, 64);
  const Vector3d boss(0.02, 0.0, 0.0105);
  Append(BoxMesh({0.002, 0.002, 0.0015}), boss, &mesh);
  const MeshSymmetries found = Found(mesh);
  const auto any = std::find_if(
      found.near.begin(), found.near.end(), [](const auto& n) { return n.axis.order == 0; });
  ASSERT_NE(any, found.near.end());
  EXPECT_GT(std::abs(any->axis.axis.z()), 0.9999);
  EXPECT_LT((any->mismatch.place - boss).norm(), 0.003);
  EXPECT_TRUE(SymmetryGroup(found).size() <= 1u);  // the half turn about the boss's axis at most
}

TEST(MeshSymmetry, AnUnevenPartHasNone) {
  TriangleMesh mesh = BoxMesh({0.03, 0.02, 0.012});
  Append(BoxMesh({0.012, 0.006, 0.008}), {0.015, 0.011, 0.018}, &mesh);
  const MeshSymmetries found = Found(mesh);
  EXPECT_TRUE(found.exact.empty());
  EXPECT_TRUE(FindMeshSymmetries({}, 0.1).exact.empty());
}

TEST(MeshSymmetry, ADeclaredTurnThatIsNoneIsMeasured) {
  constexpr double kCell = 0.002;
  const TriangleMesh mesh = PlateWithHoles(20, kCell, 0.002, {{16, 13}, {3, 13}});
  const SymmetryAxis z{Vector3d::UnitZ(), Vector3d::Zero(), 2};
  const SymmetryAxis y{Vector3d::UnitY(), Vector3d::Zero(), 2};
  const std::vector<Rigid3> declared = {TurnAbout(z, M_PI), TurnAbout(y, M_PI)};
  const auto measured = MeasureMismatches(mesh, Diameter(mesh), declared);
  EXPECT_GT(measured[0].largest_m, 0.4 * kCell);
  EXPECT_NEAR(measured[0].place.y(), 3.5 * kCell, kCell);
  EXPECT_LT(measured[1].largest_m, 1e-6);  // a mirror image of itself: turned over it is the same
  EXPECT_EQ(measured[1].area_share, 0.0);
}

}  // namespace
}  // namespace horopter
