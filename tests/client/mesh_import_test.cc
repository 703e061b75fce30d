#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <Eigen/Geometry>
#include <algorithm>
#include <filesystem>
#include <random>

#include "client/bop_export.h"
#include "client/cad_import.h"
#include "tests/client/mesh_samples.h"
#include "tests/client/temp_folder.h"
#include "tests/support/dense_box.h"

namespace horopter {
namespace {

using testing::HasSubstr;

CadImport MustImport(const std::string& path, const CadImportOptions& options = {}) {
  auto import = ImportCad(path, options);
  EXPECT_TRUE(import.ok()) << import.status();
  return import.ok() ? *std::move(import) : CadImport{};
}

double SignedVolume(const TriangleMesh& mesh) {
  double volume = 0.0;
  for (const auto& t : mesh.triangles) {
    volume += mesh.vertices[t[0]].dot(mesh.vertices[t[1]].cross(mesh.vertices[t[2]])) / 6.0;
  }
  return volume;
}

// Laws every model must obey (object_model.h).
void ExpectInvariants(const ObjectModel& model) {
  for (const ModelEdge& e : model.edges) {
    ASSERT_GE(e.polyline.size(), 2u);
    if (e.start_vertex < 0) {
      EXPECT_EQ(e.end_vertex, -1);
      EXPECT_EQ(e.polyline.front(), e.polyline.back());
    } else {
      EXPECT_NE(e.start_vertex, e.end_vertex);
      EXPECT_EQ(e.polyline.front(), model.vertices.at(static_cast<size_t>(e.start_vertex)));
      EXPECT_EQ(e.polyline.back(), model.vertices.at(static_cast<size_t>(e.end_vertex)));
    }
  }
}

TEST(MeshImport, BoxIsTheSamePartInEveryFormat) {
  const TempFolder folder;
  const TriangleMesh box = Box(40, 30, 20);
  for (const std::string& path : {folder.Write("b.ply", AsPly(box)),
                                  folder.Write("b.obj", AsObj(box)),
                                  folder.Write("b.STL", AsStl(box))}) {
    const CadImport import = MustImport(path);
    EXPECT_EQ(import.counts.at("vertices"), 8) << path;
    EXPECT_EQ(import.counts.at("lines"), 12) << path;
    EXPECT_EQ(import.counts.at("circles"), 0) << path;
    EXPECT_EQ(import.model.symmetries.size(), 3u) << path;
    EXPECT_NEAR(import.model.diameter_m, std::sqrt(40. * 40 + 30 * 30 + 20 * 20) * 1e-3, 1e-8);
    EXPECT_NEAR(SignedVolume(import.model.mesh), 24e-6, 1e-11);
    EXPECT_TRUE(import.warnings.empty()) << import.warnings[0];
    EXPECT_FALSE(import.unit_from_file);
    for (const ModelEdge& e : import.model.edges) EXPECT_NEAR(e.dihedral_rad, M_PI / 2, 1e-6);
    ExpectInvariants(import.model);
  }
}

TEST(MeshImport, UnitsAreOnlyAScale) {
  const TempFolder folder;
  for (const auto& [unit, metres] : std::vector<std::pair<std::string, double>>{
           {"mm", 1e-3}, {"cm", 1e-2}, {"m", 1.0}, {"in", 0.0254}, {"ft", 0.3048}, {"um", 1e-6}}) {
    CadImportOptions options;
    options.unit = unit;
    const CadImport import = MustImport(
        folder.Write("b.ply", AsPly(Scaled(Box(0.04, 0.03, 0.02), 1.0 / metres))), options);
    EXPECT_EQ(import.unit_name, unit);
    EXPECT_DOUBLE_EQ(import.metres_per_unit, metres);
    EXPECT_NEAR(import.model.diameter_m, std::sqrt(29e-4), 1e-8) << unit;
  }
}

TEST(MeshImport, RimsOfTessellatedCylindersAreCirclesWithoutCorners) {
  const TempFolder folder;
  for (const int n : {10, 12, 17, 24, 64}) {
    const CadImport import =
        MustImport(folder.Write("c.stl", AsStl(Prism(RegularPolygon(n, 15), 30))));
    EXPECT_EQ(import.counts.at("circles"), 2) << n;
    EXPECT_EQ(import.counts.at("lines"), 0) << n;
    EXPECT_EQ(import.counts.at("vertices"), 0) << n;
    ExpectInvariants(import.model);
  }
}

std::string ScanNote(const CadImport& import) {
  for (const CadFinding& f : import.findings) {
    if (f.kind == CadFindingKind::kScan) return f.text;
  }
  return "";
}

// Of 2400 squares with 0.12 mm of noise, where neighbours meet at up to 30 degrees.
TEST(MeshImport, OfAScanTheCreasesOfThePartAreKept) {
  const TempFolder folder;
  const TriangleMesh noisy = DenseBox(40, 20, 0.12);
  const CadImport import = MustImport(folder.Write("s.ply", AsPly(noisy)));
  EXPECT_THAT(ScanNote(import), HasSubstr("0.12 mm rough"));
  ExpectInvariants(import.model);
  EXPECT_LT(import.model.edges.size(), 60u);
  double length = 0.0;
  for (const ModelEdge& e : import.model.edges) {
    for (std::size_t i = 0; i + 1 < e.polyline.size(); ++i) {
      length += (e.polyline[i + 1] - e.polyline[i]).norm();
      // Two of three coordinates are those of a side.
      const Eigen::Vector3d p = 0.5 * (e.polyline[i] + e.polyline[i + 1]);
      const auto on_side = ((p.array() - 0.02).abs() - 0.02).abs() < 1e-3;
      EXPECT_GE(on_side.count(), 2) << p.transpose();
    }
  }
  EXPECT_NEAR(length, 12 * 0.040, 0.04);
  // The surface is kept as it was scanned.
  ASSERT_EQ(import.model.mesh.vertices.size(), noisy.vertices.size());
}

TEST(MeshImport, AFineMeshWithoutNoiseIsNoScan) {
  const TempFolder folder;
  const CadImport import = MustImport(folder.Write("f.ply", AsPly(DenseBox(40, 20, 0.0))));
  EXPECT_EQ(ScanNote(import), "");
  EXPECT_EQ(import.counts.at("lines"), 12);
}

TEST(MeshImport, PolygonalPrismsKeepTheirEdges) {
  const TempFolder folder;
  for (const int n : {3, 5, 6, 8}) {
    const CadImport import =
        MustImport(folder.Write("p.obj", AsObj(Prism(RegularPolygon(n, 15), 30))));
    EXPECT_EQ(import.counts.at("lines"), 3 * n) << n;
    EXPECT_EQ(import.counts.at("vertices"), 2 * n) << n;
    EXPECT_EQ(import.model.symmetries.size(), static_cast<size_t>(2 * n - 1)) << n;
  }
}

// A bar with half-round ends: two straight edges and two arcs on each face, joined tangentially, no
// wall edges.
TEST(MeshImport, TangentArcsAndLinesAreSplitAtTheirJoints) {
  std::vector<Eigen::Vector2d> stadium;
  for (int i = 0; i <= 12; ++i) {
    const double a = -M_PI / 2 + M_PI * i / 12;
    stadium.emplace_back(20 + 10 * std::cos(a), 10 * std::sin(a));
  }
  for (int i = 0; i <= 12; ++i) {
    const double a = M_PI / 2 + M_PI * i / 12;
    stadium.emplace_back(-20 + 10 * std::cos(a), 10 * std::sin(a));
  }
  const TempFolder folder;
  const CadImport import = MustImport(folder.Write("s.ply", AsPly(Prism(stadium, 8))));
  EXPECT_EQ(import.counts.at("circles"), 4);
  EXPECT_EQ(import.counts.at("lines"), 4);
  EXPECT_EQ(import.counts.at("vertices"), 8);
  EXPECT_EQ(import.model.symmetries.size(), 3u);
  ExpectInvariants(import.model);
}

TEST(MeshImport, CountsDoNotDependOnThePose) {
  std::mt19937 rng(7);
  SCOPED_TRACE("seed 7");
  std::normal_distribution<double> normal;
  const TempFolder folder;
  TriangleMesh part =
      Prism({{0, 0}, {50, 0}, {50, 12}, {14, 12}, {9, 17}, {9, 40}, {0, 40}}, 22, {5, 5});
  for (int i = 0; i < 20; ++i) {
    Rigid3 motion;
    motion.R = Eigen::Quaterniond(normal(rng), normal(rng), normal(rng), normal(rng))
                   .normalized()
                   .toRotationMatrix();
    motion.t = 100.0 * Eigen::Vector3d(normal(rng), normal(rng), normal(rng));
    const CadImport import = MustImport(folder.Write("l.stl", AsStl(Moved(part, motion))));
    EXPECT_EQ(import.counts.at("vertices"), 14);
    EXPECT_EQ(import.counts.at("lines"), 21);
    EXPECT_TRUE(import.model.symmetries.empty() || import.model.symmetries.size() == 1);
    EXPECT_NEAR(SignedVolume(import.model.mesh), SignedVolume(part) * 1e-9, 1e-9 * 5);
  }
}

TEST(MeshImport, TurnsAnInsideOutMeshAndMixedOrientations) {
  std::mt19937 rng(3);
  TriangleMesh box = Box(40, 30, 20);
  for (auto& t : box.triangles) {
    if (rng() % 3 != 0) std::swap(t[0], t[1]);
  }
  const TempFolder folder;
  const CadImport import = MustImport(folder.Write("b.ply", AsPly(box)));
  EXPECT_NEAR(SignedVolume(import.model.mesh), 24e-6, 1e-11);
  EXPECT_EQ(import.counts.at("lines"), 12);
}

// A side of the box split by a point on its border that the neighbour does not have.
TEST(MeshImport, RepairsTJunctionsAndDropsDegenerateTriangles) {
  TriangleMesh box = Box(40, 30, 20);
  const Eigen::Vector3i split = box.triangles[2];  // wall triangle i, j, n + j
  const int middle = static_cast<int>(box.vertices.size());
  box.vertices.push_back(0.5 * (box.vertices[split[0]] + box.vertices[split[1]]));
  box.triangles[2] = {split[0], middle, split[2]};
  box.triangles.emplace_back(middle, split[1], split[2]);
  box.triangles.emplace_back(split[0], split[0], split[1]);
  const TempFolder folder;
  const CadImport import = MustImport(folder.Write("b.ply", AsPly(box)));
  EXPECT_EQ(import.counts.at("lines"), 12);
  EXPECT_EQ(import.counts.at("vertices"), 8);
  EXPECT_NEAR(SignedVolume(import.model.mesh), 24e-6, 1e-11);
  ASSERT_EQ(import.warnings.size(), 1u);
  EXPECT_THAT(import.warnings[0], HasSubstr("1 degenerate"));
}

// One face per side, the top and bottom not convex.
TEST(MeshImport, PolygonsAreTriangulated) {
  const std::vector<Eigen::Vector2d> profile = {
      {0, 0}, {50, 0}, {50, 12}, {12, 12}, {12, 40}, {0, 40}};
  const int n = static_cast<int>(profile.size());
  std::string text, bottom = "f", top = "f", walls;
  for (const double z : {0.0, 20.0}) {
    for (const auto& p : profile) text += "v " + Line({p.x(), p.y(), z}) + "\n";
  }
  for (int i = 0; i < n; ++i) {
    bottom += " " + std::to_string(n - i);
    top += " " + std::to_string(n + i + 1);
    const int j = (i + 1) % n;
    walls += "f " + std::to_string(i + 1) + " " + std::to_string(j + 1) + " " +
             std::to_string(n + j + 1) + " " + std::to_string(n + i + 1) + "\n";
  }
  const TempFolder folder;
  const CadImport import =
      MustImport(folder.Write("l.obj", text + bottom + "\n" + top + "\n" + walls));
  EXPECT_EQ(import.counts.at("lines"), 18);
  EXPECT_EQ(import.counts.at("vertices"), 12);
  EXPECT_NEAR(SignedVolume(import.model.mesh), (50 * 12 + 12 * 28) * 20e-9, 1e-12);
  EXPECT_TRUE(import.warnings.empty());
}

TEST(MeshImport, FacesKeepTheColoursOfVerticesAndMaterials) {
  TempFolder folder;
  TriangleMesh box = Box(40, 30, 20);
  EXPECT_TRUE(MustImport(folder.Write("plain.ply", AsPly(box))).model.mesh.colors.empty());
  EXPECT_TRUE(MustImport(folder.Write("plain.obj", AsObj(box))).model.mesh.colors.empty());

  // Six triangles of one material, the others of another.
  folder.Write("b.mtl", "newmtl paint\nKd 1 0 0\nnewmtl steel\nKd 0.2 0.4 0.6\n");
  std::string obj = AsObj(box);
  size_t face = obj.find("f ");
  obj.insert(face, "mtllib b.mtl\nusemtl paint\n");
  face = obj.find("f ", face);
  for (int k = 0; k < 6; ++k) face = obj.find("f ", face + 1);
  obj.insert(face, "usemtl steel\n");
  const TriangleMesh painted = MustImport(folder.Write("b.obj", obj)).model.mesh;
  ASSERT_EQ(painted.colors.size(), box.triangles.size());
  EXPECT_EQ(std::count(painted.colors.begin(), painted.colors.end(), Rgba{255, 0, 0, 255}), 6);
  EXPECT_EQ(std::count(painted.colors.begin(), painted.colors.end(), Rgba{51, 102, 153, 255}),
            static_cast<int>(box.triangles.size()) - 6);

  // What the export writes, with vertices apart, comes back as the same part.
  BopExportEntry entry;
  entry.obj_id = 1;
  entry.model.mesh = painted;
  std::filesystem::create_directories(folder.path() + "/models");
  ASSERT_TRUE(WriteBopObject(folder.path(), entry).ok());
  const CadImport again = MustImport(folder.path() + "/models/obj_000001.ply");
  EXPECT_EQ(again.counts.at("lines"), 12);
  EXPECT_EQ(again.model.mesh.vertices.size(), painted.vertices.size());
  EXPECT_EQ(again.model.mesh.colors, painted.colors);
}

// Every triangle in four.
TriangleMesh Subdivided(const TriangleMesh& mesh) {
  TriangleMesh fine;
  for (const Eigen::Vector3i& t : mesh.triangles) {
    const int at = static_cast<int>(fine.vertices.size());
    for (int k = 0; k < 3; ++k) fine.vertices.push_back(mesh.vertices[t[k]]);
    for (int k = 0; k < 3; ++k) {
      fine.vertices.push_back(0.5 * (mesh.vertices[t[k]] + mesh.vertices[t[(k + 1) % 3]]));
    }
    fine.triangles.emplace_back(at, at + 3, at + 5);
    fine.triangles.emplace_back(at + 3, at + 1, at + 4);
    fine.triangles.emplace_back(at + 5, at + 4, at + 2);
    fine.triangles.emplace_back(at + 3, at + 4, at + 5);
  }
  return fine;
}

// However fine the mesh, a part has the features of its shape.
TEST(MeshImport, AFineMeshHasTheFeaturesOfACoarseOne) {
  const TempFolder folder;
  TriangleMesh mesh = Moved(Box(40, 30, 20), Rigid3{Eigen::Matrix3d::Identity(), {100, 0, 0}});
  for (int round = 0; round < 6; ++round) mesh = Subdivided(mesh);
  ASSERT_EQ(mesh.triangles.size(), 65536u);
  const CadImport import = MustImport(folder.Write("fine.ply", AsPly(mesh)));
  EXPECT_EQ(import.counts.at("vertices"), 8);
  EXPECT_EQ(import.counts.at("lines"), 12);
  EXPECT_NEAR(SignedVolume(import.model.mesh), 24e-6, 1e-10);
  ExpectInvariants(import.model);
}

TEST(MeshImport, OpenBordersAreEdgesAndAreReported) {
  TriangleMesh box = Box(40, 30, 20);
  std::erase_if(box.triangles, [](const Eigen::Vector3i& t) { return (t.array() == 9).any(); });
  const TempFolder folder;
  const CadImport import = MustImport(folder.Write("b.ply", AsPly(box)));
  EXPECT_EQ(import.counts.at("lines"), 12);
  ASSERT_EQ(import.warnings.size(), 1u);
  EXPECT_THAT(import.warnings[0], HasSubstr("not closed"));
}

struct BadFile {
  const char* name;
  std::string content;
  const char* expected;
};

TEST(MeshImport, NonManifoldEdgesStayEdgesAndAreReported) {
  const TempFolder folder;
  TriangleMesh both =
      Box(40, 30, 20);  // two boxes that touch along one edge: four faces meet there
  const int first = static_cast<int>(both.vertices.size());
  for (const Eigen::Vector3d& v : Box(40, 30, 20).vertices) {
    both.vertices.push_back(v + Eigen::Vector3d(40, 30, 0));
  }
  for (const Eigen::Vector3i& t : Box(40, 30, 20).triangles) {
    both.triangles.push_back(t.array() + first);
  }
  const CadImport import = MustImport(folder.Write("b.ply", AsPly(both)));
  ExpectInvariants(import.model);
  EXPECT_EQ(import.counts.at("lines"), 23);
  EXPECT_THAT(import.warnings, testing::Contains(HasSubstr("not closed")));
}

TEST(MeshImport, BadFilesAreRefusedByName) {
  const TempFolder folder;
  const std::string box = AsPly(Box(40, 30, 20));
  std::string nan = box;
  nan.replace(nan.find("\n-20 ") + 1, 3, "nan");
  std::string range = box;
  range.replace(range.rfind("\n3 ") + 1, std::string::npos, "3 0 1 9999\n");
  const BadFile files[] = {
      {"empty.ply", "", "empty file"},
      {"text.ply", "this is a letter\n", ""},
      {"text.stl", "this is a letter\n", ""},
      {"text.obj", "this is a letter\n", ""},
      {"short.ply", box.substr(0, box.size() / 2), ""},
      {"header.ply", box.substr(0, 60), ""},
      {"nan.ply", nan, "finite"},
      {"point.ply", AsPly(Scaled(Box(1, 1, 1), 1e-9)), ""},
      {"small.ply", AsPly(Scaled(Box(1, 1, 1), 0.1)), "mm"},
      {"large.ply", AsPly(Box(1e5, 1e5, 1e5)), "mm"},
      {"part.dwg", box, "unknown CAD format"},
      {"part", box, "unknown CAD format"},
  };
  for (const BadFile& file : files) {
    const std::string path = folder.Write(file.name, file.content);
    const auto import = ImportCad(path);
    ASSERT_FALSE(import.ok()) << file.name;
    EXPECT_EQ(import.status().code(), absl::StatusCode::kInvalidArgument) << import.status();
    EXPECT_THAT(std::string(import.status().message()), HasSubstr(path));
    EXPECT_THAT(std::string(import.status().message()), HasSubstr(file.expected));
  }
  EXPECT_THAT(std::string(ImportCad(folder.Write("range.ply", range)).status().message()),
              HasSubstr("names vertex 9999"));
  EXPECT_EQ(ImportCad(folder.path() + "/absent.ply").status().code(), absl::StatusCode::kNotFound);
  EXPECT_EQ(ImportCad(folder.path()).status().code(), absl::StatusCode::kInvalidArgument);
  CadImportOptions options;
  options.unit = "parsec";
  EXPECT_THAT(std::string(ImportCad(folder.Write("b.ply", box), options).status().message()),
              HasSubstr("parsec"));
}

std::string AsBinaryPly(const TriangleMesh& mesh) {
  std::string text = AsPly(mesh);
  text = text.substr(0, text.find("end_header\n") + 11);
  text.replace(text.find("ascii"), 5, "binary_little_endian");
  for (const auto& v : mesh.vertices) {
    const Eigen::Vector3f p = v.cast<float>();
    text.append(reinterpret_cast<const char*>(p.data()), 12);
  }
  for (const auto& t : mesh.triangles) {
    text += '\3';
    text.append(reinterpret_cast<const char*>(t.data()), 12);
  }
  return text;
}

TEST(MeshImport, TruncatedBinaryPlyIsRefusedOrStillValid) {
  const std::string whole = AsBinaryPly(Box(40, 30, 20));
  const TempFolder folder;
  EXPECT_EQ(MustImport(folder.Write("b.ply", whole)).counts.at("lines"), 12);
  for (size_t length = 1; length < whole.size(); length += 7) {
    const auto import = ImportCad(folder.Write("b.ply", whole.substr(0, length)));
    if (import.ok()) {
      ExpectInvariants(import->model);
      EXPECT_FALSE(import->warnings.empty()) << length;  // a hole in the mesh at least
    }
  }
}

// Whatever a broken file does, it must not take the program down.
TEST(MeshImport, RandomlyDamagedFilesGiveAStatus) {
  constexpr unsigned kSeed = 11;
  SCOPED_TRACE(testing::Message() << "seed " << kSeed);
  std::mt19937 rng(kSeed);
  const TempFolder folder;
  const std::string originals[][2] = {{"d.ply", AsPly(Box(40, 30, 20))},
                                      {"d.stl", AsStl(Box(40, 30, 20))},
                                      {"d.obj", AsObj(Box(40, 30, 20))}};
  int refused = 0;
  for (int i = 0; i < 150; ++i) {
    const auto& [name, original] = originals[i % 3];
    std::string text = original;
    for (int k = 0; k < 4; ++k) text[rng() % text.size()] = static_cast<char>(32 + rng() % 95);
    if (rng() % 4 == 0) text.resize(rng() % text.size());
    const auto import = ImportCad(folder.Write(name, text));
    refused += !import.ok();
    if (import.ok()) ExpectInvariants(import->model);
  }
  EXPECT_GT(refused, 0);
}

}  // namespace
}  // namespace horopter
