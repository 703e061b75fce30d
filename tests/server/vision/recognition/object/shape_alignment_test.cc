#include "server/vision/recognition/object/shape_alignment.h"

#include <gtest/gtest.h>

#include <Eigen/Geometry>

#include "tests/support/solid_meshes.h"

namespace horopter {
namespace {

// A slab with two pegs of different height beside opposite corners: no plane halves it.
TriangleMesh Chiral() {
  TriangleMesh mesh = BoxMesh({0.05, 0.03, 0.01});
  Append(BoxMesh({0.008, 0.006, 0.012}), {0.036, 0.02, 0.022}, &mesh);
  Append(BoxMesh({0.012, 0.005, 0.005}), {-0.03, 0.02, 0.015}, &mesh);
  return mesh;
}

RenderMesh Rendered(const TriangleMesh& mesh) {
  return MakeRenderMesh(mesh).value();
}

TEST(ShapeAlignment, FindsHowACopyWasMoved) {
  const TriangleMesh mesh = Chiral();
  for (const double angle : {0.0, 0.4, 1.3, 2.9}) {
    SCOPED_TRACE(angle);
    const Rigid3 moved{
        Eigen::AngleAxisd(angle, Eigen::Vector3d(1, 2, -1).normalized()).toRotationMatrix(),
        Eigen::Vector3d(0.2, -0.1, 0.05)};
    TriangleMesh copy = mesh;
    for (auto& v : copy.vertices) v = moved * v;
    const auto found = AlignShapes(Rendered(mesh), Rendered(copy), 3);
    ASSERT_FALSE(found.empty());
    EXPECT_LT(found[0].distance, 0.02);
    const Rigid3 back = found[0].a_from_b * moved;
    EXPECT_LT((back.R - Eigen::Matrix3d::Identity()).norm(), 0.06);
    EXPECT_LT(back.t.norm(), 0.003);
  }
}

TEST(ShapeAlignment, SaysNothingOfPartsOfOtherProportions) {
  EXPECT_TRUE(
      AlignShapes(Rendered(BoxMesh({0.05, 0.03, 0.01})), Rendered(BoxMesh({0.05, 0.03, 0.02})), 3)
          .empty());
  EXPECT_TRUE(AlignShapes(RenderMesh{}, Rendered(Chiral()), 3).empty());
}

TEST(MirrorTwin, OnlyAPartThatNoMotionLaysOverItsImageHasOne) {
  const auto twin = [](const TriangleMesh& mesh) {
    const RenderMesh rendered = Rendered(mesh);
    return MakeMirrorTwin(mesh, rendered.diameter_m, rendered);
  };
  EXPECT_FALSE(twin(BoxMesh({0.05, 0.03, 0.01})).chiral);
  EXPECT_FALSE(twin(CylinderMesh(0.02, 0.04, 48)).chiral);
  // Halved by a plane that is none of the frame's.
  TriangleMesh wedge =
      SweptMesh({{-0.04, -0.02}, {0.04, -0.008}, {0.04, 0.008}, {-0.04, 0.02}}, 0.012);
  const Eigen::Matrix3d turn =
      Eigen::AngleAxisd(0.5, Eigen::Vector3d(1, 1, 1).normalized()).toRotationMatrix();
  for (auto& v : wedge.vertices) v = turn * v;
  EXPECT_FALSE(twin(wedge).chiral);
  const MirrorTwin chiral = twin(Chiral());
  EXPECT_TRUE(chiral.chiral);
  EXPECT_FALSE(chiral.alignments.empty());
  EXPECT_FALSE(chiral.mesh.triangles.empty());
}

TEST(MirrorImage, TwiceIsThePartAndStaysClosed) {
  const RenderMesh mesh = Rendered(Chiral());
  const RenderMesh twice = MirrorImage(MirrorImage(mesh));
  ASSERT_EQ(twice.vertices.size(), mesh.vertices.size());
  for (std::size_t i = 0; i < mesh.vertices.size(); ++i)
    EXPECT_LT((twice.vertices[i] - mesh.vertices[i]).norm(), 1e-6f);
  EXPECT_EQ(MirrorImage(mesh).closed, mesh.closed);
}

}  // namespace
}  // namespace horopter
