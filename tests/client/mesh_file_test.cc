#include "client/mesh_file.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <Eigen/Geometry>
#include <bit>
#include <cmath>
#include <limits>
#include <map>

#include "client/obj_file.h"
#include "client/polygon.h"
#include "client/stl_file.h"
#include "tests/client/angle_mesh.h"
#include "tests/client/mesh_samples.h"
#include "tests/client/temp_folder.h"

namespace horopter {
namespace {

using testing::HasSubstr;

absl::StatusOr<MeshFile> Obj(std::string_view text) {
  return ParseObj(text, nullptr);
}

TEST(Polygon, TrianglesCoverItWhateverItsShape) {
  const std::vector<std::pair<std::string, std::vector<Eigen::Vector2d>>> kShapes = {
      {"square", {{0, 0}, {1, 0}, {1, 1}, {0, 1}}},
      {"angle", {{0, 0}, {3, 0}, {3, 1}, {1, 1}, {1, 3}, {0, 3}}},
      {"corners on a side", {{0, 0}, {1, 0}, {2, 0}, {3, 0}, {3, 3}, {2, 3}, {0, 3}, {0, 1}}},
      {"comb",
       {{0, 0},
        {5, 0},
        {5, 4},
        {4, 4},
        {4, 1},
        {3, 1},
        {3, 4},
        {2, 4},
        {2, 1},
        {1, 1},
        {1, 4},
        {0, 4}}},
      // A hole of 1 x 1 in 3 x 3, reached by a slit.
      {"slit", {{0, 0}, {3, 0}, {3, 3}, {0, 3}, {0, 0}, {1, 1}, {1, 2}, {2, 2}, {2, 1}, {1, 1}}}};
  for (const auto& [name, outline] : kShapes) {
    std::vector<Eigen::Vector3d> points;
    std::vector<int> polygon;
    double twice = 0.0;
    for (size_t i = 0; i < outline.size(); ++i) {
      const Eigen::Vector2d &p = outline[i], &q = outline[(i + 1) % outline.size()];
      points.emplace_back(p.x() + 100.0, p.y() - 50.0, 7.0);
      polygon.push_back(static_cast<int>(i));
      twice += p.x() * q.y() - p.y() * q.x();
    }
    double covered = 0.0;
    const auto triangles = TriangulatePolygon(points, polygon);
    EXPECT_EQ(triangles.size(), outline.size() - 2) << name;
    for (const auto& t : triangles) {
      const double z = (points[t[1]] - points[t[0]]).cross(points[t[2]] - points[t[0]]).z();
      EXPECT_GE(z, -1e-12) << name;
      covered += z;
    }
    EXPECT_NEAR(covered, twice, 1e-9) << name;
  }
  EXPECT_TRUE(TriangulatePolygon({{0, 0, 0}, {1, 0, 0}}, {0, 1}).empty());
}

std::string ObjVertices() {
  std::string text;
  for (const auto& v : AngleCorners()) text += "v " + Line(v) + "\n";
  return text;
}

// form: how a corner is written, N standing for its number.
std::string ObjFaces(const std::string& form, const std::string& end = "\n", int offset = 1) {
  std::string text;
  for (const auto& face : AngleFaces()) {
    text += "f";
    for (const int c : face) {
      std::string corner = form;
      for (size_t at; (at = corner.find('N')) != std::string::npos;) {
        corner.replace(at, 1, std::to_string(c + offset));
      }
      text += " " + corner;
    }
    text += end;
  }
  return text;
}

TEST(ObjFile, EveryWayToWriteAFaceIsTheSamePart) {
  const std::string vertices = ObjVertices(), plain = vertices + ObjFaces("N");
  const std::map<std::string, std::string> kFiles = {
      {"plain", plain},
      {"texture", vertices + "vt 0 0\n" + ObjFaces("N/1")},
      {"normal", vertices + "vn 0 0 1\n" + ObjFaces("N//1")},
      {"both", vertices + "vt 0 0\nvn 0 0 1\n" + ObjFaces("N/1/1")},
      {"empty slashes", vertices + ObjFaces("N/") + "\n"},
      {"texture that is not there", vertices + ObjFaces("N/N/N")},
      {"back from the end", vertices + ObjFaces("N", "\n", -12)},
      {"back from the end with normals", vertices + ObjFaces("N//N", "\n", -12)},
      {"comment behind", vertices + ObjFaces("N", " # side\n")},
      {"comment touching", vertices + ObjFaces("N", "#side\n")},
      {"comment with a backslash", "# D:\\parts\\\n" + vertices + ObjFaces("N", "\n# D:\\x\\\n")},
      {"comment behind with a backslash", vertices + ObjFaces("N", " # D:\\x\\\n")},
      {"names with a backslash", vertices + "g D:\\x\\\no C:\\y\\\nusemtl a\\\n" + ObjFaces("N")},
      {"continued", vertices + ObjFaces("\\\n N")},
      {"continued with blanks", vertices + ObjFaces("\\ \t\r\n N")},
      {"continued vertices", Replaced(plain, " 0\n", " \\\n0\n")},
      {"CR LF", Replaced(plain, "\n", "\r\n")},
      {"CR", Replaced(plain, "\n", "\r")},
      {"tabs", Replaced(plain, " ", "\t")},
      {"many blanks", Replaced(plain, " ", "  \t ")},
      {"indented", "  " + Replaced(plain, "\n", "\n\t ")},
      {"capitals", Replaced(Replaced(plain, "v ", "V "), "f ", "F ")},
      {"fo", Replaced(plain, "f ", "fo ")},
      {"weight", Replaced(vertices, "\n", " 1.0\n") + ObjFaces("N")},
      {"other weight", Replaced(vertices, "\n", " 0.5\n") + ObjFaces("N")},
      {"colours", Replaced(vertices, "\n", " 0.5 0.5 1\n") + ObjFaces("N")},
      {"colours to 255", Replaced(vertices, "\n", " 128 128 255\n") + ObjFaces("N")},
      {"weight and colours", Replaced(vertices, "\n", " 1 0.5 0.5 1\n") + ObjFaces("N")},
      {"exponents", Replaced(plain, "60 ", "+6.0E+01 ")},
      {"exponents 2", Replaced(plain, "60 ", "600.e-1 ")},
      {"mark of byte order", "\xEF\xBB\xBF" + plain},
      {"no end of line", plain.substr(0, plain.size() - 1)},
      {"faces first", ObjFaces("N") + vertices},
      {"lines and points", plain + "l 1 2 3\np 4\n"},
      {"unknown words", "xyzzy 1 2\n" + plain},
      {"groups", "o A\ng one two\ns 1\n" + vertices + "s off\n" + ObjFaces("N", "\ng other\n")},
      {"unused vertex without coordinates", vertices + "v nan nan nan\n" + ObjFaces("N")},
      {"normals without numbers", vertices + "vn nan -1.#IND x\nvt\n" + ObjFaces("N//1")},
      {"face of two corners", plain + "f 1 2\n"},
  };
  for (const auto& [what, text] : kFiles) ExpectAngle(Obj(text), what);
  EXPECT_THAT(Obj(plain + "l 1 2 3\n")->notes, testing::ElementsAre(HasSubstr("1 lines")));
  EXPECT_THAT(Obj(plain + "xyzzy\n")->notes, testing::ElementsAre(HasSubstr("'xyzzy'")));
  EXPECT_THAT(Obj(plain + "f 1 2\n")->notes, testing::ElementsAre(HasSubstr("1 faces of fewer")));
  EXPECT_TRUE(Obj(plain)->notes.empty());
  EXPECT_EQ(Obj(plain)->faces, 8);
}

TEST(ObjFile, BodiesAreAllThereWhateverTheirForms) {
  std::string second;
  for (const auto& v : AngleCorners()) second += "v " + Line(v + Eigen::Vector3d(100, 0, 0)) + "\n";
  const std::string first = "o A\n" + ObjVertices();
  for (const char* form : {"N", "N/1", "N//1", "N/1/1"}) {
    const auto file = Obj(first + ObjFaces("N") + "o B\n" + second + ObjFaces(form, "\n", 13));
    ASSERT_TRUE(file.ok()) << file.status();
    EXPECT_EQ(file->mesh.triangles.size(), 40u) << form;
    const auto swapped = Obj(first + ObjFaces(form) + "o B\n" + second + ObjFaces("N", "\n", 13));
    ASSERT_TRUE(swapped.ok()) << swapped.status();
    EXPECT_EQ(swapped->mesh.triangles.size(), 40u) << form;
  }
}

TEST(ObjFile, ColoursAreThoseOfVerticesElseOfMaterials) {
  const auto materials = [](const std::string& name) {
    return name == "a b.mtl" ? "# x\nnewmtl red one\n  Kd 1 0 0\nd 0.5\n" : "";
  };
  const auto file =
      ParseObj("mtllib a b.mtl\nusemtl red one\n" + ObjVertices() + ObjFaces("N"), materials);
  ASSERT_TRUE(file.ok()) << file.status();
  EXPECT_EQ(file->mesh.colors.at(19), (Rgba{255, 0, 0, 128}));
  const auto by_vertex = Obj(Replaced(ObjVertices(), "\n", " 0 51 255\n") + ObjFaces("N"));
  EXPECT_EQ(by_vertex->mesh.colors.at(0), (Rgba{0, 51, 255, 255}));
}

TEST(ObjFile, WhatCannotBeReadIsRefusedWithItsLine) {
  const std::string vertices = ObjVertices(), plain = vertices + ObjFaces("N");
  ExpectRefused(Obj(plain + "f 1 2 13\n"), "far", "line 21: a face names vertex 13 of 12");
  ExpectRefused(Obj(plain + "f 1 2 -13\n"), "far back", "line 21");
  ExpectRefused(Obj(plain + "f 1 2 0\n"), "zero", "line 21");
  ExpectRefused(Obj(plain + "f 1 2 x\n"), "word", "'x'");
  ExpectRefused(Obj(plain + "f 1 2 3.5\n"), "fraction", "'3.5'");
  ExpectRefused(Obj(plain + "f 1 2 99999999999999999999\n"), "huge", "names no vertex");
  ExpectRefused(Obj(Replaced(plain, "60", "60,5")), "comma", "'60,5' is no number");
  ExpectRefused(Obj(Replaced(plain, "60", "nan")), "nan", "not finite");
  ExpectRefused(Obj(Replaced(plain, "60", "1e999")), "overflow", "not finite");
  ExpectRefused(Obj(Replaced(plain, "60", "-1.#IND")), "Microsoft's nan", "not finite");
  ExpectRefused(Obj(plain + "v 1 2\n"), "two numbers", "three");
  ExpectRefused(Obj(plain + "cstype bspline\nsurf 0 1 0 1 1 2 3 4\n"), "free form", "free-form");
  ExpectRefused(Obj(vertices), "no faces", "no faces");
  ExpectRefused(Obj(""), "empty", "no faces");
  ExpectRefused(Obj(std::string("\xFF\xFEv\0 \0", 6)), "UTF-16", "UTF-16");
}

TEST(ObjFile, AHugePolygonTakesNoTime) {
  std::string text;
  constexpr int kCorners = 20000;
  for (int i = 0; i < kCorners; ++i) {
    const double a = 2 * M_PI * i / kCorners, r = i % 2 == 0 ? 10.0 : 9.0;
    text += "v " + Line({r * std::cos(a), r * std::sin(a), 0}) + "\n";
  }
  text += "f";
  for (int i = 1; i <= kCorners; ++i) text += " " + std::to_string(i);
  ExpectRefused(Obj(text), "star", "20000 corners");
}

std::string BinaryStl(const TriangleMesh& mesh,
                      const std::string& header = "part",
                      std::int64_t count = -1,
                      const std::string& behind = "",
                      float normal = 0.0f) {
  std::string bytes = header;
  bytes.resize(80, header.size() % 2 == 0 ? '\0' : ' ');
  const auto put = [&](const auto& value) {
    bytes.append(reinterpret_cast<const char*>(&value), sizeof(value));
  };
  put(static_cast<std::uint32_t>(count < 0 ? static_cast<std::int64_t>(mesh.triangles.size())
                                           : count));
  for (const auto& t : mesh.triangles) {
    for (int k = 0; k < 3; ++k) put(normal);
    for (const int c : t) {
      for (int k = 0; k < 3; ++k) put(static_cast<float>(mesh.vertices[c][k]));
    }
    put(std::uint16_t{0});
  }
  return bytes + behind;
}

TEST(StlFile, EveryWayToWriteItIsTheSamePart) {
  const TriangleMesh angle = Angle();
  const std::string text = AsStl(angle), binary = BinaryStl(angle);
  std::string upper = text, mixed = text;
  for (char& c : upper) c = static_cast<char>(std::toupper(c));
  for (size_t i = 0; i < mixed.size(); i += 2) mixed[i] = static_cast<char>(std::toupper(mixed[i]));
  const float nan = std::numeric_limits<float>::quiet_NaN();
  const std::map<std::string, std::string> kFiles = {
      {"text", text},
      {"upper", upper},
      {"mixed", mixed},
      {"CR LF", Replaced(text, "\n", "\r\n")},
      {"CR", Replaced(text, "\n", "\r")},
      {"tabs", Replaced(text, " ", "\t")},
      {"keywords in the name", Replaced(text, "solid part", "solid my facet vertex endsolid loop")},
      {"no name", Replaced(text, "solid part", "solid")},
      {"indefinite normals", Replaced(text, "normal 0 0 0", "normal -1.#IND -1.#IND 1.#QNAN")},
      {"nan normals", Replaced(text, "normal 0 0 0", "normal nan -nan(ind) nan")},
      {"normals of words", Replaced(text, "normal 0 0 0", "normal x")},
      {"no normals", Replaced(text, " normal 0 0 0", "")},
      {"ends in two words",
       Replaced(Replaced(text, "endfacet", "end facet"), "endloop", "end loop")},
      {"no endsolid", text.substr(0, text.find("endsolid"))},
      {"mark of byte order", "\xEF\xBB\xBF" + text},
      {"empty lines first", "\n \r\n" + text},
      {"empty solid before", "solid empty\nendsolid empty\n" + text},
      {"exponents", Replaced(text, "60 ", "6.000000E+001 ")},
      {"one line of numbers each", Replaced(text, "vertex ", "vertex\n")},
      {"comment line", Replaced(text, "outer loop", "# here\nouter loop")},
      {"bytes", binary},
      {"solid in the header", BinaryStl(angle, "solid part")},
      {"solid in the header, odd", BinaryStl(angle, "solid part facet ")},
      {"count 0", BinaryStl(angle, "stream", 0)},
      {"count not known", BinaryStl(angle, "stream", 0xFFFFFFFF)},
      {"count 0, something behind", BinaryStl(angle, "stream", 0, "end of file")},
      {"count too low", BinaryStl(angle, "x", 12)},
      {"count too high", BinaryStl(angle, "x", 24)},
      {"bytes behind", BinaryStl(angle, "x", 20, std::string(64, '\0'))},
      {"words behind", BinaryStl(angle, "x", 20, std::string(250, 'x'))},
      {"one byte behind", BinaryStl(angle, "x", 20, "\n")},
      {"solid and bytes behind", BinaryStl(angle, "solid x", 20, std::string(64, '\0'))},
      {"nan normals in bytes", BinaryStl(angle, "x", -1, "", nan)},
      {"nan normals and count 0", BinaryStl(angle, "x", 0, "", nan)},
  };
  for (const auto& [what, bytes] : kFiles) ExpectAngle(ParseStl(bytes), what);
  EXPECT_TRUE(ParseStl(binary)->notes.empty());
  EXPECT_TRUE(ParseStl(text)->notes.empty());
  EXPECT_THAT(ParseStl(kFiles.at("count 0"))->notes,
              testing::ElementsAre(HasSubstr("counts 0 facets; 20 are there")));
  EXPECT_THAT(ParseStl(kFiles.at("bytes behind"))->notes,
              testing::ElementsAre(HasSubstr("64 bytes")));
  EXPECT_THAT(ParseStl(kFiles.at("no endsolid"))->notes,
              testing::ElementsAre(HasSubstr("cut short")));
}

TEST(StlFile, SolidsAndPolygonsAreAllThere) {
  const TriangleMesh angle = Angle();
  const TriangleMesh other = Moved(angle, Rigid3{Eigen::Matrix3d::Identity(), {100, 0, 0}});
  const auto file = ParseStl(AsStl(angle) + AsStl(other));
  ASSERT_TRUE(file.ok()) << file.status();
  EXPECT_EQ(file->mesh.triangles.size(), 40u);
  std::string polygons = "solid\n";
  for (const auto& face : AngleFaces()) {
    polygons += "facet normal 0 0 1\nouter loop\n";
    for (const int c : face) polygons += "vertex " + Line(AngleCorners()[c]) + "\n";
    polygons += "endloop\nendfacet\n";
  }
  ExpectAngle(ParseStl(polygons + "endsolid\n"), "polygons");
}

TEST(StlFile, FlatFacetsStayForTheCleaningToCount) {
  TriangleMesh angle = Angle();
  angle.triangles.emplace_back(0, 0, 1);
  for (const std::string& bytes : {AsStl(angle), BinaryStl(angle)}) {
    const auto file = ParseStl(bytes);
    ASSERT_TRUE(file.ok()) << file.status();
    EXPECT_EQ(file->mesh.triangles.size(), 21u);
  }
}

TEST(StlFile, ColoursOfMaterialise) {
  const std::string bytes = BinaryStl(Angle(), std::string("COLOR=\x01\x02\x03\xFF", 10));
  std::string own = bytes;
  own[84 + 48] = '\x1F';                        // full red
  own[84 + 50 + 49] = static_cast<char>(0x80);  // the header's
  const auto file = ParseStl(own);
  ASSERT_TRUE(file.ok()) << file.status();
  EXPECT_EQ(file->mesh.colors.at(0), (Rgba{255, 0, 0, 255}));
  EXPECT_EQ(file->mesh.colors.at(1), (Rgba{1, 2, 3, 255}));
}

TEST(StlFile, WhatIsCutShortOrBrokenIsRefused) {
  const TriangleMesh angle = Angle();
  const std::string text = AsStl(angle), binary = BinaryStl(angle);
  ExpectRefused(ParseStl(text.substr(0, text.size() / 2)), "half of the text");
  ExpectRefused(ParseStl(binary.substr(0, 84 + 50 * 12)), "twelve facets", "12 of 20");
  ExpectRefused(ParseStl(binary.substr(0, 84 + 50 * 12 + 7)), "twelve and a bit", "12 of 20");
  ExpectRefused(ParseStl(binary.substr(0, 100)), "header");
  ExpectRefused(ParseStl(""), "empty");
  ExpectRefused(ParseStl("solid part\nendsolid part\n"), "no facets", "no facets");
  ExpectRefused(ParseStl(Replaced(text, "60 ", "6O ")), "a letter for a digit", "three numbers");
  ExpectRefused(ParseStl(Replaced(text, "60 ", "inf ")), "infinite", "finite");
  std::string lost = text;
  lost.replace(lost.find("vertex"), 6, "vertx ");
  ExpectRefused(ParseStl(lost), "a lost corner", "facet 1 has 2 corners");
  ExpectRefused(ParseStl(BinaryStl(angle, "x", 0, std::string(400, 'x'))),
                "count 0 and more behind");
}

TEST(MeshFile, ErrorsNameTheFile) {
  const TempFolder folder;
  EXPECT_EQ(ReadMeshFile(folder.path() + "/none.obj").status().code(), absl::StatusCode::kNotFound);
  const std::string path = folder.Write("a.stl", "solid\n");
  EXPECT_THAT(std::string(ReadMeshFile(path).status().message()), HasSubstr(path));
}

}  // namespace
}  // namespace horopter
