#include "server/vision/geometry/symmetry.h"

#include <gtest/gtest.h>

#include <Eigen/Geometry>
#include <cmath>
#include <random>

namespace horopter {
namespace {

// Prism over a polygon (counter-clockwise, convex or star-shaped about the origin) with all its
// edges.
ObjectModel Prism(const std::vector<Eigen::Vector2d>& polygon, double height) {
  ObjectModel model;
  const int n = static_cast<int>(polygon.size());
  for (const double z : {0.0, height}) {
    for (const auto& p : polygon) model.vertices.emplace_back(p.x(), p.y(), z);
  }
  const auto edge = [&](int a, int b) {
    model.edges.push_back(
        {CurveKind::kLine, a, b, M_PI / 2, {model.vertices[a], model.vertices[b]}});
  };
  model.mesh.vertices = model.vertices;
  model.mesh.vertices.emplace_back(0, 0, 0);
  model.mesh.vertices.emplace_back(0, 0, height);
  for (int i = 0; i < n; ++i) {
    const int j = (i + 1) % n;
    edge(i, j);
    edge(n + i, n + j);
    edge(i, n + i);
    model.mesh.triangles.insert(
        model.mesh.triangles.end(),
        {{2 * n, j, i}, {2 * n + 1, n + i, n + j}, {i, j, n + j}, {i, n + j, n + i}});
  }
  for (const auto& a : model.mesh.vertices) {
    for (const auto& b : model.mesh.vertices)
      model.diameter_m = std::max(model.diameter_m, (a - b).norm());
  }
  return model;
}

std::vector<Eigen::Vector2d> Regular(int n, double radius) {
  std::vector<Eigen::Vector2d> p;
  for (int i = 0; i < n; ++i) {
    p.emplace_back(radius * std::cos(2 * M_PI * i / n), radius * std::sin(2 * M_PI * i / n));
  }
  return p;
}

std::vector<Eigen::Vector2d> Rectangle(double x, double y) {
  return {{-x / 2, -y / 2}, {x / 2, -y / 2}, {x / 2, y / 2}, {-x / 2, y / 2}};
}

ObjectModel Moved(ObjectModel model, const Rigid3& motion) {
  for (auto& v : model.vertices) v = motion * v;
  for (auto& v : model.mesh.vertices) v = motion * v;
  for (auto& e : model.edges) {
    for (auto& p : e.polyline) p = motion * p;
  }
  return model;
}

Rigid3 RandomMotion(std::mt19937& rng) {
  std::normal_distribution<double> normal;
  Rigid3 motion;
  motion.R = Eigen::Quaterniond(normal(rng), normal(rng), normal(rng), normal(rng))
                 .normalized()
                 .toRotationMatrix();
  motion.t = {normal(rng), normal(rng), normal(rng)};
  return motion;
}

void ExpectGroup(const ObjectModel& model, std::vector<Rigid3> group) {
  group.push_back({});
  for (const Rigid3& a : group) {
    EXPECT_NEAR(a.R.determinant(), 1.0, 1e-9);
    for (const Rigid3& b : group) {
      const Rigid3 c = a * b;
      bool found = false;
      for (const Rigid3& d : group) {
        found =
            found || ((c.R - d.R).norm() < 1e-3 && (c.t - d.t).norm() < 1e-3 * model.diameter_m);
      }
      EXPECT_TRUE(found) << "not closed under composition";
    }
  }
}

TEST(Symmetry, KnownGroupsInAnyPose) {
  constexpr unsigned kSeed = 2;
  SCOPED_TRACE(testing::Message() << "seed " << kSeed);
  std::mt19937 rng(kSeed);
  const std::pair<ObjectModel, size_t> parts[] = {
      {Prism(Rectangle(0.04, 0.04), 0.04), 24},  // cube
      {Prism(Rectangle(0.04, 0.04), 0.02), 8},
      {Prism(Rectangle(0.04, 0.03), 0.02), 4},
      {Prism(Regular(3, 0.03), 0.02), 6},
      {Prism(Regular(5, 0.03), 0.02), 10},
      {Prism(Regular(6, 0.03), 0.02), 12},
      // L profile of equal legs: the diagonal half turn only
      {Prism(
           {{-0.01, -0.01}, {0.03, -0.01}, {0.03, 0.01}, {0.01, 0.01}, {0.01, 0.03}, {-0.01, 0.03}},
           0.02),
       2},
      // unequal legs: a mirror plane, which is no rotation
      {Prism(
           {{-0.01, -0.01}, {0.04, -0.01}, {0.04, 0.01}, {0.01, 0.01}, {0.01, 0.03}, {-0.01, 0.03}},
           0.02),
       1},
  };
  for (const auto& [part, order] : parts) {
    for (int i = 0; i < 4; ++i) {
      const ObjectModel model = i == 0 ? part : Moved(part, RandomMotion(rng));
      const auto symmetries = DeriveSymmetries(model);
      EXPECT_EQ(symmetries.size() + 1, order);
      ExpectGroup(model, symmetries);
    }
  }
}

// Every listed rotation carries vertices to vertices.
TEST(Symmetry, ElementsMapThePartOntoItself) {
  std::mt19937 rng(4);
  const ObjectModel model = Moved(Prism(Regular(6, 0.03), 0.02), RandomMotion(rng));
  for (const Rigid3& s : DeriveSymmetries(model)) {
    for (const Eigen::Vector3d& v : model.vertices) {
      double nearest = 1.0;
      for (const Eigen::Vector3d& w : model.vertices)
        nearest = std::min(nearest, (s * v - w).norm());
      EXPECT_LT(nearest, 1e-9);
    }
  }
}

// A corner moved by more than the tolerance breaks the symmetry, by less it does not.
// A disc with rings of holes: a pattern whose every turn must be compared with every edge.
TEST(Symmetry, RingsOfHolesTurnByOneHole) {
  constexpr int kHoles = 60, kRings = 8, kChords = 32;
  ObjectModel disc = Prism(Regular(kHoles, 0.1), 0.01);
  for (int i = 0; i < kHoles * kRings; ++i) {
    // Rings are shifted against each other: turned over, the pattern is another.
    const double angle = 2 * M_PI * (i + 0.2 * (i / kHoles)) / kHoles;
    const double radius = 0.03 + 0.008 * (i / kHoles);
    ModelEdge hole{CurveKind::kCircle, -1, -1, M_PI / 2, {}};
    for (int k = 0; k <= kChords; ++k) {
      const double turn = 2 * M_PI * k / kChords + angle;
      hole.polyline.emplace_back(radius * std::cos(angle) + 1.2e-3 * std::cos(turn),
                                 radius * std::sin(angle) + 1.2e-3 * std::sin(turn),
                                 0.01);
    }
    disc.edges.push_back(hole);
  }
  EXPECT_EQ(DeriveSymmetries(disc).size(), kHoles - 1u);
  disc.edges.resize(disc.edges.size() - 10);  // holes of the outer ring are not there
  EXPECT_EQ(DeriveSymmetries(disc).size(), 0u);
}

TEST(Symmetry, ToleranceDecides) {
  const auto dented = [](double share) {
    ObjectModel model = Prism(Rectangle(0.04, 0.03), 0.02);
    auto polygon = Rectangle(0.04, 0.03);
    polygon[0].x() -= share * model.diameter_m;
    return Prism(polygon, 0.02);
  };
  EXPECT_EQ(DeriveSymmetries(dented(0.0)).size(), 3u);
  EXPECT_EQ(DeriveSymmetries(dented(1e-4)).size(), 3u);
  EXPECT_LT(DeriveSymmetries(dented(0.01)).size(), 3u);
  SymmetryOptions loose;
  loose.tolerance = 0.02;
  EXPECT_EQ(DeriveSymmetries(dented(0.01), loose).size(), 3u);
}

// The edges alone can tell poses apart: one extra groove line on the top of a cube.
TEST(Symmetry, EdgesCountNotOnlyVertices) {
  ObjectModel model = Prism(Rectangle(0.04, 0.04), 0.04);
  const Eigen::Vector3d a(-0.01, 0, 0.04), b(0.01, 0, 0.04);
  model.edges.push_back({CurveKind::kOther, -1, -1, 1.0, {a, b, a}});
  EXPECT_EQ(DeriveSymmetries(model).size(), 1u);  // the half turn about z
}

TEST(Symmetry, HostileInputGivesNone) {
  EXPECT_TRUE(DeriveSymmetries({}).empty());
  ObjectModel flat;
  flat.mesh.vertices = {{0, 0, 0}, {1, 0, 0}, {2, 0, 0}};
  flat.mesh.triangles = {{0, 1, 2}};
  flat.diameter_m = 2.0;
  EXPECT_LE(DeriveSymmetries(flat).size(), 71u);
  ObjectModel unset = Prism(Regular(4, 0.03), 0.02);
  unset.diameter_m = 0.0;
  EXPECT_TRUE(DeriveSymmetries(unset).empty());
}

TEST(CompareSymmetriesTest, CountsWhatOnlyOneSideHas) {
  const ObjectModel model = Prism(Regular(4, 0.02), 0.05);
  const std::vector<Rigid3> derived = DeriveSymmetries(model);
  const auto differences = [&](const std::vector<Rigid3>& declared) {
    const SymmetryDifference d = CompareSymmetries(declared, derived, model);
    return std::pair(d.only_declared, d.only_derived);
  };
  std::vector<Rigid3> declared(derived.rbegin(), derived.rend());
  EXPECT_EQ(differences(declared), std::pair(0, 0));
  for (Rigid3& s : declared) s.t.x() += 1e-5;  // rounded in a file
  EXPECT_EQ(differences(declared), std::pair(0, 0));
  declared.pop_back();
  EXPECT_EQ(differences(declared), std::pair(0, 1));
  Rigid3 sixth;
  sixth.R = Eigen::AngleAxisd(M_PI / 3, Eigen::Vector3d::UnitZ()).toRotationMatrix();
  declared.push_back(sixth);
  EXPECT_EQ(differences(declared), std::pair(1, 1));
}

}  // namespace
}  // namespace horopter
