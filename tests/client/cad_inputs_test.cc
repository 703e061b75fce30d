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

// The angle with two holes: twelve corners, eighteen lines, two circles.
void ExpectBoredAngle(CadImport import, const std::string& name) {
  EXPECT_EQ(import.counts["vertices"], 12) << name;
  EXPECT_EQ(import.counts["lines"], 18) << name;
  EXPECT_EQ(import.counts["circles"], 2) << name;
  EXPECT_NEAR(import.model.diameter_m, 0.0765, 1e-3) << name;
}

void ExpectRefused(const std::string& name,
                   const std::vector<std::string>& words,
                   const std::string& unit = "") {
  CadImportOptions options;
  options.unit = unit;
  const auto import = ImportCad(Input(name), options);
  ASSERT_FALSE(import.ok()) << name;
  EXPECT_EQ(import.status().code(), absl::StatusCode::kInvalidArgument);
  for (const std::string& word : words) {
    EXPECT_THAT(std::string(import.status().message()), HasSubstr(word));
  }
}

TEST(CadInputs, AStepFileThatLacksAPartIsRefusedByEntityAndName) {
  ExpectRefused("asm_solid_missing.step", {"#908", "#909", "1 of 3 parts", "Bolzen M8x30"});
}

TEST(CadInputs, PartsOfAnAssemblyHaveTheNamesOfTheirProducts) {
  const auto parts = ImportCadParts(Input("step_asm_MM.step"));
  ASSERT_TRUE(parts.ok()) << parts.status();
  std::vector<std::string> names;
  for (const CadImport& part : *parts) names.push_back(part.name);
  EXPECT_THAT(names, testing::UnorderedElementsAre("Bolzen M8x30", "Winkel Größe 1"));
  EXPECT_EQ(MustImport("step_asm_MM.step").name, "Baugruppe");
}

TEST(CadInputs, APartHasTheNameOfItsProductNotOfItsLastFeature) {
  EXPECT_EQ(MustImport("step_feature_name.step").name, "4711-0815 angle");
  EXPECT_EQ(MustImport("step_unit_my.step").name, "");  // only the writing program's words
}

TEST(CadInputs, HiddenBodiesAreLeftOutAndTold) {
  CadImport import = MustImport("step_hidden_body.step");
  EXPECT_EQ(import.counts["vertices"], 12);  // the stock would add eight
  EXPECT_EQ(import.counts["lines"], 18);
  EXPECT_THAT(import.warnings, Contains(HasSubstr("hidden bodies left out: #789")));
  EXPECT_THAT(import.warnings, Contains(HasSubstr("Stock")));
  EXPECT_EQ(import.name, "Bracket");
}

TEST(CadInputs, ATessellatedShapeIsRead) {
  CadImport import = MustImport("step_tess.step");
  EXPECT_EQ(import.counts["vertices"], 12);
  EXPECT_EQ(import.counts["lines"], 18);
  EXPECT_EQ(import.counts["triangles"], 20);
  EXPECT_EQ(import.name, "tess");
  EXPECT_EQ(import.unit_name, "mm");
}

TEST(CadInputs, PartsInOtherFilesAreNamed) {
  ExpectRefused("step_ext_refs.step",
                {"'ext_Bolzen M8x30.stp'", "'ext_Winkel Größe 1.stp' (missing)"});
  EXPECT_EQ(MustImport("ext_Bolzen M8x30.stp").name, "Bolzen M8x30");
}

TEST(CadInputs, AUnitIsWhatItsFactorIs) {
  const CadImport import = MustImport("step_unit_my.step", "in");
  ExpectBoredAngle(import, "my");
  EXPECT_EQ(import.unit_name, "in");
  ExpectRefused("step_unit_my.step", {"in by its own word"}, "mm");
  const CadImport iges = MustImport("iges_inch_noname.igs", "in");
  ExpectBoredAngle(iges, "iges");
  EXPECT_EQ(iges.unit_name, "in");
  EXPECT_TRUE(iges.unit_from_file);
}

TEST(CadInputs, FacesOfAnIgesFileAreSewn) {
  ExpectBoredAngle(MustImport("iges_faces.igs"), "faces");
  ExpectBoredAngle(MustImport("iges_ctrlz.igs"), "ctrlz");
}

}  // namespace
}  // namespace horopter
