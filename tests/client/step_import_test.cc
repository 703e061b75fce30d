#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <zlib.h>

#include <BRepAlgoAPI_Cut.hxx>
#include <BRepAlgoAPI_Fuse.hxx>
#include <BRepBuilderAPI_Copy.hxx>
#include <BRepBuilderAPI_MakeEdge.hxx>
#include <BRepBuilderAPI_MakeFace.hxx>
#include <BRepBuilderAPI_MakePolygon.hxx>
#include <BRepBuilderAPI_MakeWire.hxx>
#include <BRepFilletAPI_MakeFillet.hxx>
#include <BRepPrimAPI_MakeBox.hxx>
#include <BRepPrimAPI_MakeCylinder.hxx>
#include <BRepPrimAPI_MakePrism.hxx>
#include <BRepPrimAPI_MakeSphere.hxx>
#include <BRep_Builder.hxx>
#include <Eigen/Geometry>
#include <IGESControl_Writer.hxx>
#include <Interface_Static.hxx>
#include <Message.hxx>
#include <Message_Messenger.hxx>
#include <Message_PrinterOStream.hxx>
#include <STEPControl_Writer.hxx>
#include <TopExp_Explorer.hxx>
#include <TopLoc_Location.hxx>
#include <TopoDS.hxx>
#include <TopoDS_Compound.hxx>
#include <TopoDS_Edge.hxx>
#include <TopoDS_Wire.hxx>
#include <algorithm>
#include <cmath>
#include <fstream>
#include <gp.hxx>
#include <gp_Ax2.hxx>
#include <gp_Circ.hxx>
#include <gp_Trsf.hxx>
#include <sstream>
#include <utility>

#include "client/brep_file.h"
#include "client/cad_import.h"
#include "tests/client/temp_folder.h"

