// Parts from edges alone and from points alone: calibrated reconstructions and range images.
#include "client/wireframe.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <Eigen/Geometry>
#include <random>

#include "absl/strings/str_cat.h"
#include "client/cad_import.h"
#include "client/reconstruction_file.h"
#include "tests/client/mesh_samples.h"
#include "tests/client/temp_folder.h"

namespace horopter {
namespace {

using testing::HasSubstr;

// The edges of a prism between z = 0 and height; more polygons: holes or separate pieces.
Wireframe PrismEdges(const std::vector<std::vector<Eigen::Vector2d>>& polygons, double height) {
  Wireframe w;
  for (const auto& polygon : polygons) {
    const int first = static_cast<int>(w.points.size()), n = static_cast<int>(polygon.size());
    for (const double z : {0.0, height}) {
      for (const auto& p : polygon) w.points.emplace_back(p.x(), p.y(), z);
    }
    for (int i = 0; i < n; ++i) {
      const int j = (i + 1) % n;
      w.edges.push_back(std::minmax(first + i, first + j));
      w.edges.push_back(std::minmax(first + n + i, first + n + j));
      w.edges.push_back({first + i, first + n + i});
    }
  }
  return w;
}

std::vector<Eigen::Vector2d> LPolygon() {
  return {{0, 0}, {60, 0}, {60, 12}, {15, 12}, {15, 45}, {0, 45}};
}

double Area(const TriangleMesh& mesh) {
  double area = 0.0;
  for (const auto& t : mesh.triangles) {
    const Eigen::Vector3d a = mesh.vertices[t[0]];
    area += 0.5 * (mesh.vertices[t[1]] - a).cross(mesh.vertices[t[2]] - a).norm();
  }
  return area;
}

double Volume(const TriangleMesh& mesh) {
  double volume = 0.0;
  for (const auto& t : mesh.triangles) {
    volume += mesh.vertices[t[0]].dot(mesh.vertices[t[1]].cross(mesh.vertices[t[2]])) / 6.0;
  }
  return volume;
}

Wireframe Turned(Wireframe w, unsigned seed) {
  std::mt19937 rng(seed);
  std::normal_distribution<double> g;
  const Eigen::Quaterniond q = Eigen::Quaterniond(g(rng), g(rng), g(rng), g(rng)).normalized();
  for (Eigen::Vector3d& p : w.points) p = q * p + Eigen::Vector3d(100, -50, 300);
  return w;
}

std::string AsJson(const Wireframe& w, const std::string& unit) {
  std::string text = "{\"format\": \"horopter_reconstruction\"";
  if (!unit.empty()) absl::StrAppend(&text, ", \"unit\": \"", unit, "\"");
  absl::StrAppend(&text, ", \"segments\": [");
  for (size_t i = 0; i < w.edges.size(); ++i) {
    const auto point = [&](int k) {
      const Eigen::Vector3d& p = w.points[k];
      return absl::StrCat("[", p.x(), ", ", p.y(), ", ", p.z(), "]");
    };
    absl::StrAppend(&text,
                    i > 0 ? ", " : "",
                    "[",
                    point(w.edges[i].first),
                    ", ",
                    point(w.edges[i].second),
                    "]");
  }
  return text + "]}";
}

TEST(Wireframe, TheFacesOfAPrismAreItsLoops) {
  for (const auto& polygon : {LPolygon(),
                              std::vector<Eigen::Vector2d>{{0, 0}, {40, 0}, {40, 30}, {0, 30}},
                              RegularPolygon(5, 20)}) {
    double profile = 0.0;
    for (size_t i = 0; i < polygon.size(); ++i) {
      const auto &a = polygon[i], &b = polygon[(i + 1) % polygon.size()];
      profile += 0.5 * (a.x() * b.y() - a.y() * b.x());
    }
    double around = 0.0;
    for (size_t i = 0; i < polygon.size(); ++i) {
      around += (polygon[(i + 1) % polygon.size()] - polygon[i]).norm();
    }
    const WireframeSurface surface = SurfaceOfWireframe(Turned(PrismEdges({polygon}, 20), 3), 1e-6);
    EXPECT_EQ(surface.faces, static_cast<int>(polygon.size()) + 2);
    EXPECT_EQ(surface.open_edges, 0);
    EXPECT_NEAR(Area(surface.mesh), 2 * profile + 20 * around, 1e-6);
  }
}

TEST(Wireframe, ALoopInsideALoopIsItsHole) {
  const WireframeSurface surface = SurfaceOfWireframe(
      Turned(
          PrismEdges(
              {{{0, 0}, {50, 0}, {50, 40}, {0, 40}}, {{10, 10}, {30, 10}, {30, 25}, {10, 25}}}, 8),
          4),
      1e-6);
  EXPECT_EQ(surface.faces, 10);
  EXPECT_EQ(surface.open_edges, 0);
  EXPECT_NEAR(Area(surface.mesh), 2 * (50 * 40 - 20 * 15) + 8 * (180 + 70), 1e-6);
}

TEST(Wireframe, AnEdgeThatIsMissingIsCountedAndLooseOnesBoundNothing) {
  Wireframe w = PrismEdges({LPolygon()}, 20);
  w.points.emplace_back(0, 0, 90);
  w.edges.push_back({0, static_cast<int>(w.points.size()) - 1});
  EXPECT_EQ(SurfaceOfWireframe(w, 1e-6).open_edges, 1);
  w.edges.erase(w.edges.begin());
  const WireframeSurface open = SurfaceOfWireframe(w, 1e-6);
  EXPECT_GT(open.open_edges, 3);
  EXPECT_LT(open.faces, 8);
  EXPECT_EQ(SurfaceOfWireframe({}, 1e-6).faces, 0);
}

TEST(Reconstruction, BecomesAPartWithItsUnitAndVolume) {
  const TempFolder folder;
  const std::string path =
      folder.Write("a.json", AsJson(Turned(PrismEdges({LPolygon()}, 20), 5), "mm"));
  const auto import = ImportCad(path);
  ASSERT_TRUE(import.ok()) << import.status();
  EXPECT_TRUE(import->unit_from_file);
  EXPECT_EQ(import->counts.at("vertices"), 12);
  EXPECT_EQ(import->counts.at("lines"), 18);
  EXPECT_TRUE(import->warnings.empty()) << import->warnings[0];
  EXPECT_NEAR(Volume(import->model.mesh), 1e-9 * 20 * (60 * 12 + 15 * 33), 1e-9);
  EXPECT_EQ(ImportCad(path, {.unit = "in"}).status().code(), absl::StatusCode::kInvalidArgument);
}

TEST(Reconstruction, NoisyEndsAreWeldedToCorners) {
  const TempFolder folder;
  Wireframe w = PrismEdges({LPolygon()}, 20), noisy;
  std::mt19937 rng(6);
  std::normal_distribution<double> g(0.0, 0.01);
  for (const auto& [a, b] : w.edges) {
    const int first = static_cast<int>(noisy.points.size());
    for (const int k : {a, b}) {
      noisy.points.push_back(w.points[k] + Eigen::Vector3d(g(rng), g(rng), g(rng)));
    }
    noisy.edges.push_back({first, first + 1});
  }
  const auto import = ImportCad(folder.Write("a.json", AsJson(noisy, "")));
  ASSERT_TRUE(import.ok()) << import.status();
  EXPECT_EQ(import->counts.at("vertices"), 12);
  EXPECT_EQ(import->counts.at("lines"), 18);
  EXPECT_EQ(import->unit_name, "mm");
}

TEST(Reconstruction, BadFilesAreRefusedByName) {
  const TempFolder folder;
  const std::string head = "{\"format\": \"horopter_reconstruction\", ";
  for (const std::string& text :
       {std::string("{}"),
        std::string("[1, 2"),
        head + "\"segments\": []}",
        head + "\"segments\": [[0, 1]]}",
        head + "\"points\": [[0,0,0],[1,0,0]], \"segments\": [[0, -1]]}",
        head + "\"segments\": [[[0,0,0]]]}",
        head + "\"segments\": [[[0,0,0],[1,2]]]}",
        head + "\"segments\": [[[0,0,0],[1,2,\"x\"]]]}",
        head + "\"segments\": [[[0,0,0],[1,2,1e999]]]}",
        head + "\"unit\": \"furlong\", \"segments\": [[[0,0,0],[1,2,3]]]}",
        head + "\"segments\": [[[0,0,0],[10,0,0]], [[0,0,0],[0,10,0]]]}"}) {
    const absl::Status status = ImportCad(folder.Write("bad.json", text)).status();
    EXPECT_EQ(status.code(), absl::StatusCode::kInvalidArgument) << text;
    EXPECT_THAT(std::string(status.message()), HasSubstr("bad.json")) << text;
  }
}

// Points spread evenly over the surface, in millimetres, with Gaussian noise.
std::string SampledPly(const TriangleMesh& mesh, int count, double noise, unsigned seed) {
  std::mt19937 rng(seed);
  std::uniform_real_distribution<double> u;
  std::normal_distribution<double> g(0.0, noise);
  std::vector<double> areas;
  for (const auto& t : mesh.triangles) {
    const Eigen::Vector3d a = mesh.vertices[t[0]];
    areas.push_back((mesh.vertices[t[1]] - a).cross(mesh.vertices[t[2]] - a).norm());
  }
  std::discrete_distribution<int> pick(areas.begin(), areas.end());
  std::string text =
      absl::StrCat("ply\nformat ascii 1.0\nelement vertex ",
                   count,
                   "\nproperty float x\nproperty float y\nproperty float z\nend_header\n");
  for (int i = 0; i < count; ++i) {
    const auto& t = mesh.triangles[pick(rng)];
    double r = u(rng), s = u(rng);
    if (r + s > 1) r = 1 - r, s = 1 - s;
    const Eigen::Vector3d p =
        mesh.vertices[t[0]] + r * (mesh.vertices[t[1]] - mesh.vertices[t[0]]) +
        s * (mesh.vertices[t[2]] - mesh.vertices[t[0]]) + Eigen::Vector3d(g(rng), g(rng), g(rng));
    text += Line(p) + "\n";
  }
  return text;
}

TEST(RangeImage, PlanesMeetInTheEdgesAndCornersOfThePart) {
  const TempFolder folder;
  const WireframeSurface truth = SurfaceOfWireframe(Turned(PrismEdges({LPolygon()}, 25), 7), 1e-6);
  double last = 0.0;
  for (const double noise : {0.0, 0.03, 0.1}) {
    const auto import =
        ImportCad(folder.Write("cloud.ply", SampledPly(truth.mesh, 30000, noise, 8)));
    ASSERT_TRUE(import.ok()) << "noise " << noise << ": " << import.status();
    EXPECT_EQ(import->counts.at("vertices"), 12) << noise;
    EXPECT_EQ(import->counts.at("lines"), 18) << noise;
    EXPECT_THAT(import->warnings, testing::Contains(HasSubstr("8 planes"))) << noise;
    double worst = 0.0;
    for (const Eigen::Vector3d& v : import->model.vertices) {
      double nearest = INFINITY;
      for (const Eigen::Vector3d& p : truth.mesh.vertices) {
        nearest = std::min(nearest, (v * 1e3 - p).norm());
      }
      worst = std::max(worst, nearest);
    }
    EXPECT_LT(worst, 0.02 + noise) << noise;
    EXPECT_GE(worst, last * 0.1);
    last = worst;
    EXPECT_NEAR(Volume(import->model.mesh) * 1e9, 25 * (60 * 12 + 15 * 33), 25 * 1215 * 0.01);
  }
}

TEST(RangeImage, OtherPointsOfThePartGiveTheSameCorners) {
  const TempFolder folder;
  const WireframeSurface truth = SurfaceOfWireframe(Turned(PrismEdges({LPolygon()}, 25), 7), 1e-6);
  for (unsigned seed = 20; seed < 24; ++seed) {
    const auto import = ImportCad(folder.Write("c.ply", SampledPly(truth.mesh, 15000, 0.05, seed)));
    ASSERT_TRUE(import.ok()) << "seed " << seed << ": " << import.status();
    EXPECT_EQ(import->counts.at("vertices"), 12) << "seed " << seed;
    EXPECT_EQ(import->counts.at("lines"), 18) << "seed " << seed;
  }
}

// Few points, as of a coarse scan: the distance between neighbours is the points' own.
TEST(RangeImage, SparsePointsGiveTheSameCorners) {
  const TempFolder folder;
  const WireframeSurface truth = SurfaceOfWireframe(Turned(PrismEdges({LPolygon()}, 25), 7), 1e-6);
  for (const int count : {4000, 8000}) {
    const auto import = ImportCad(folder.Write("c.ply", SampledPly(truth.mesh, count, 0.03, 31)));
    ASSERT_TRUE(import.ok()) << count << " points: " << import.status();
    EXPECT_EQ(import->counts.at("vertices"), 12) << count << " points";
    EXPECT_EQ(import->counts.at("lines"), 18) << count << " points";
  }
}

TEST(RangeImage, WhatIsNoPolyhedronIsRefused) {
  std::mt19937 rng(9);
  std::normal_distribution<double> g;
  std::vector<Eigen::Vector3d> sphere, plane, few(10, Eigen::Vector3d::Zero()), same(500, few[0]);
  for (int i = 0; i < 5000; ++i) {
    const Eigen::Vector3d p(g(rng), g(rng), g(rng));
    sphere.push_back(50 * p.normalized());
    plane.push_back({p.x(), p.y(), 0.0});
  }
  for (const auto& points : {sphere, plane, few, same}) {
    EXPECT_EQ(ModelFromPoints(points).status().code(), absl::StatusCode::kInvalidArgument);
  }
}

}  // namespace
}  // namespace horopter
