#include "client/ply_file.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <Eigen/Geometry>
#include <cstdint>
#include <cstdio>
#include <limits>
#include <string>

#include "tests/client/angle_mesh.h"

namespace horopter {
namespace {

using testing::HasSubstr;

struct PlyForm {
  std::string format = "ascii";
  std::string type = "float", count = "uchar", index = "int";
  std::string line = "\n";
};

// Values in a form of PLY.
class PlyWriter {
 public:
  explicit PlyWriter(const PlyForm& form) : form_(form) {}
  void Put(const std::string& type, double value) {
    if (form_.format == "ascii") {
      char word[40];
      std::snprintf(word, sizeof(word), "%.9g", value);
      out += word + separator;
      return;
    }
    std::string bytes;
    const auto put = [&](auto v) { bytes.assign(reinterpret_cast<const char*>(&v), sizeof(v)); };
    if (type == "float")
      put(static_cast<float>(value));
    else if (type == "double")
      put(value);
    else if (type == "char" || type == "uchar")
      put(static_cast<std::int8_t>(value));
    else if (type == "short" || type == "ushort")
      put(static_cast<std::int16_t>(value));
    else
      put(static_cast<std::int32_t>(value));
    if (form_.format == "binary_big_endian") bytes = std::string(bytes.rbegin(), bytes.rend());
    out += bytes;
  }
  void EndRecord() {
    if (form_.format == "ascii") out += form_.line;
  }
  std::string separator = " ";
  std::string out;

