#include "server/vision/recognition/aspects/aspect_blob.h"

#include <gtest/gtest.h>

#include <cstring>
#include <string>

#include "tests/support/solid_meshes.h"

namespace horopter {
namespace {

ObjectModel Model() {
  ObjectModel model;
  model.id = "obj_000001";
  model.mesh = RingMesh(0.03, 0.015, 0.008, 60);
  Append(BoxMesh({0.002, 0.003, 0.004}), {0.05, 0.01, 0.0}, &model.mesh);
  model.diameter_m = 0.083;
  return model;
}

ObjectAspectOptions Options() {
  ObjectAspectOptions options;
  options.aspects.directions = 12;
  return options;
}

ObjectAspects Made(const ObjectModel& model) {
  absl::StatusOr<ObjectAspects> made = MakeObjectAspects(model, Options());
  EXPECT_TRUE(made.ok()) << made.status();
  return *made;
}

void ExpectEqual(const ObjectAspects& a, const ObjectAspects& b) {
  EXPECT_EQ(a.mesh.vertices, b.mesh.vertices);
  EXPECT_EQ(a.mesh.triangles, b.mesh.triangles);
  EXPECT_EQ(a.mesh.normals, b.mesh.normals);
  EXPECT_EQ(a.mesh.face_normals, b.mesh.face_normals);
  EXPECT_EQ(a.mesh.flat, b.mesh.flat);
  EXPECT_EQ(a.mesh.closed, b.mesh.closed);
  EXPECT_EQ(a.mesh.edges.size(), b.mesh.edges.size());
  EXPECT_EQ(a.mesh.center, b.mesh.center);
  EXPECT_EQ(a.mesh.diameter_m, b.mesh.diameter_m);
  EXPECT_EQ(a.aspects.center, b.aspects.center);
  EXPECT_EQ(a.aspects.diameter_m, b.aspects.diameter_m);
  EXPECT_EQ(a.aspects.distance_m, b.aspects.distance_m);
  EXPECT_EQ(a.aspects.render_px, b.aspects.render_px);
  EXPECT_EQ(a.aspects.points, b.aspects.points);
  ASSERT_EQ(a.aspects.aspects.size(), b.aspects.aspects.size());
  for (std::size_t i = 0; i < a.aspects.aspects.size(); ++i) {
    EXPECT_EQ(a.aspects.aspects[i].camera_from_object, b.aspects.aspects[i].camera_from_object);
    EXPECT_EQ(a.aspects.aspects[i].first_point, b.aspects.aspects[i].first_point);
    EXPECT_EQ(a.aspects.aspects[i].point_count, b.aspects.aspects[i].point_count);
  }
}

TEST(AspectBlob, DecodeGivesWhatWasEncodedBitForBit) {
  ObjectModel model = Model();
  const ObjectAspects made = Made(model);
  const std::string blob = EncodeObjectAspects(made, model, Options());
  const absl::StatusOr<ObjectAspects> read = DecodeObjectAspects(blob, model, Options());
  ASSERT_TRUE(read.ok()) << read.status();
  ExpectEqual(made, *read);
  EXPECT_EQ(EncodeObjectAspects(*read, model, Options()), blob);

  // Inside out in the file, outside out in the mesh.
  TurnInsideOut(&model.mesh);
  const ObjectAspects turned = Made(model);
  const absl::StatusOr<ObjectAspects> again =
      DecodeObjectAspects(EncodeObjectAspects(turned, model, Options()), model, Options());
  ASSERT_TRUE(again.ok()) << again.status();
  ExpectEqual(turned, *again);
}

TEST(AspectBlob, IsCompact) {
  ObjectModel model;
  model.id = "obj_000002";
  model.mesh = SphereMesh(0.05, 90);
  Append(RingMesh(0.07, 0.052, 0.004, 90), {0, 0, 0}, &model.mesh);
  model.diameter_m = 0.14;
  const absl::StatusOr<ObjectAspects> made = MakeObjectAspects(model);
  ASSERT_TRUE(made.ok());
  EXPECT_EQ(made->aspects.aspects.size(), 300u);
  EXPECT_LE(EncodeObjectAspects(*made, model).size(), 500000u);
}

TEST(AspectBlob, DamagedBytesAreDataLoss) {
  const ObjectModel model = Model();
  const std::string blob = EncodeObjectAspects(Made(model), model, Options());
  const auto code = [&](const std::string& bytes) {
    return DecodeObjectAspects(bytes, model, Options()).status().code();
  };
  for (std::size_t at = 24; at < blob.size(); at += 1 + blob.size() / 211) {
    std::string damaged = blob;
    damaged[at] = static_cast<char>(damaged[at] ^ 0x10);
    EXPECT_EQ(code(damaged), absl::StatusCode::kDataLoss) << at;
    EXPECT_EQ(code(blob.substr(0, at)), absl::StatusCode::kDataLoss) << at;
  }
  EXPECT_EQ(code(""), absl::StatusCode::kDataLoss);
  EXPECT_EQ(code(blob + "x"), absl::StatusCode::kDataLoss);
  std::string other = blob;
  other[0] = 'X';
  EXPECT_EQ(code(other), absl::StatusCode::kDataLoss);
}

TEST(AspectBlob, OfAnotherVersionGeometryOrOptionsIsToBeMadeAnew) {
  const ObjectModel model = Model();
  const std::string blob = EncodeObjectAspects(Made(model), model, Options());
  const auto code =
      [&](const std::string& bytes, const ObjectModel& of, const ObjectAspectOptions& options) {
        return DecodeObjectAspects(bytes, of, options).status().code();
      };
  std::string version = blob;
  version[4] = static_cast<char>(kAspectVersion + 1);
  EXPECT_EQ(code(version, model, Options()), absl::StatusCode::kFailedPrecondition);
  ObjectModel changed = model;
  changed.mesh.vertices[5].x() += 1e-6;
  EXPECT_EQ(code(blob, changed, Options()), absl::StatusCode::kFailedPrecondition);
  ObjectModel symmetric = model;
  symmetric.symmetries.emplace_back();
  EXPECT_EQ(code(blob, symmetric, Options()), absl::StatusCode::kFailedPrecondition);
  ObjectAspectOptions options = Options();
  options.aspects.max_points = 100;
  EXPECT_EQ(code(blob, model, options), absl::StatusCode::kFailedPrecondition);
}

}  // namespace
}  // namespace horopter
