// GLB and 3MF files, made here.
#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <zlib.h>

#include <Eigen/Geometry>
#include <cstring>
#include <map>
#include <string>

#include "client/cad_import.h"
#include "client/glb_file.h"
#include "client/threemf_file.h"
#include "tests/client/mesh_samples.h"
#include "tests/client/temp_folder.h"

namespace horopter {
namespace {

using testing::Contains;
using testing::HasSubstr;

void Put(std::string* out, std::uint64_t value, int bytes) {
  for (int k = 0; k < bytes; ++k) out->push_back(static_cast<char>(value >> 8 * k));
}

std::string Glb(const std::string& json, const std::string& data) {
  std::string out = "glTF";
  Put(&out, 2, 4);
  Put(&out, 12 + 8 + json.size() + 8 + data.size(), 4);
  Put(&out, json.size(), 4);
  out += "JSON" + json;
  Put(&out, data.size(), 4);
  out += std::string("BIN\0", 4) + data;
  return out;
}

// Positions as floats, then corners of 16 bits.
std::string DataOf(const TriangleMesh& mesh) {
  std::string data;
  for (const auto& v : mesh.vertices) {
    const Eigen::Vector3f p = v.cast<float>();
    data.append(reinterpret_cast<const char*>(p.data()), 12);
  }
  for (const auto& t : mesh.triangles) {
    for (const int c : t) Put(&data, static_cast<std::uint64_t>(c), 2);
  }
  return data;
}

// A box of ten vertices and sixteen triangles; `nodes` place its only mesh.
std::string BoxGlb(const std::string& nodes,
                   const std::string& roots,
                   const std::string& more = "") {
  const TriangleMesh box = Box(0.04, 0.03, 0.02);
  const std::string json =
      "{\"asset\":{\"version\":\"2.0\"},\"scenes\":[{\"nodes\":" + roots + "}],\"nodes\":" + nodes +
      ",\"meshes\":[{\"primitives\":[{\"attributes\":{\"POSITION\":0},\"indices\":1,\"material\":0}"
      "]}],"
      "\"materials\":[{\"pbrMetallicRoughness\":{\"baseColorFactor\":[1,0,0,1]}}],"
      "\"buffers\":[{\"byteLength\":216}],\"bufferViews\":[{\"buffer\":0,\"byteLength\":120},"
      "{\"buffer\":0,\"byteOffset\":120,\"byteLength\":96}],\"accessors\":["
      "{\"bufferView\":0,\"componentType\":5126,\"count\":10,\"type\":\"VEC3\"},"
      "{\"bufferView\":1,\"componentType\":5123,\"count\":48,\"type\":\"SCALAR\"}]" +
      more + "}";
  return Glb(json, DataOf(box));
}

double EnclosedVolume(const TriangleMesh& mesh) {
  double volume = 0.0;
  for (const auto& t : mesh.triangles) {
    volume += mesh.vertices[t[0]].dot(mesh.vertices[t[1]].cross(mesh.vertices[t[2]])) / 6.0;
  }
  return volume;
}

TEST(GlbFile, NodesMoveTheirMeshes) {
  const auto one = ParseGlb(BoxGlb("[{\"mesh\":0}]", "[0]"));
  ASSERT_TRUE(one.ok()) << one.status();
  EXPECT_EQ(one->mesh.triangles.size(), 16u);
  EXPECT_NEAR(EnclosedVolume(one->mesh), 24e-6, 1e-10);
  EXPECT_EQ(one->mesh.colors.at(0), (Rgba{255, 0, 0, 255}));
  EXPECT_EQ(one->usual_unit, "m");
  // A tree: half the size, mirrored, moved; and the same by its matrix.
  const auto moved = ParseGlb(
      BoxGlb("[{\"children\":[1,2],\"translation\":[1,0,0]},{\"mesh\":0,\"scale\":[-0.5,0.5,0.5]},"
             "{\"mesh\":0,\"matrix\":[0,2,0,0, -2,0,0,0, 0,0,2,0, 0,0,5,1]}]",
             "[0]"));
  ASSERT_TRUE(moved.ok()) << moved.status();
  EXPECT_EQ(moved->mesh.triangles.size(), 32u);
  EXPECT_NEAR(EnclosedVolume(moved->mesh), 24e-6 * (0.125 + 8.0), 1e-9);  // outward still
  EXPECT_NEAR(moved->mesh.vertices.back().z(), 5.04, 1e-6);
  EXPECT_NEAR(moved->mesh.vertices.back().x(), 1.0, 1e-6);
  // Row by row: what looks like a last row that is not 0 0 0 1 is the translation.
  EXPECT_FALSE(
      ParseGlb(BoxGlb("[{\"mesh\":0,\"matrix\":[1,0,0,5, 0,1,0,0, 0,0,1,0, 0,0,0,1]}]", "[0]"))
          .ok());
}

TEST(GlbFile, APartIsInMetresUnlessToldOtherwise) {
  const TempFolder folder;
  const auto import = ImportCad(folder.Write("box.glb", BoxGlb("[{\"mesh\":0}]", "[0]")));
  ASSERT_TRUE(import.ok()) << import.status();
  EXPECT_EQ(import->unit_name, "m");
  EXPECT_EQ(import->counts.at("lines"), 12);
  EXPECT_NEAR(import->model.diameter_m, std::sqrt(29e-4), 1e-6);
}

TEST(GlbFile, WhatCannotBeReadIsRefused) {
  const std::string good = BoxGlb("[{\"mesh\":0}]", "[0]");
  for (size_t length = 0; length < good.size(); length += 11) {
    EXPECT_FALSE(ParseGlb(good.substr(0, length)).ok()) << length;
  }
  const std::map<std::string, std::string> kBad = {
      {BoxGlb("[{\"mesh\":0,\"children\":[0]}]", "[0]"), "from itself"},
      {BoxGlb("[{\"mesh\":0}]", "[0,0]"), "two others"},
      {BoxGlb("[{\"mesh\":0}]", "[7]"), "not there"},
      {BoxGlb("[{\"mesh\":3}]", "[0]"), "not there"},
      {BoxGlb("[{\"mesh\":0}]", "[]"), "no triangles"},
      {BoxGlb("[{\"mesh\":0,\"rotation\":[0,0,0,0]}]", "[0]"), "transform"},
      {BoxGlb("[{\"mesh\":0}]", "[0]", ",\"extensionsRequired\":[\"KHR_draco_mesh_compression\"]"),
       "draco"},
      {Glb("{\"asset\":1", ""), "JSON"},
  };
  for (const auto& [bytes, message] : kBad) {
    const auto file = ParseGlb(bytes);
    ASSERT_FALSE(file.ok()) << message;
    EXPECT_THAT(std::string(file.status().message()), HasSubstr(message));
  }
  std::string far = good;  // the last corner of the last triangle
  far[far.size() - 2] = 99;
  EXPECT_THAT(std::string(ParseGlb(far).status().message()), HasSubstr("names vertex 99 of 10"));
}

// An archive of files, packed or not.
std::string Zip(const std::map<std::string, std::string>& files, bool pack) {
  std::string out, table;
  for (const auto& [name, content] : files) {
    std::string packed = content;
    if (pack) {
      z_stream stream = {};
      EXPECT_EQ(deflateInit2(&stream, 9, Z_DEFLATED, -MAX_WBITS, 8, Z_DEFAULT_STRATEGY), Z_OK);
      packed.resize(deflateBound(&stream, content.size()));
      stream.next_in = reinterpret_cast<Bytef*>(const_cast<char*>(content.data()));
      stream.avail_in = static_cast<uInt>(content.size());
      stream.next_out = reinterpret_cast<Bytef*>(packed.data());
      stream.avail_out = static_cast<uInt>(packed.size());
      EXPECT_EQ(deflate(&stream, Z_FINISH), Z_STREAM_END);
      packed.resize(stream.total_out);
      deflateEnd(&stream);
    }
    const auto common = [&](std::string* to) {
      for (const int field : {20, 0, pack ? 8 : 0, 0, 0})
        Put(to, static_cast<std::uint64_t>(field), 2);
      Put(to,
          crc32(
              0, reinterpret_cast<const Bytef*>(content.data()), static_cast<uInt>(content.size())),
          4);
      Put(to, packed.size(), 4);
      Put(to, content.size(), 4);
      Put(to, name.size(), 2);
      Put(to, 0, 2);
    };
    table += "PK\x01\x02";
    Put(&table, 20, 2);
    common(&table);
    Put(&table, 0, 6);
    Put(&table, 0, 4);
    Put(&table, out.size(), 4);
    table += name;
    out += "PK\x03\x04";
    common(&out);
    out += name + packed;
  }
  const size_t start = out.size();
  out += table + "PK\x05\x06";
  Put(&out, 0, 4);
  Put(&out, files.size(), 2);
  Put(&out, files.size(), 2);
  Put(&out, table.size(), 4);
  Put(&out, start, 4);
  Put(&out, 0, 2);
  return out;
}

std::string MeshXml(const TriangleMesh& mesh) {
  std::string out = "<mesh>\n<vertices>\n";
  for (const auto& v : mesh.vertices) {
    out += "<vertex x=\"" + std::to_string(v.x()) + "\" y=\"" + std::to_string(v.y()) + "\" z='" +
           std::to_string(v.z()) + "' />\n";
  }
  out += "</vertices><!-- <triangle v1=\"0\"/> --><triangles>\n";
  for (const auto& t : mesh.triangles) {
    out += "<triangle v1=\"" + std::to_string(t[0]) + "\" v2=\"" + std::to_string(t[1]) +
           "\" v3=\"" + std::to_string(t[2]) + "\"/>\n";
  }
  return out + "</triangles></mesh>";
}

std::string ModelXml(const std::string& unit,
                     const std::string& resources,
                     const std::string& build) {
  return "<?xml version=\"1.0\" encoding=\"UTF-8\"?>\n<model " + unit +
         " xmlns=\"http://schemas.microsoft.com/3dmanufacturing/core/2015/02\"><resources>" +
         resources + "</resources><build>" + build + "</build></model>";
}

TEST(ThreeMfFile, ItemsComponentsAndUnitsAreFollowed) {
  const std::string box =
      "<object id=\"1\" type=\"model\">" + MeshXml(Box(40, 30, 20)) + "</object>";
  for (const bool pack : {false, true}) {
    const auto one = ParseThreeMf(
        Zip({{"3D/3dmodel.model", ModelXml("unit=\"millimeter\"", box, "<item objectid=\"1\"/>")},
             {"[Content_Types].xml", "<Types/>"}},
            pack));
    ASSERT_TRUE(one.ok()) << one.status();
    EXPECT_EQ(one->mesh.triangles.size(), 16u);
    EXPECT_NEAR(EnclosedVolume(one->mesh), 24000, 1e-6);
    EXPECT_EQ(one->unit, "mm");
  }
  // Two places, one mirrored and half the size; an object of components in another file; support.
  const std::string whole =
      "<object id=\"2\"><components><component objectid=\"1\"/>"
      "<component objectid=\"1\" transform=\"-0.5 0 0 0 0.5 0 0 0 0.5 100 0 0\"/>"
      "<component p:path=\"/3D/Objects/o.model\" objectid=\"1\" transform=\"1 0 0 0 1 0 0 0 1 0 0 "
      "50\"/>"
      "</components></object><object id=\"3\" type=\"support\">" +
      MeshXml(Box(9, 9, 9)) + "</object>";
  const auto all = ParseThreeMf(
      Zip({{"3D/3dmodel.model",
            ModelXml("unit='inch'", box + whole, "<item objectid=\"2\"/><item objectid=\"3\"/>")},
           {"3D/Objects/o.model", ModelXml("unit='inch'", box, "")}},
          true));
  ASSERT_TRUE(all.ok()) << all.status();
  EXPECT_EQ(all->mesh.triangles.size(), 48u);
  EXPECT_NEAR(EnclosedVolume(all->mesh), 24000 * (1 + 0.125 + 1), 1e-6);
  EXPECT_EQ(all->unit, "in");
  EXPECT_THAT(all->notes, Contains(HasSubstr("1 objects of support")));
}

TEST(ThreeMfFile, ItsUnitIsTheFilesOwn) {
  const TempFolder folder;
  const std::string path =
      folder.Write("box.3mf",
                   Zip({{"3D/a.model",
                         ModelXml("unit=\"centimeter\"",
                                  "<object id=\"1\">" + MeshXml(Box(4, 3, 2)) + "</object>",
                                  "<item objectid=\"1\"/>")}},
                       true));
  const auto import = ImportCad(path);
  ASSERT_TRUE(import.ok()) << import.status();
  EXPECT_EQ(import->unit_name, "cm");
  EXPECT_TRUE(import->unit_from_file);
  EXPECT_NEAR(import->model.diameter_m, std::sqrt(29e-4), 1e-6);
  CadImportOptions options;
  options.unit = "mm";
  EXPECT_THAT(std::string(ImportCad(path, options).status().message()), HasSubstr("own word"));
}

TEST(ThreeMfFile, WhatCannotBeReadIsRefused) {
  const std::string box = "<object id=\"1\">" + MeshXml(Box(40, 30, 20)) + "</object>";
  const auto status = [](const std::string& xml) {
    return std::string(ParseThreeMf(Zip({{"a.model", xml}}, true)).status().message());
  };
  EXPECT_THAT(status(ModelXml("", box, "<item objectid=\"7\"/>")), HasSubstr("object 7"));
  EXPECT_THAT(status(ModelXml("", box, "<item objectid=\"1\" transform=\"1 2\"/>")),
              HasSubstr("twelve"));
  EXPECT_THAT(status(ModelXml("unit=\"parsec\"", box, "<item objectid=\"1\"/>")),
              HasSubstr("unit"));
  EXPECT_THAT(status(ModelXml("", "", "")), HasSubstr("no triangles"));
  EXPECT_THAT(status(ModelXml(
                  "",
                  "<object id=\"1\"><components><component objectid=\"1\"/></components></object>",
                  "<item objectid=\"1\"/>")),
              HasSubstr("hold themselves"));
  std::string far = ModelXml("", box, "<item objectid=\"1\"/>");
  far.replace(far.rfind("v3=\""), 4, "v3=\"9");
  EXPECT_THAT(status(far), HasSubstr("names a vertex"));
  const std::string whole = ModelXml("", box, "");
  EXPECT_THAT(status(whole.substr(0, whole.rfind("</model>"))), HasSubstr("cut short"));
  EXPECT_NE(status(whole.substr(0, whole.size() / 2)), "");
  const std::string good = Zip({{"a.model", ModelXml("", box, "<item objectid=\"1\"/>")}}, true);
  ASSERT_TRUE(ParseThreeMf(good).ok());
  for (size_t length = 0; length < good.size(); length += 7) {
    EXPECT_FALSE(ParseThreeMf(good.substr(0, length)).ok()) << length;
  }
  std::string damaged = good;
  damaged[60] = static_cast<char>(damaged[60] ^ 0x55);
  EXPECT_FALSE(ParseThreeMf(damaged).ok());
}

}  // namespace
}  // namespace horopter
