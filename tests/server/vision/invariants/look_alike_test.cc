#include "server/vision/invariants/look_alike.h"

#include <gtest/gtest.h>

#include <Eigen/Geometry>

#include "tests/server/vision/invariants/random_space.h"

namespace horopter {
namespace {

// Over an L with a cut corner: no symmetry, 14 corners.
ObjectModel LPart() {
  const std::vector<Eigen::Vector2d> profile{
      {0, 0}, {0.06, 0}, {0.06, 0.012}, {0.02, 0.02}, {0.02, 0.03}, {0.015, 0.045}, {0, 0.045}};
  ObjectModel m;
  const int n = static_cast<int>(profile.size());
  for (const double z : {0.0, 0.025}) {
    // Drafted: the top is smaller, or mirror images would be the part itself.
    const Eigen::Vector2d draft(z > 0.0 ? 0.9 : 1.0, z > 0.0 ? 0.8 : 1.0);
    for (const auto& p : profile) m.vertices.emplace_back(p.x() * draft.x(), p.y() * draft.y(), z);
  }
  const auto edge = [&](int a, int b) {
    ModelEdge e;
    e.start_vertex = a;
    e.end_vertex = b;
    e.polyline = {m.vertices[a], m.vertices[b]};
    m.edges.push_back(e);
  };
  for (int i = 0; i < n; ++i) {
    edge(i, (i + 1) % n);
    edge(n + i, n + (i + 1) % n);
    edge(i, n + i);
  }
  m.diameter_m = 0.08;
  return m;
}

ObjectModel Mapped(ObjectModel m, const Eigen::Matrix4d& map) {
  for (Eigen::Vector3d& v : m.vertices) v = (map * v.homogeneous()).hnormalized();
  m.diameter_m = 0.0;
  for (const auto& a : m.vertices) {
    for (const auto& b : m.vertices) m.diameter_m = std::max(m.diameter_m, (a - b).norm());
  }
  return m;
}

Eigen::Matrix4d Rigid(RandomSpace& space) {
  Eigen::Matrix4d m = Eigen::Matrix4d::Identity();
  m.topLeftCorner<3, 3>() =
      Eigen::Quaterniond(Eigen::Vector4d(space.Noise(4)).normalized()).toRotationMatrix();
  m.topRightCorner<3, 1>() = 0.1 * space.Noise(3);
  return m;
}

LookAlikeKind KindOf(const Eigen::Matrix4d& map) {
  const ObjectModel a = LPart(), b = Mapped(a, map);
  const auto found = FindLookAlike(a, b);
  EXPECT_TRUE(found.has_value());
  if (!found) return LookAlikeKind::kCongruent;
  EXPECT_EQ(found->matched, 14);
  for (const Eigen::Vector3d& v : a.vertices) {
    const Eigen::Vector3d expected = (map * v.homogeneous()).hnormalized();
    EXPECT_LT(((found->b_from_a * v.homogeneous()).hnormalized() - expected).norm(), 1e-8);
  }
  return found->kind;
}

TEST(LookAlikeTest, NamesTheSmallestGroupThatMapsOnePartToTheOther) {
  RandomSpace space(51);
  Eigen::Matrix4d scale = Eigen::Matrix4d::Identity(), stretch = scale, mirror = scale;
  scale.diagonal().head<3>().setConstant(1.7);
  stretch(2, 2) = 1.4;
  mirror(0, 0) = -1.0;
  Eigen::Matrix4d bend = Eigen::Matrix4d::Identity();
  bend.row(3) << 3.0, 2.0, 4.0, 1.0;  // 1 / metre: depth changes by a quarter over the part
  EXPECT_EQ(KindOf(Rigid(space)), LookAlikeKind::kCongruent);
  EXPECT_EQ(KindOf(Rigid(space) * scale), LookAlikeKind::kSimilar);
  EXPECT_EQ(KindOf(Rigid(space) * mirror), LookAlikeKind::kMirror);
  EXPECT_EQ(KindOf(Rigid(space) * stretch), LookAlikeKind::kAffine);
  EXPECT_EQ(KindOf(Rigid(space) * bend), LookAlikeKind::kProjective);
}

TEST(LookAlikeTest, TellsWhichVerticesDiffer) {
  const ObjectModel a = LPart();
  ObjectModel b = a;
  b.vertices[5] += Eigen::Vector3d(0.006, 0, 0);
  b.vertices[12] += Eigen::Vector3d(0.006, 0, 0);
  const auto found = FindLookAlike(a, b);
  ASSERT_TRUE(found);
  EXPECT_EQ(found->kind, LookAlikeKind::kCongruent);
  EXPECT_EQ(found->only_in_a, (std::vector<int>{5, 12}));
  EXPECT_EQ(found->only_in_b, (std::vector<int>{5, 12}));
}

TEST(LookAlikeTest, DifferentPartsAreNot) {
  RandomSpace space(52);
  const ObjectModel a = LPart();
  ObjectModel b = a;
  for (Eigen::Vector3d& v : b.vertices) v += 0.01 * space.Noise(3);
  EXPECT_FALSE(FindLookAlike(a, b));
  b.vertices.resize(4);
  b.edges.clear();
  EXPECT_FALSE(FindLookAlike(a, b));
}

}  // namespace
}  // namespace horopter