 private:
  PlyForm form_;
};

std::string Ply(const PlyForm& form, const std::string& separator = " ") {
  PlyWriter writer(form);
  writer.separator = separator;
  for (const auto& v : AngleCorners()) {
    for (int k = 0; k < 3; ++k) writer.Put(form.type, v[k]);
    writer.EndRecord();
  }
  for (const auto& face : AngleFaces()) {
    writer.Put(form.count, static_cast<double>(face.size()));
    for (const int c : face) writer.Put(form.index, c);
    writer.EndRecord();
  }
  const std::string& n = form.line;
  return "ply" + n + "format " + form.format + " 1.0" + n + "comment made for a test" + n +
         "obj_info vertex face" + n + "element vertex 12" + n + "property " + form.type + " x" + n +
         "property " + form.type + " y" + n + "property " + form.type + " z" + n +
         "element face 8" + n + "property list " + form.count + " " + form.index +
         " vertex_indices" + n + "end_header" + n + writer.out;
}

TEST(PlyFile, EveryTypeOrderAndLineEndIsTheSamePart) {
  for (const char* format : {"ascii", "binary_little_endian", "binary_big_endian"}) {
    for (const char* type :
         {"char", "uchar", "short", "ushort", "int", "uint", "float", "double"}) {
      for (const char* count : {"char", "uchar", "ushort", "int"}) {
        for (const char* line : {"\n", "\r\n", "\r"}) {
          const PlyForm form{
              format, type, count, std::string(count) == "int" ? "uint" : "int", line};
          ExpectAngle(ParsePly(Ply(form)), std::string(format) + " " + type + " " + count);
        }
      }
    }
  }
  ExpectAngle(ParsePly(Ply({}, "\n")), "a number a line");
  ExpectAngle(ParsePly(Replaced(Ply({}), " ", "\t ")), "tabs");
  ExpectAngle(ParsePly(Replaced(Ply({}), "float", "float32")), "sized type");
  ExpectAngle(ParsePly(Replaced(Ply({}), "vertex_indices", "vertex_index")), "other name");
  ExpectAngle(ParsePly(Replaced(Ply({}), "vertex_indices", "corners")), "only list");
  ExpectAngle(ParsePly(Replaced(Ply({}), "list uchar int", "list uchar float")), "float numbers");
  ExpectAngle(ParsePly("\xEF\xBB\xBF" + Ply({})), "mark of byte order");
  EXPECT_EQ(ParsePly(Ply({}))->faces, 8);
  EXPECT_TRUE(ParsePly(Ply({}))->notes.empty());
}

// Elements and properties around those that count, in text and bytes.
TEST(PlyFile, OtherElementsAndPropertiesArePassedBy) {
  for (const char* format : {"ascii", "binary_little_endian", "binary_big_endian"}) {
    const PlyForm form{format, "float", "uchar", "int", "\n"};
    PlyWriter writer(form);
    writer.Put("float", 500.0);  // a camera
    writer.EndRecord();
    const double nan = std::numeric_limits<double>::quiet_NaN();
    for (const auto& face : AngleFaces()) {  // faces before vertices, the list in the middle
      writer.Put("uchar", 255);
      writer.Put("uchar", 2);  // another list
      writer.Put("float", 0.5);
      writer.Put("float", nan);
      writer.Put("uchar", static_cast<double>(face.size()));
      for (const int c : face) writer.Put("int", c);
      writer.Put("short", 3);
      writer.EndRecord();
    }
    for (const auto& v : AngleCorners()) {  // z y x between others, with a list
      writer.Put("double", nan);
      writer.Put("double", v.z());
      writer.Put("uchar", 1);
      writer.Put("int", 77);
      writer.Put("float", v.y());
      writer.Put("short", v.x());
      writer.EndRecord();
    }
    writer.Put("uchar", 3);
    writer.EndRecord();
    const std::string header =
        "ply\nformat " + std::string(format) +
        " 1.0\nelement camera 1\nproperty float fx\nelement nothing 1000000\n"
        "element face 8\nproperty uchar flags\nproperty list uchar float texcoord\n"
        "property list uchar int vertex_indices\nproperty short group\n"
        "element vertex 12\nproperty double nx\nproperty double z\nproperty list uchar int extra\n"
        "property float y\nproperty short x\nelement end 1\nproperty uchar e\nend_header\n";
    ExpectAngle(ParsePly(header + writer.out), format);
  }
}

TEST(PlyFile, StripsAreUnrolled) {
  const std::string strip =
      "ply\nformat ascii 1.0\nelement vertex 4\nproperty float x\nproperty float y\nproperty float "
      "z\nelement tristrips 1\nproperty list int int vertex_indices\nend_header\n"
      "0 0 0\n1 0 0\n0 1 0\n1 1 0\n";
  const auto file = ParsePly(strip + "5 0 1 2 3 -1\n");
  ASSERT_TRUE(file.ok()) << file.status();
  ASSERT_EQ(file->mesh.triangles.size(), 2u);
  for (const auto& t : file->mesh.triangles) {
    const auto& v = file->mesh.vertices;
    EXPECT_GT((v[t[1]] - v[t[0]]).cross(v[t[2]] - v[t[0]]).z(), 0.0);
  }
  EXPECT_EQ(ParsePly(strip + "8 0 1 2 -1 1 3 2 -1\n")->mesh.triangles.size(), 2u);
}

TEST(PlyFile, ColoursOfFacesElseOfVertices) {
  std::string text = Ply({});
  std::string by_face = Replaced(text,
                                 "vertex_indices\n",
                                 "vertex_indices\nproperty uchar red\nproperty uchar "
                                 "green\nproperty uchar blue\n");
  const size_t data = by_face.find("end_header");
  size_t at = data;
  for (int line = 0; line < 13; ++line) at = by_face.find('\n', at) + 1;
  by_face = by_face.substr(0, at) + Replaced(by_face.substr(at), "\n", " 9 8 7\n");
  const auto faces = ParsePly(by_face);
  ExpectAngle(faces, "colours of faces");
  EXPECT_EQ(faces->mesh.colors.at(19), (Rgba{9, 8, 7, 255}));
  std::string by_vertex = Replaced(text,
                                   "property float z\n",
                                   "property float z\nproperty float red\nproperty float "
                                   "green\nproperty float blue\n");
  at = by_vertex.find("end_header\n") + 11;
  for (int line = 0; line < 12; ++line)
    at = by_vertex.insert(by_vertex.find('\n', at), " 0 1 0.2").find('\n', at) + 1;
  const auto vertices = ParsePly(by_vertex);
  ExpectAngle(vertices, "colours of vertices");
  EXPECT_EQ(vertices->mesh.colors.at(0), (Rgba{0, 255, 51, 255}));
}

TEST(PlyFile, PointsWithoutCoordinatesAreLeftOutAndCounted) {
  const std::string header =
      "ply\nformat ascii 1.0\nelement vertex 4\nproperty float x\nproperty float y\nproperty float "
      "z\nelement face 0\nproperty list uchar int vertex_indices\nend_header\n";
  const auto cloud = ParsePly(header + "0 0 0\nnan nan nan\n1 2 3\ninf 0 0\n");
  ASSERT_TRUE(cloud.ok()) << cloud.status();
  EXPECT_EQ(cloud->mesh.vertices.size(), 2u);
  EXPECT_THAT(cloud->notes, testing::ElementsAre(HasSubstr("2 of 4 points")));
  ExpectRefused(ParsePly(header + "nan 0 0\nnan 0 0\nnan 0 0\nnan 0 0\n"), "all nan", "finite");
}

TEST(PlyFile, WhatIsNotAsDeclaredIsRefused) {
  const std::string text = Ply({}),
                    bytes = Ply({"binary_little_endian", "float", "uchar", "int", "\n"});
  for (const std::string& whole : {text, bytes}) {
    for (size_t length = 0; length + 3 < whole.size(); length += 5) {
      const auto file = ParsePly(whole.substr(0, length));
      ASSERT_FALSE(file.ok()) << length;
      EXPECT_EQ(file.status().code(), absl::StatusCode::kInvalidArgument);
    }
  }
  ExpectRefused(ParsePly(text + "3 0 1 2\n"), "one face more", "more numbers");
  ExpectRefused(
      ParsePly(Replaced(text, "4 0 1 7 6", "4 0 1 7 12")), "far", "names vertex 12 of 12");
  ExpectRefused(ParsePly(Replaced(text, "4 0 1 7 6", "4 0 1 7 -1")), "negative", "names vertex -1");
  ExpectRefused(
      ParsePly(Replaced(text, "4 0 1 7 6", "4 0 1 7 6.5")), "fraction", "no vertex number");
  ExpectRefused(ParsePly(Replaced(text, "4 0 1 7 6", "-4 0 1 7 6")), "negative length");
  ExpectRefused(ParsePly(Replaced(text, "4 0 1 7 6", "4000000000 0 1 7 6")), "huge length");
  ExpectRefused(ParsePly(Replaced(text, "60 0 0", "nan 0 0")), "nan", "not finite");
  ExpectRefused(ParsePly(Replaced(text, "vertex 12", "vertex 1000000000000")), "count", "no room");
  ExpectRefused(ParsePly(Replaced(bytes, "vertex 12", "vertex 1000000000000")), "count", "no room");
  ExpectRefused(ParsePly(Replaced(text, "vertex 12", "vertex -1")), "count", "count");
  ExpectRefused(ParsePly(Replaced(text, "float x", "float u")), "no x", "x, y, z");
  ExpectRefused(ParsePly(Replaced(text, "float x", "quad x")), "type", "type");
  ExpectRefused(ParsePly(Replaced(text, "end_header", "end")), "no end");
  ExpectRefused(ParsePly(Replaced(text, "ascii", "utf8")), "format", "format");
  ExpectRefused(ParsePly(""), "empty", "not a PLY");
  ExpectAngle(ParsePly(bytes + "junk"), "bytes behind");
  EXPECT_THAT(ParsePly(bytes + "junk")->notes, testing::ElementsAre(HasSubstr("4 bytes")));
}

}  // namespace
}  // namespace horopter
