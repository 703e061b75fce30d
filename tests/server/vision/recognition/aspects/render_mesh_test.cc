#include "server/vision/recognition/aspects/render_mesh.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <Eigen/Dense>
#include <algorithm>
#include <cmath>
#include <limits>

#include "tests/support/solid_meshes.h"

namespace horopter {
namespace {

using Eigen::Vector3d;
using Eigen::Vector3f;

RenderMesh Made(const TriangleMesh& mesh, const RenderMeshOptions& options = {}) {
  absl::StatusOr<RenderMesh> made = MakeRenderMesh(mesh, 0.0, options);
  EXPECT_TRUE(made.ok()) << made.status();
  return made.ok() ? *made : RenderMesh{};
}

// Every triangle with its own three vertices, as STL files have them.
TriangleMesh Soup(const TriangleMesh& mesh) {
  TriangleMesh soup;
  for (const Eigen::Vector3i& t : mesh.triangles) {
    const int first = static_cast<int>(soup.vertices.size());
    for (const int v : t) soup.vertices.push_back(mesh.vertices[v]);
    soup.triangles.emplace_back(first, first + 1, first + 2);
  }
  return soup;
}

TEST(RenderMesh, SoupIsWeldedAndClosed) {
  const RenderMesh mesh = Made(Soup(BoxMesh({0.03, 0.02, 0.01})));
  EXPECT_TRUE(mesh.closed);
  EXPECT_EQ(mesh.vertices.size(), 8u);
  EXPECT_EQ(mesh.triangles.size(), 12u);
  EXPECT_EQ(mesh.edges.size(), 18u);
}

TEST(RenderMesh, ABoxHasTwelveSharpEdgesASphereNone) {
  for (const bool inside_out : {false, true}) {
    TriangleMesh box = BoxMesh({0.03, 0.02, 0.01});
    if (inside_out) TurnInsideOut(&box);
    const RenderMesh mesh = Made(box);
    ASSERT_EQ(mesh.sharp_edges.size(), 12u);  // of 18: the others are diagonals of faces
    for (const SharpEdge& s : mesh.sharp_edges) EXPECT_NEAR(s.turn_rad, 0.5 * M_PI, 1e-4);
  }
  EXPECT_TRUE(Made(SphereMesh(0.05, 60)).sharp_edges.empty());
}

TEST(RenderMesh, TrianglesThatRunTheOtherWayTurnAsTheirNeighbours) {
  TriangleMesh sheet;  // of two triangles, one of them inside out
  sheet.vertices = {{0, 0, 0}, {0.01, 0, 0}, {0.01, 0.01, 0}, {0, 0.01, 0}};
  sheet.triangles = {{0, 1, 2}, {0, 3, 2}};
  EXPECT_TRUE(Made(sheet).sharp_edges.empty());
  sheet.vertices[3].z() = 0.01;
  ASSERT_EQ(Made(sheet).sharp_edges.size(), 1u);
  EXPECT_GT(Made(sheet).sharp_edges[0].turn_rad, kSharpTurnRad);
}

TEST(RenderMesh, DuplicateAndDegenerateTrianglesAreDropped) {
  TriangleMesh box = BoxMesh({0.03, 0.02, 0.01});
  const TriangleMesh clean = box;
  box.triangles.push_back(box.triangles[3]);
  std::swap(box.triangles.back()[0], box.triangles.back()[2]);
  box.triangles.emplace_back(1, 1, 2);
  EXPECT_EQ(Made(box).triangles, Made(clean).triangles);
  EXPECT_TRUE(Made(box).closed);
}

TEST(RenderMesh, InsideOutIsTurned) {
  TriangleMesh box = BoxMesh({0.03, 0.02, 0.01});
  TurnInsideOut(&box);
  const RenderMesh mesh = Made(box);
  EXPECT_TRUE(mesh.closed);
  for (std::size_t t = 0; t < mesh.triangles.size(); ++t) {
    const Vector3f middle =
        (mesh.vertices[mesh.triangles[t][0]] + mesh.vertices[mesh.triangles[t][1]] +
         mesh.vertices[mesh.triangles[t][2]]) /
        3.0f;
    EXPECT_GT(mesh.face_normals[t].dot(middle), 0.0f);
  }
}

TEST(RenderMesh, OnlyWhatIsClosedIsDrawnOneSided) {
  TriangleMesh open = BoxMesh({0.03, 0.02, 0.01});
  open.triangles.pop_back();
  EXPECT_FALSE(Made(open).closed);

  TriangleMesh hollow = BoxMesh({0.03, 0.03, 0.03});
  TriangleMesh cavity = BoxMesh({0.01, 0.01, 0.01});
  TurnInsideOut(&cavity);
  TriangleMesh beside = hollow;
  Append(cavity, Vector3d::Zero(), &hollow);
  Append(cavity, {0.1, 0, 0}, &beside);
  EXPECT_TRUE(Made(hollow).closed);
  EXPECT_FALSE(Made(beside).closed);

  TriangleMesh turned = BoxMesh({0.03, 0.02, 0.01});
  std::swap(turned.triangles[0][0], turned.triangles[0][1]);
  EXPECT_FALSE(Made(turned).closed);
}

TEST(RenderMesh, DecimationKeepsASphereWithinTheTolerance) {
  const double radius = 0.05;
  RenderMeshOptions options;
  options.max_triangles = 1 << 30;
  const RenderMesh mesh = Made(SphereMesh(radius, 90), options);
  EXPECT_TRUE(mesh.closed);
  EXPECT_LT(mesh.triangles.size(), 20000u);  // of 32040
  // The given facets lie inside the ball by 0.02 mm; the tolerance comes on top.
  const double off = options.tolerance * mesh.diameter_m + 2e-5;
  for (std::size_t t = 0; t < mesh.triangles.size(); ++t) {
    const Eigen::Vector3i& v = mesh.triangles[t];
    for (const int k : v) EXPECT_NEAR(mesh.vertices[k].norm(), radius, off);
    const Vector3f middle = (mesh.vertices[v[0]] + mesh.vertices[v[1]] + mesh.vertices[v[2]]) / 3;
    EXPECT_NEAR(middle.norm(), radius, 2.0 * off);
    EXPECT_GT(mesh.face_normals[t].dot(middle.normalized()), 0.95f);
  }
}

TEST(RenderMesh, DecimationKeepsSharpEdgesWhereTheyAre) {
  // A box of many small triangles, all needless.
  TriangleMesh fine;
  constexpr int kSteps = 20;
  const TriangleMesh box = BoxMesh({0.03, 0.02, 0.01});
  for (const Eigen::Vector3i& t : box.triangles) {
    const Vector3d a = box.vertices[t[0]], ab = (box.vertices[t[1]] - a) / kSteps,
                   ac = (box.vertices[t[2]] - a) / kSteps;
    const auto add = [&](int i, int j) { fine.vertices.push_back(a + i * ab + j * ac); };
    for (int i = 0; i < kSteps; ++i) {
      for (int j = 0; i + j < kSteps; ++j) {
        const int first = static_cast<int>(fine.vertices.size());
        add(i, j), add(i + 1, j), add(i, j + 1);
        fine.triangles.emplace_back(first, first + 1, first + 2);
        if (i + j + 2 > kSteps) continue;
        add(i + 1, j), add(i + 1, j + 1), add(i, j + 1);
        fine.triangles.emplace_back(first + 3, first + 4, first + 5);
      }
    }
  }
  const RenderMesh mesh = Made(fine);
  EXPECT_TRUE(mesh.closed);
  EXPECT_LT(mesh.triangles.size(), 100u);
  for (const Vector3d& corner : box.vertices) {
    double nearest = 1.0;
    for (const Vector3f& p : mesh.vertices) {
      nearest = std::min(nearest, (p.cast<double>() - corner).norm());
    }
    const bool is_middle_of_cap = std::abs(corner.x()) < 0.01;
    EXPECT_TRUE(is_middle_of_cap || nearest < 1e-5);
  }
}

TEST(RenderMesh, TwoMillionTrianglesAreBounded) {
  const RenderMesh mesh = Made(SphereMesh(0.05, 708));
  EXPECT_LE(mesh.triangles.size(), 6000u);
  EXPECT_GT(mesh.triangles.size(), 1000u);
  for (const Vector3f& p : mesh.vertices) EXPECT_NEAR(p.norm(), 0.05, 0.05 * 4e-3);
}

TEST(RenderMesh, TwelveFacetsAreRoundEightAreNot) {
  const auto smooth = [](int sides) {
    const RenderMesh mesh = Made(CylinderMesh(0.02, 0.03, sides));
    int between = 0;
    for (std::size_t t = 0; t < mesh.triangles.size(); ++t) {
      if (std::abs(mesh.face_normals[t].z()) < 0.5f) between += mesh.flat[t] == 0;
    }
    return between > 0;
  };
  EXPECT_TRUE(smooth(24));
  EXPECT_TRUE(smooth(12));
  EXPECT_FALSE(smooth(8));
}

TEST(RenderMesh, SameInputSameMesh) {
  const TriangleMesh sphere = SphereMesh(0.05, 40);
  const RenderMesh a = Made(sphere), b = Made(sphere);
  EXPECT_EQ(a.vertices, b.vertices);
  EXPECT_EQ(a.triangles, b.triangles);
  EXPECT_EQ(a.normals, b.normals);
}

TEST(RenderMesh, RefusesWhatIsNoMesh) {
  const auto code = [](const TriangleMesh& mesh) { return MakeRenderMesh(mesh).status().code(); };
  EXPECT_EQ(code({}), absl::StatusCode::kInvalidArgument);
  TriangleMesh box = BoxMesh({0.03, 0.02, 0.01});
  TriangleMesh outside = box;
  outside.triangles[0][0] = static_cast<int>(box.vertices.size());
  EXPECT_EQ(code(outside), absl::StatusCode::kInvalidArgument);
  TriangleMesh infinite = box;
  infinite.vertices[0].x() = std::numeric_limits<double>::quiet_NaN();
  EXPECT_EQ(code(infinite), absl::StatusCode::kInvalidArgument);
  TriangleMesh line;
  line.vertices = {{0, 0, 0}, {0.01, 0, 0}, {0.03, 0, 0}};
  line.triangles = {{0, 1, 2}};
  EXPECT_EQ(code(line), absl::StatusCode::kInvalidArgument);
}

}  // namespace
}  // namespace horopter
