// Files of tests/data/inputs/cad, each with a habit of the programs that write them.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <string>
#include <vector>

#include "client/cad_import.h"

namespace horopter {
namespace {

using testing::Contains;
using testing::HasSubstr;
using testing::IsEmpty;

std::string Input(const std::string& name) {
  return std::string(HOROPTER_TEST_DATA) + "/inputs/cad/" + name;
}

CadImport MustImport(const std::string& name, const std::string& unit = "") {
  CadImportOptions options;
  options.unit = unit;
  auto import = ImportCad(Input(name), options);
  EXPECT_TRUE(import.ok()) << name << ": " << import.status();
  return import.ok() ? *std::move(import) : CadImport{};
}

// The angle without holes: an L of six corners, 24 high.
TEST(CadInputs, MeshesOfTheAngleAreTheAngle) {
  for (const char* name : {"obj_comment_before_face.obj",
                           "obj_comment_bslash.obj",
                           "obj_comment_face.obj",
                           "ply_elem_first.ply",
                           "ply_int_xyz.ply",
                           "ply_linebreaks.ply",
                           "ply_nan_normal_ascii.ply",
                           "stl_ascii_ind_normal.stl",
                           "stl_ascii_name_kw.stl",
                           "stl_ascii_upper.stl",
                           "stl_bin_count0.stl",
                           "stl_bin_trailing.stl"}) {
    CadImport import = MustImport(name);
    EXPECT_EQ(import.counts["vertices"], 12) << name;
    EXPECT_EQ(import.counts["lines"], 18) << name;
    EXPECT_EQ(import.counts["triangles"], 20) << name;
    EXPECT_NEAR(import.model.diameter_m, 0.0765, 1e-4) << name;
    for (const CadFinding& f : import.findings)
      EXPECT_NE(f.kind, CadFindingKind::kOpenMesh) << name;
  }
  EXPECT_THAT(MustImport("stl_bin_count0.stl").warnings, Contains(HasSubstr("counts 0 facets")));
  EXPECT_THAT(MustImport("stl_bin_trailing.stl").warnings, Contains(HasSubstr("64 bytes")));
  EXPECT_THAT(MustImport("obj_comment_face.obj").warnings, IsEmpty());
}

TEST(CadInputs, BodiesOfAnObjAreBothThere) {
  CadImport import = MustImport("obj_two_one_without_vt.obj");
  EXPECT_EQ(import.counts["triangles"], 40);
  EXPECT_EQ(import.counts["vertices"], 24);
  EXPECT_THAT(import.warnings, Contains(HasSubstr("2 separate bodies")));
}

TEST(CadInputs, PointsOfACloudWithoutCoordinatesAreCounted) {
  EXPECT_THAT(MustImport("cloud_nan.ply").warnings, Contains(HasSubstr("171 of 8512 points")));
}

}  // namespace
}  // namespace horopter