namespace horopter {
namespace {

using testing::HasSubstr;

// Writes a shape (in mm) as STEP in the given unit and returns the path.
std::string WriteStep(const TempFolder& folder,
                      const TopoDS_Shape& shape,
                      const char* unit = "MM") {
  Message::DefaultMessenger()->RemovePrinters(STANDARD_TYPE(Message_PrinterOStream));
  STEPControl_Writer();  // makes the settings known
  Interface_Static::SetCVal("xstep.cascade.unit", "MM");
  Interface_Static::SetCVal("write.step.unit", unit);
  STEPControl_Writer writer;  // and this one reads them
  writer.Transfer(shape, STEPControl_AsIs);
  const std::string path = folder.path() + "/part.step";
  writer.Write(path.c_str());
  return path;
}

std::string ReadAll(const std::string& path) {
  std::ostringstream text;
  text << std::ifstream(path, std::ios::binary).rdbuf();
  return text.str();
}

// A 40 x 30 x 20 plate with a through hole of radius 5, off the middle.
TopoDS_Shape PlateWithHole() {
  const TopoDS_Shape box = BRepPrimAPI_MakeBox(40.0, 30.0, 20.0).Shape();
  const gp_Ax2 axis(gp_Pnt(12, 10, -1), gp_Dir(0, 0, 1));
  return BRepAlgoAPI_Cut(box, BRepPrimAPI_MakeCylinder(axis, 5.0, 30.0).Shape()).Shape();
}

CadImport MustImport(const std::string& path) {
  auto import = ImportCad(path);
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

TEST(StepImport, GeometryIsInMetresWhateverTheFilesUnit) {
  for (const auto& [word, name, metres] : std::vector<std::tuple<const char*, std::string, double>>{
           {"MM", "mm", 1e-3}, {"INCH", "in", 0.0254}, {"M", "m", 1.0}, {"CM", "cm", 1e-2}}) {
    const TempFolder folder;
    const CadImport import = MustImport(WriteStep(folder, PlateWithHole(), word));
    EXPECT_EQ(import.unit_name, name);
    EXPECT_DOUBLE_EQ(import.metres_per_unit, metres);
    EXPECT_TRUE(import.unit_from_file);
    EXPECT_NEAR(import.model.diameter_m, std::sqrt(29e-4), 1e-7) << word;
    EXPECT_EQ(import.counts.at("lines"), 12);
    EXPECT_EQ(import.counts.at("circles"), 2);
    EXPECT_EQ(import.counts.at("vertices"), 8);
  }
}

TEST(StepImport, CirclesAreClosedOnTheirRadiusAndSeamsAreNoCorners) {
  const TempFolder folder;
  const CadImport import = MustImport(WriteStep(folder, PlateWithHole()));
  int circles = 0;
  for (const ModelEdge& e : import.model.edges) {
    if (e.kind != CurveKind::kCircle) continue;
    ++circles;
    EXPECT_EQ(e.start_vertex, -1);
    EXPECT_EQ(e.end_vertex, -1);
    EXPECT_EQ(e.polyline.front(), e.polyline.back());
    EXPECT_NEAR(e.dihedral_rad, M_PI / 2, 1e-6);
    for (size_t i = 0; i < e.polyline.size(); ++i) {
      const Eigen::Vector2d r = e.polyline[i].head<2>() - Eigen::Vector2d(0.012, 0.010);
      EXPECT_NEAR(r.norm(), 0.005, 1e-9);
      if (i == 0) continue;
      const Eigen::Vector2d middle = 0.5 * (e.polyline[i] + e.polyline[i - 1]).head<2>();
      EXPECT_GE((middle - Eigen::Vector2d(0.012, 0.010)).norm(), 0.99 * 0.005);
    }
  }
  EXPECT_EQ(circles, 2);
  EXPECT_NEAR(SignedVolume(import.model.mesh), (24000 - M_PI * 25 * 20) * 1e-9, 3e-9 * M_PI * 25);
  EXPECT_TRUE(import.model.symmetries.empty());
}

// The fillet is tangent to both faces: the sharp edge is gone, its ends become arcs.
// Of a face with many holes another algorithm makes the triangles: as many as there must be between
// the same borders, and none of them lies in a hole.
TEST(StepImport, AFaceOfManyHolesIsTriangulatedAsOneOfFewIs) {
  const TempFolder folder;
  for (const int side : {3, 9, 12}) {  // 9, 81 and 144 holes
    BRepBuilderAPI_MakePolygon border;
    for (const auto& [x, y] : {std::pair{0, 0}, {1, 0}, {1, 1}, {0, 1}}) {
      border.Add(gp_Pnt(10.0 * side * x, 10.0 * side * y, 0.0));
    }
    border.Close();
    BRepBuilderAPI_MakeFace face(border.Wire());
    for (int i = 0; i < side * side; ++i) {
      const gp_Ax2 axis(gp_Pnt(10.0 * (i % side) + 5.0, 10.0 * (i / side) + 5.0, 0.0), gp::DZ());
      TopoDS_Wire hole = BRepBuilderAPI_MakeWire(BRepBuilderAPI_MakeEdge(gp_Circ(axis, 3.0)));
      hole.Reverse();
      face.Add(hole);
    }
    const TopoDS_Shape plate = BRepPrimAPI_MakePrism(face.Face(), gp_Vec(0.0, 0.0, 4.0)).Shape();
    EXPECT_EQ(MostWires(plate), side * side + 1);
    const CadImport import = MustImport(WriteStep(folder, plate));
    EXPECT_EQ(import.model.edges.size(), 12u + 2u * side * side);
    const TriangleMesh& mesh = import.model.mesh;
    const auto rim = static_cast<int>(mesh.vertices.size() - 8) / (2 * side * side);
    EXPECT_EQ(static_cast<int>(mesh.vertices.size()), 8 + 2 * side * side * rim);
    // Euler: 2 - 2 holes = vertices - triangles / 2.
    EXPECT_EQ(mesh.triangles.size(), 2 * (mesh.vertices.size() - 2 + 2 * side * side));
    const double hole = 0.5 * rim * 9.0 * std::sin(2.0 * M_PI / rim);
    EXPECT_NEAR(SignedVolume(mesh) * 1e9, side * side * (100.0 - hole) * 4.0, 1e-3 * side * side);
  }
}

TEST(StepImport, SmoothEdgesAreDropped) {
  const TopoDS_Shape box = BRepPrimAPI_MakeBox(40.0, 30.0, 20.0).Shape();
  BRepFilletAPI_MakeFillet fillet(box);
  fillet.Add(4.0, TopoDS::Edge(TopExp_Explorer(box, TopAbs_EDGE).Current()));
  const TempFolder folder;
  const CadImport import = MustImport(WriteStep(folder, fillet.Shape()));
  EXPECT_EQ(import.counts.at("lines"), 11);
  EXPECT_EQ(import.counts.at("circles"), 2);
  EXPECT_EQ(import.counts.at("vertices"), 10);
}

// Two boxes side by side: the lines along the joint are one edge each, the joint itself is none.
TEST(StepImport, CollinearPiecesAreOneEdge) {
  const TopoDS_Shape a = BRepPrimAPI_MakeBox(20.0, 30.0, 20.0).Shape();
  const TopoDS_Shape b = BRepPrimAPI_MakeBox(gp_Pnt(20, 0, 0), 20.0, 30.0, 20.0).Shape();
  const TempFolder folder;
  const CadImport import = MustImport(WriteStep(folder, BRepAlgoAPI_Fuse(a, b).Shape()));
  EXPECT_EQ(import.counts.at("lines"), 12);
  EXPECT_EQ(import.counts.at("vertices"), 8);
  EXPECT_EQ(import.model.symmetries.size(), 3u);
}

TEST(StepImport, CylinderIsListedAsASurfaceOfRevolution) {
  const TempFolder folder;
  const CadImport import =
      MustImport(WriteStep(folder, BRepPrimAPI_MakeCylinder(10.0, 30.0).Shape()));
  EXPECT_EQ(import.counts.at("circles"), 2);
  EXPECT_EQ(import.counts.at("lines"), 0);
  EXPECT_EQ(import.counts.at("vertices"), 0);
  EXPECT_EQ(import.model.symmetries.size(),
            71u);  // 36 rotations, each with a flip, without the identity
}

TEST(StepImport, IgesGivesTheSameEdges) {
  const TempFolder folder;
  IGESControl_Writer writer("MM", 1);
  writer.AddShape(PlateWithHole());
  const std::string path = folder.path() + "/part.igs";
  ASSERT_TRUE(writer.Write(path.c_str()));
  const CadImport import = MustImport(path);
  EXPECT_EQ(import.format, "IGES");
  EXPECT_EQ(import.unit_name, "mm");
  EXPECT_EQ(import.counts.at("lines"), 12);
  EXPECT_EQ(import.counts.at("circles"), 2);
  EXPECT_EQ(import.counts.at("vertices"), 8);
}

// Adds a styled item for the first entity of a type, as CAD systems write it.
std::string WithColor(const std::string& step,
                      const std::string& type,
                      const std::string& rgb,
                      int id) {
  const size_t at = step.find("=" + type + "("), line = step.rfind('#', at);
  const size_t spaced = step.find(type + "(");
  const size_t use = at != std::string::npos ? line : step.rfind('#', spaced);
  const std::string entity = step.substr(use, step.find_first_of(" =", use) - use);
  const size_t context = step.find("GEOMETRIC_REPRESENTATION_CONTEXT");
  const size_t start = step.rfind('#', context);
  const std::string context_id = step.substr(start, step.find_first_of(" =", start) - start);
  const auto n = [&](int k) { return "#" + std::to_string(id + k); };
  const std::string style =
      n(0) + "=COLOUR_RGB(''," + rgb + ");\n" + n(1) + "=FILL_AREA_STYLE_COLOUR(''," + n(0) +
      ");\n" + n(2) + "=FILL_AREA_STYLE('',(" + n(1) + "));\n" + n(3) +
      "=SURFACE_STYLE_FILL_AREA(" + n(2) + ");\n" + n(4) + "=SURFACE_SIDE_STYLE('',(" + n(3) +
      "));\n" + n(5) + "=SURFACE_STYLE_USAGE(.BOTH.," + n(4) + ");\n" + n(6) +
      "=PRESENTATION_STYLE_ASSIGNMENT((" + n(5) + "));\n" + n(7) + "=STYLED_ITEM('',(" + n(6) +
      ")," + entity + ");\n" + n(8) +
      "=MECHANICAL_DESIGN_GEOMETRIC_PRESENTATION_REPRESENTATION('',(" + n(7) + ")," + context_id +
      ");\n";
  std::string out = step;
  out.insert(out.rfind("ENDSEC"), style);
  return out;
}

TEST(StepImport, FacesHaveTheirOwnColourOrThatOfTheirSolid) {
  TempFolder folder;
  const std::string plain = ReadAll(WriteStep(folder, PlateWithHole()));
  EXPECT_TRUE(MustImport(folder.Write("plain.step", plain)).model.mesh.colors.empty());
  const std::string solid = WithColor(plain, "MANIFOLD_SOLID_BREP", "0.2,0.4,0.6", 90000);
  const std::string both = WithColor(solid, "ADVANCED_FACE", "1.,0.,0.", 91000);
  const TriangleMesh mesh = MustImport(folder.Write("colors.step", both)).model.mesh;
  ASSERT_EQ(mesh.colors.size(), mesh.triangles.size());
  int red = 0, blue = 0;
  for (const Rgba& color : mesh.colors) {
    red += color == Rgba{255, 0, 0, 255};
    blue += color == Rgba{51, 102, 153, 255};
  }
  EXPECT_GT(red, 0);
  EXPECT_GT(blue, red);
  EXPECT_EQ(red + blue, static_cast<int>(mesh.colors.size()));
  const TriangleMesh face_only =
      MustImport(folder.Write("face.step", WithColor(plain, "ADVANCED_FACE", "1.,0.,0.", 90000)))
          .model.mesh;
  ASSERT_EQ(face_only.colors.size(), mesh.colors.size());
  EXPECT_EQ(std::count(face_only.colors.begin(), face_only.colors.end(), kNoColor), blue);
}

TEST(StepImport, ASphereHasNoEdgesAndNoOrientation) {
  const TempFolder folder;
  const auto import = ImportCad(WriteStep(folder, BRepPrimAPI_MakeSphere(10.0).Shape()));
  ASSERT_TRUE(import.ok()) << import.status();
  EXPECT_TRUE(import->model.edges.empty());
  EXPECT_TRUE(import->symmetries.sphere);
}

TEST(StepImport, BadFilesAreRefusedByName) {
  const TempFolder folder;
  const std::string good = ReadAll(WriteStep(folder, PlateWithHole()));
  const std::string tiny = ReadAll(WriteStep(folder, BRepPrimAPI_MakeBox(0.1, 0.1, 0.1).Shape()));
  const std::string data = good.substr(0, good.find("DATA;"));
  const std::vector<std::tuple<const char*, std::string, const char*>> files = {
      {"empty.step", "", "empty"},
      {"letter.stp", "Dear Sir or Madam", "not a STEP file"},
      {"cut.step", good.substr(0, good.size() / 2), "cut short"},
      {"hollow.step", data + "DATA;\nENDSEC;\nEND-ISO-10303-21;\n", ""},
      {"tiny.step", tiny, "1 mm"},
      {"letter.igs", "Dear Sir or Madam", "IGES"},
  };
  for (const auto& [name, content, expected] : files) {
    const std::string path = folder.Write(name, content);
    const auto import = ImportCad(path);
    ASSERT_FALSE(import.ok()) << name;
    EXPECT_EQ(import.status().code(), absl::StatusCode::kInvalidArgument) << import.status();
    EXPECT_THAT(std::string(import.status().message()), HasSubstr(path));
    EXPECT_THAT(std::string(import.status().message()), HasSubstr(expected));
  }
}

TEST(StepImport, ContradictingUnitIsAnErrorNotAnOverride) {
  const TempFolder folder;
  const std::string path = WriteStep(folder, PlateWithHole(), "MM");
  CadImportOptions options;
  options.unit = "in";
  const auto import = ImportCad(path, options);
  EXPECT_EQ(import.status().code(), absl::StatusCode::kInvalidArgument);
  EXPECT_THAT(std::string(import.status().message()), HasSubstr("mm"));
  options.unit = "mm";
  EXPECT_TRUE(ImportCad(path, options).ok());
}

TEST(StepImport, AFileThatNamesNoUnitIsInTheOneThatIsTold) {
  const TempFolder folder;
  std::string text = ReadAll(WriteStep(folder, PlateWithHole()));
  const size_t at = text.find("GLOBAL_UNIT_ASSIGNED_CONTEXT");
  ASSERT_NE(at, std::string::npos);
  const size_t list = text.find("((", at), end = text.find("))", list);
  text.replace(list, end + 2 - list, "(())");
  const std::string path = folder.Write("plain.step", text);
  EXPECT_NEAR(MustImport(path).model.diameter_m, std::sqrt(29e-4), 1e-7);
  EXPECT_THAT(MustImport(path).warnings, testing::Contains(HasSubstr("mm assumed")));
  CadImportOptions options;
  options.unit = "in";
  const auto import = ImportCad(path, options);
  ASSERT_TRUE(import.ok()) << import.status();
  EXPECT_NEAR(import->model.diameter_m, 25.4 * std::sqrt(29e-4), 1e-6);
  EXPECT_EQ(import->unit_name, "in");
}

// A unit of 7.5 mm, whatever it is called.
TEST(StepImport, GeometryFollowsTheFactorOfAnOddUnit) {
  const TempFolder folder;
  std::string text = ReadAll(WriteStep(folder, PlateWithHole(), "INCH"));
  const size_t at = text.find("LENGTH_MEASURE(25.4)");
  const size_t bare = text.find("LENGTH_MEASURE_WITH_UNIT(");
  ASSERT_NE(bare, std::string::npos);
  const size_t number = text.find("25.4", at == std::string::npos ? bare : at);
  text.replace(number, 4, "7.5");
  const CadImport import = MustImport(folder.Write("odd.step", text));
  EXPECT_NEAR(import.metres_per_unit, 7.5e-3, 1e-12);
  EXPECT_NEAR(import.model.diameter_m, 7.5 / 25.4 * std::sqrt(29e-4), 1e-7);
}

TEST(StepImport, PackedFilesAreUnpacked) {
  const TempFolder folder;
  const std::string text = ReadAll(WriteStep(folder, PlateWithHole()));
  for (const char* name : {"part.step.gz", "part.stpz", "part.STP.GZ"}) {
    const std::string path = folder.path() + "/" + name;
    const gzFile file = gzopen(path.c_str(), "wb");
    ASSERT_EQ(gzwrite(file, text.data(), static_cast<unsigned>(text.size())),
              static_cast<int>(text.size()));
    gzclose(file);
    const CadImport import = MustImport(path);
    EXPECT_EQ(import.format, "STEP");
    EXPECT_EQ(import.counts.at("lines"), 12);
    const std::string bytes = ReadAll(path);
    const auto cut = ImportCad(folder.Write("cut.step.gz", bytes.substr(0, bytes.size() / 2)));
    EXPECT_THAT(std::string(cut.status().message()), HasSubstr("gzip"));
  }
  EXPECT_THAT(std::string(ImportCad(folder.Write("mesh.stl.gz", "x")).status().message()),
              HasSubstr("unknown CAD format"));
}

// Faces by themselves, as systems of surfaces write them.
TEST(StepImport, LooseFacesAreSewn) {
  TopoDS_Compound faces;
  BRep_Builder builder;
  builder.MakeCompound(faces);
  for (TopExp_Explorer it(PlateWithHole(), TopAbs_FACE); it.More(); it.Next()) {
    builder.Add(faces, BRepBuilderAPI_Copy(it.Current()).Shape());
  }
  const TempFolder folder;
  const CadImport import = MustImport(WriteStep(folder, faces));
  EXPECT_EQ(import.counts.at("lines"), 12);
  EXPECT_EQ(import.counts.at("circles"), 2);
  EXPECT_EQ(import.counts.at("vertices"), 8);
  for (const ModelEdge& e : import.model.edges) EXPECT_NEAR(e.dihedral_rad, M_PI / 2, 1e-6);
}

TEST(StepImport, AnAssemblyIsOnePartOrItsDifferentSolids) {
  const TempFolder folder;
  BRep_Builder builder;
  TopoDS_Compound assembly;
  builder.MakeCompound(assembly);
  const TopoDS_Shape plate = PlateWithHole();
  const TopoDS_Shape box = BRepPrimAPI_MakeBox(gp_Pnt(0, 0, 50), 10.0, 20.0, 30.0).Shape();
  gp_Trsf away;
  away.SetTranslation(gp_Vec(100, 0, 0));
  builder.Add(assembly, plate);
  builder.Add(assembly, box);
  builder.Add(assembly, plate.Moved(TopLoc_Location(away)));
  const std::string path = WriteStep(folder, assembly);

  const CadImport merged = MustImport(path);
  EXPECT_EQ(merged.counts.at("lines"), 36);
  EXPECT_THAT(merged.warnings, testing::Contains(HasSubstr("3 solids")));

  const auto parts = ImportCadParts(path);
  ASSERT_TRUE(parts.ok()) << parts.status();
  ASSERT_EQ(parts->size(), 2u);
  EXPECT_NEAR(SignedVolume((*parts)[0].model.mesh), (24000 - M_PI * 25 * 20) * 1e-9, 50e-9);
  EXPECT_NEAR(SignedVolume((*parts)[1].model.mesh), 6000e-9, 1e-12);
  EXPECT_THAT((*parts)[0].warnings, testing::ElementsAre(HasSubstr("2 times")));
  EXPECT_TRUE((*parts)[1].warnings.empty());
  EXPECT_EQ((*parts)[1].counts.at("lines"), 12);

  const auto single = ImportCadParts(WriteStep(folder, box));
  ASSERT_TRUE(single.ok()) << single.status();
  EXPECT_EQ(single->size(), 1u);
  EXPECT_EQ(ImportCadParts(folder.path() + "/none.step").status().code(),
            absl::StatusCode::kNotFound);
}

}  // namespace
}  // namespace horopter
