#include "db/catalog_record.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <functional>
#include <limits>

#include "tests/support/sample_record.h"

namespace horopter {
namespace {

constexpr double kNan = std::numeric_limits<double>::quiet_NaN();
constexpr double kInfinity = std::numeric_limits<double>::infinity();

TEST(ObjectId, IsLowerCaseAndShort) {
  for (const char* good : {"a", "obj_000001", "m6-screw", "0"})
    EXPECT_TRUE(IsObjectId(good)) << good;
  EXPECT_TRUE(IsObjectId(std::string(63, 'x')));
  EXPECT_FALSE(IsObjectId(std::string(64, 'x')));
  for (const char* bad : {"", "A", "a b", "a/b", "../a", "\xc3\xbc", "a\n", "a'--"})
    EXPECT_FALSE(IsObjectId(bad)) << bad;
  EXPECT_FALSE(IsObjectId(std::string("a\0", 2)));
}

TEST(ValidateModel, AcceptsTheSample) {
  EXPECT_TRUE(ValidateModel(SampleRecord("box").model).ok());
}

struct Damage {
  const char* field;  // how the message must begin
  std::function<void(ObjectModel&)> apply;
};

TEST(ValidateModel, NamesTheOffendingField) {
  const std::vector<Damage> damages = {
      {"object_id", [](ObjectModel& m) { m.id = "Box"; }},
      {"display_name", [](ObjectModel& m) { m.display_name.assign(201, 'x'); }},
      {"diameter_m", [](ObjectModel& m) { m.diameter_m = 0.0; }},
      {"diameter_m", [](ObjectModel& m) { m.diameter_m = kNan; }},
      {"diameter_m", [](ObjectModel& m) { m.diameter_m = 500.0; }},
      {"vertices_m", [](ObjectModel& m) { m.vertices[3].y() = kInfinity; }},
      {"edges[2].kind", [](ObjectModel& m) { m.edges[2].kind = static_cast<CurveKind>(7); }},
      {"edges[2]:", [](ObjectModel& m) { m.edges[2].end_vertex = 8; }},
      {"edges[2]:", [](ObjectModel& m) { m.edges[2].start_vertex = -1; }},
      {"edges[2].dihedral_rad", [](ObjectModel& m) { m.edges[2].dihedral_rad = 3.2; }},
      {"edges[2].dihedral_rad", [](ObjectModel& m) { m.edges[2].dihedral_rad = kNan; }},
      {"edges[2].polyline_m", [](ObjectModel& m) { m.edges[2].polyline.resize(1); }},
      {"edges[2].polyline_m", [](ObjectModel& m) { m.edges[2].polyline[0].x() += 1e-3; }},
      {"edges[12].polyline_m", [](ObjectModel& m) { m.edges[12].polyline.pop_back(); }},
      {"edges[12].polyline_m", [](ObjectModel& m) { m.edges[12].polyline[5].z() = kNan; }},
      {"mesh.vertices_m", [](ObjectModel& m) { m.mesh.vertices.clear(); }},
      {"mesh.vertices_m", [](ObjectModel& m) { m.mesh.vertices[0].x() = kNan; }},
      {"mesh.triangles", [](ObjectModel& m) { m.mesh.triangles.clear(); }},
      {"mesh.triangles", [](ObjectModel& m) { m.mesh.triangles[4][1] = 8; }},
      {"mesh.triangles", [](ObjectModel& m) { m.mesh.triangles[4][1] = -1; }},
      {"object_from_symmetric_object[0]", [](ObjectModel& m) { m.symmetries[0].R *= -1.0; }},
      {"object_from_symmetric_object[0]", [](ObjectModel& m) { m.symmetries[0].R *= 1.1; }},
      {"grasps[1].name", [](ObjectModel& m) { m.grasps[1].name = m.grasps[0].name; }},
      {"grasps[0].name", [](ObjectModel& m) { m.grasps[0].name.clear(); }},
      {"grasps[0].object_from_gripper",
       [](ObjectModel& m) { m.grasps[0].object_from_gripper.t.x() = kNan; }},
      {"grasps[0].parallel_jaw.jaw_opening_m",
       [](ObjectModel& m) { m.grasps[0].jaw_opening_m = -0.01; }},
      {"grasps[0].parallel_jaw.grip_width_m",
       [](ObjectModel& m) { m.grasps[0].grip_width_m = kInfinity; }},
      {"grasps[0].quality", [](ObjectModel& m) { m.grasps[0].quality = 1.5; }},
  };
  for (const Damage& damage : damages) {
    ObjectModel model = SampleRecord("box").model;
    damage.apply(model);
    const absl::Status status = ValidateModel(model);
    EXPECT_EQ(status.code(), absl::StatusCode::kInvalidArgument) << damage.field;
    EXPECT_THAT(std::string(status.message()), testing::StartsWith(damage.field));
  }
}

TEST(ValidateSource, NamesTheOffendingField) {
  CadSource source = SampleRecord("box").source;
  EXPECT_TRUE(ValidateSource(source).ok());
  source.format = "STEP";
  EXPECT_THAT(std::string(ValidateSource(source).message()), testing::StartsWith("source.format"));
  source.format = "step";
  source.sha256 = "abc";
  EXPECT_THAT(std::string(ValidateSource(source).message()), testing::StartsWith("source.sha256"));
}

}  // namespace
}  // namespace horopter
