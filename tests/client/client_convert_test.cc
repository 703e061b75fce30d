#include <gtest/gtest.h>

#include <Eigen/Geometry>
#include <random>

#include "client/api_stubs.h"
#include "client/cad_import.h"
#include "client/convert.h"
#include "tests/client/mesh_samples.h"
#include "tests/client/temp_folder.h"

namespace horopter {
namespace {

TEST(Convert, TransformsSurviveTheWire) {
  constexpr unsigned kSeed = 9;
  SCOPED_TRACE(testing::Message() << "seed " << kSeed);
  std::mt19937 rng(kSeed);
  std::normal_distribution<double> normal;
  for (int i = 0; i < 200; ++i) {
    Rigid3 a;
    a.R = Eigen::Quaterniond(normal(rng), normal(rng), normal(rng), normal(rng))
              .normalized()
              .toRotationMatrix();
    a.t = {normal(rng), normal(rng), normal(rng)};
    const v1::RigidTransform wire = ToProto(a);
    EXPECT_GE(wire.rotation().w(), 0.0);
    const Rigid3 b = FromProto(wire);
    EXPECT_NEAR((a.R - b.R).norm() + (a.t - b.t).norm(), 0.0, 1e-12);
  }
  EXPECT_EQ(FromProto(v1::RigidTransform()).R, Eigen::Matrix3d::Identity());
}

TEST(Convert, ModelsSurviveTheWire) {
  const TempFolder folder;
  ObjectModel model =
      ImportCad(folder.Write("c.ply", AsPly(Prism(RegularPolygon(24, 20), 15))))->model;
  const ObjectModel box = ImportCad(folder.Write("b.ply", AsPly(Box(40, 30, 20))))->model;
  for (ObjectModel m : {model, box}) {
    m.display_name = "part";
    m.grasps = {{"g", {}, 0.05, 0.04, 0.0}};
    v1::Object wire = ToProto(m);
    wire.set_name(ResourceName("part_1"));
    const ObjectModel back = FromProto(wire);
    EXPECT_EQ(back.id, "part_1");
    EXPECT_EQ(back.vertices, m.vertices);
    ASSERT_EQ(back.edges.size(), m.edges.size());
    for (size_t i = 0; i < m.edges.size(); ++i) {
      EXPECT_EQ(back.edges[i].polyline, m.edges[i].polyline);
      EXPECT_EQ(back.edges[i].kind, m.edges[i].kind);
      EXPECT_EQ(back.edges[i].start_vertex, m.edges[i].start_vertex);
      EXPECT_EQ(back.edges[i].dihedral_rad, m.edges[i].dihedral_rad);
    }
    EXPECT_EQ(back.mesh.triangles, m.mesh.triangles);
    EXPECT_EQ(back.symmetries.size(), m.symmetries.size());
    EXPECT_EQ(back.grasps[0].quality, 0.0);
    EXPECT_EQ(back.diameter_m, m.diameter_m);
  }
}

TEST(Convert, BrokenMessagesLeaveOutWhatIsBroken) {
  v1::Object wire;
  wire.mutable_mesh()->add_vertices_m(1.0);
  for (const int i : {0, 1, 2, 7}) wire.mutable_mesh()->add_triangles(i);
  wire.add_edges()->add_polyline_m(1.0);
  const ObjectModel model = FromProto(wire);
  EXPECT_TRUE(model.mesh.vertices.empty());
  EXPECT_TRUE(model.mesh.triangles.empty());
  EXPECT_TRUE(model.edges.empty());
}

TEST(ClientErrors, OnlyWhatGrpcBrokeOffForMemoryIsTakenForIt) {
  using grpc::StatusCode;
  const std::string broken = "Received RST_STREAM with error code 11";
  EXPECT_TRUE(BrokenOffForMemory({StatusCode::RESOURCE_EXHAUSTED, broken}));
  EXPECT_FALSE(BrokenOffForMemory({StatusCode::INTERNAL, broken}));
  EXPECT_FALSE(BrokenOffForMemory({StatusCode::RESOURCE_EXHAUSTED, "the queue is full"}));
  EXPECT_FALSE(BrokenOffForMemory(
      {StatusCode::RESOURCE_EXHAUSTED, "Received message larger than max (9 vs. 8)"}));
}

}  // namespace
}  // namespace horopter
