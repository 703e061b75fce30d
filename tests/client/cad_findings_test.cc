// Files as users have them: each oddity is named by its kind, and what can be used is used.
#include "client/cad_findings.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <string>
#include <utility>
#include <vector>

#include "client/cad_import.h"
#include "tests/client/mesh_samples.h"
#include "tests/client/temp_folder.h"

namespace horopter {
namespace {

using Eigen::Vector3d;
using testing::HasSubstr;
using Kind = CadFindingKind;

CadImport MustImport(const TriangleMesh& mesh, const CadImportOptions& options = {}) {
  const TempFolder folder;
  auto import = ImportCad(folder.Write("part.stl", AsStl(mesh)), options);
  EXPECT_TRUE(import.ok()) << import.status();
  return import.ok() ? *std::move(import) : CadImport{};
}

// The text of the first finding of a kind; empty: none.
std::string TextOf(const CadImport& import, Kind kind) {
  const auto found = std::find_if(import.findings.begin(),
                                  import.findings.end(),
                                  [&](const CadFinding& f) { return f.kind == kind; });
  return found == import.findings.end() ? "" : found->text;
}

bool Warns(const CadImport& import, Kind kind) {
  const std::string text = TextOf(import, kind);
  return !text.empty() && testing::Value(import.warnings, testing::Contains(text));
}

void Append(const TriangleMesh& more, const Vector3d& shift, TriangleMesh* mesh) {
  const int first = static_cast<int>(mesh->vertices.size());
  for (const Vector3d& p : more.vertices) mesh->vertices.push_back(p + shift);
  for (const Eigen::Vector3i& t : more.triangles) mesh->triangles.emplace_back(t.array() + first);
}

void TurnInsideOut(TriangleMesh* mesh) {
  for (Eigen::Vector3i& t : mesh->triangles) std::swap(t[1], t[2]);
}

double SignedVolume(const TriangleMesh& mesh) {
  double volume = 0.0;
  for (const auto& t : mesh.triangles) {
    volume += mesh.vertices[t[0]].dot(mesh.vertices[t[1]].cross(mesh.vertices[t[2]])) / 6.0;
  }
  return volume;
}

// A surface over a grid of angles and heights, closed by fans at both ends.
template <typename Radius>
TriangleMesh Lathe(int around, int along, double length, const Radius& radius) {
  TriangleMesh mesh;
  for (int i = 0; i <= along; ++i) {
    for (int k = 0; k < around; ++k) {
      const double z = length * i / along, a = 2.0 * M_PI * k / around, r = radius(z, a);
      mesh.vertices.emplace_back(r * std::cos(a), r * std::sin(a), z);
    }
  }
  const int low = static_cast<int>(mesh.vertices.size());
  mesh.vertices.emplace_back(0, 0, 0);
  mesh.vertices.emplace_back(0, 0, length);
  for (int k = 0; k < around; ++k) {
    const int next = (k + 1) % around;
    mesh.triangles.emplace_back(low, next, k);
    mesh.triangles.emplace_back(low + 1, along * around + k, along * around + next);
    for (int i = 0; i < along; ++i) {
      const int a = i * around + k, b = i * around + next;
      mesh.triangles.emplace_back(a, b, b + around);
      mesh.triangles.emplace_back(a, b + around, a + around);
    }
  }
  return mesh;
}

TriangleMesh Ball(double radius) {
  TriangleMesh mesh = Lathe(48, 24, 1.0, [](double, double) { return 1.0; });
  const int ring = 48;
  for (int i = 0; i <= 24; ++i) {
    const double t = M_PI * (0.02 + 0.96 * i / 24.0);
    for (int k = 0; k < ring; ++k) {
      const double a = 2.0 * M_PI * k / ring;
      mesh.vertices[i * ring + k] =
          radius * Vector3d(std::sin(t) * std::cos(a), std::sin(t) * std::sin(a), -std::cos(t));
    }
  }
  mesh.vertices[mesh.vertices.size() - 2] = {0, 0, -radius};
  mesh.vertices[mesh.vertices.size() - 1] = {0, 0, radius};
  return mesh;
}

TEST(CadFindings, APlainPartHasNoWarnings) {
  TriangleMesh mesh = Prism({{0, 0}, {40, 0}, {40, 10}, {12, 10}, {12, 30}, {0, 30}}, 20, {6, 5});
  const CadImport import = MustImport(mesh);
  EXPECT_TRUE(import.warnings.empty()) << import.warnings[0];
}

TEST(CadFindings, AnOpenMeshSaysWhere) {
  TriangleMesh box = Box(40, 30, 20);
  std::erase_if(box.triangles, [](const Eigen::Vector3i& t) { return (t.array() == 9).any(); });
  const CadImport import = MustImport(box);
  EXPECT_TRUE(Warns(import, Kind::kOpenMesh));
  EXPECT_THAT(TextOf(import, Kind::kOpenMesh), HasSubstr("4 open edges, 140.0 mm of border"));
  EXPECT_THAT(TextOf(import, Kind::kOpenMesh), HasSubstr("(0.0, 0.0, 20.0) mm"));
}

TEST(CadFindings, InvertedFacesAreTurnedAndCounted) {
  TriangleMesh inside_out = Box(40, 30, 20);
  TurnInsideOut(&inside_out);
  CadImport import = MustImport(inside_out);
  EXPECT_THAT(TextOf(import, Kind::kInvertedFaces), HasSubstr("16 triangles"));
  EXPECT_NEAR(SignedVolume(import.model.mesh), 24e-6, 1e-11);
  TriangleMesh three = Box(40, 30, 20);
  for (const int t : {0, 5, 9}) std::swap(three.triangles[t][1], three.triangles[t][2]);
  import = MustImport(three);
  EXPECT_THAT(TextOf(import, Kind::kInvertedFaces), HasSubstr("3 triangles"));
  EXPECT_NEAR(SignedVolume(import.model.mesh), 24e-6, 1e-11);
  // Of two bodies the one that is inside out is turned.
  TriangleMesh two = Box(40, 30, 20);
  Append(inside_out, {60, 0, 0}, &two);
  EXPECT_NEAR(SignedVolume(MustImport(two).model.mesh), 48e-6, 1e-11);
}

TEST(CadFindings, DuplicateShellsAreDropped) {
  TriangleMesh twice = Box(40, 30, 20);
  Append(Box(40, 30, 20), Vector3d::Zero(), &twice);
  const CadImport import = MustImport(twice);
  EXPECT_TRUE(Warns(import, Kind::kDuplicateFaces));
  EXPECT_EQ(TextOf(import, Kind::kOpenMesh), "");
  EXPECT_EQ(import.counts.at("triangles"), 16);
  EXPECT_EQ(import.counts.at("lines"), 12);
}

TEST(CadFindings, TooManyTrianglesAreSimplifiedAndEdgesStay) {
  // 36864 triangles of a block with a step.
  const TriangleMesh fine = Lathe(96, 192, 60, [](double z, double a) {
    const double side = 20.0 / std::max(std::abs(std::cos(a)), std::abs(std::sin(a)));
    return z <= 30.0 ? side : 0.6 * side;
  });
  CadImportOptions options;
  options.max_triangles = 5000;
  const CadImport import = MustImport(fine, options);
  EXPECT_TRUE(Warns(import, Kind::kSimplified));
  EXPECT_LE(import.counts.at("triangles"), 5000);
  const CadImport given = MustImport(fine);
  EXPECT_EQ(TextOf(given, Kind::kSimplified), "");
  EXPECT_NEAR(import.model.diameter_m, given.model.diameter_m, 0.003 * given.model.diameter_m);
  EXPECT_NEAR(SignedVolume(import.model.mesh),
              SignedVolume(given.model.mesh),
              0.01 * SignedVolume(given.model.mesh));
  EXPECT_GE(import.counts.at("lines"), 12);
}

TEST(CadFindings, MicroscopicFilletsLeaveAUsablePart) {
  // A block whose every upright edge is rounded by 0.1 mm in eight steps: nothing is sharp there.
  std::vector<Eigen::Vector2d> outline;
  for (int corner = 0; corner < 4; ++corner) {
    const double x = corner == 0 || corner == 3 ? 20.0 : -20.0, y = corner < 2 ? 15.0 : -15.0;
    for (int i = 0; i <= 8; ++i) {
      const double a = M_PI / 2 * (corner + i / 8.0);
      outline.emplace_back(x - std::copysign(0.1, x) + 0.1 * std::cos(a),
                           y - std::copysign(0.1, y) + 0.1 * std::sin(a));
    }
  }
  const CadImport import = MustImport(Prism(outline, 20));
  EXPECT_TRUE(import.warnings.empty()) << import.warnings[0];
  EXPECT_GE(import.symmetries.exact.size(), 2u);  // still a block
}

TEST(CadFindings, APlateWithoutReliefHasNoUpside) {
  const CadImport import = MustImport(Box(100, 60, 1));
  EXPECT_THAT(TextOf(import, Kind::kPlainPlate), HasSubstr("1.00 mm"));
  EXPECT_FALSE(Warns(import, Kind::kPlainPlate));  // a note: nothing is wrong with it
  EXPECT_EQ(TextOf(MustImport(Box(100, 60, 20)), Kind::kPlainPlate), "");
}

TEST(CadFindings, AHelicalThreadIsNearlySymmetricAboutItsAxis) {
  constexpr double kPitch = 1.0, kDepth = 0.6;
  const TriangleMesh rod = Lathe(48, 240, 30, [&](double z, double a) {
    const double turns = z / kPitch - a / (2.0 * M_PI);
    return 4.0 - kDepth * std::abs(2.0 * (turns - std::floor(turns)) - 1.0);
  });
  const CadImport import = MustImport(rod);
  const auto& near = import.symmetries.near;
  EXPECT_TRUE(std::any_of(near.begin(), near.end(), [](const NearSymmetry& n) {
    return n.axis.order == 0 && std::abs(n.axis.axis.z()) > 0.999;
  })) << near.size();
  EXPECT_NE(TextOf(import, Kind::kNearlySymmetric), "");
  EXPECT_FALSE(Warns(import, Kind::kNearlySymmetric));
}

TEST(CadFindings, WhatIsHiddenInsideIsSaid) {
  TriangleMesh hollow = Box(40, 30, 20);
  TriangleMesh cavity = Box(20, 10, 8);
  TurnInsideOut(&cavity);
  Append(cavity, {0, 0, 5}, &hollow);
  const CadImport import = MustImport(hollow);
  EXPECT_TRUE(Warns(import, Kind::kHiddenInside));
  EXPECT_THAT(TextOf(import, Kind::kHiddenInside), HasSubstr("1 closed cavities of 16 triangles"));
  EXPECT_EQ(TextOf(import, Kind::kInvertedFaces), "");  // a cavity is meant to be
  EXPECT_EQ(TextOf(import, Kind::kSeveralBodies), "");
}

TEST(CadFindings, LooseBodiesAreSaid) {
  TriangleMesh assembly = Box(40, 30, 20);
  Append(Prism(RegularPolygon(24, 2.0), 8.0), {30, 0, 0}, &assembly);
  const CadImport import = MustImport(assembly);
  EXPECT_TRUE(Warns(import, Kind::kSeveralBodies));
  EXPECT_THAT(TextOf(import, Kind::kSeveralBodies), HasSubstr("2 separate bodies, the smallest"));
}

TEST(CadFindings, ASphereIsTakenAndHasNoOrientation) {
  const CadImport import = MustImport(Ball(15));
  EXPECT_TRUE(import.symmetries.sphere);
  EXPECT_NE(TextOf(import, Kind::kNoOrientation), "");
  EXPECT_NE(TextOf(import, Kind::kNoSharpEdges), "");
  EXPECT_EQ(import.model.symmetries.size(), 59u);
}

TEST(CadFindings, UnitsThatAreNotLikelyAreQuestioned) {
  const TempFolder folder;
  // 50 mm written in metres.
  const auto metres = ImportCad(folder.Write("m.stl", AsStl(Scaled(Box(40, 30, 20), 1e-3))));
  ASSERT_EQ(metres.status().code(), absl::StatusCode::kInvalidArgument);
  EXPECT_THAT(std::string(metres.status().message()), HasSubstr("53.9 mm with --units m"));
  const CadImport inches = MustImport(Scaled(Box(40, 30, 20), 1.0 / 25.4));
  EXPECT_TRUE(Warns(inches, Kind::kDoubtfulUnit));
  EXPECT_THAT(TextOf(inches, Kind::kDoubtfulUnit), HasSubstr("53.9 mm with --units in"));
  CadImportOptions told;
  told.unit = "mm";
  EXPECT_EQ(TextOf(MustImport(Box(40, 30, 20), told), Kind::kDoubtfulUnit), "");
}

}  // namespace
}  // namespace horopter
