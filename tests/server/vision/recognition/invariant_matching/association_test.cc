#include "server/vision/recognition/invariant_matching/association.h"

#include <gtest/gtest.h>

#include <Eigen/Dense>
#include <algorithm>
#include <limits>
#include <numeric>

#include "tests/support/profile_parts.h"
#include "tests/support/random.h"

namespace horopter {
namespace {

Eigen::Matrix4d RandomCollineation(Random* random) {
  Eigen::Matrix4d H = Eigen::Matrix4d::Identity();
  for (int i = 0; i < 16; ++i) H.data()[i] += 0.25 * random->Normal();
  H.row(3) = Eigen::RowVector4d(
      0.2 * random->Uniform(-1, 1), 0.2 * random->Uniform(-1, 1), 0.2 * random->Uniform(-1, 1), 1);
  return H;
}

// The vertices of a shape under H as the points of a structure, in order; noise of each coordinate.
SceneStructure Structure(const ObjectShape& shape,
                         const Eigen::Matrix4d& H,
                         double noise,
                         Random* random) {
  SceneStructure out;
  for (const auto& v : shape.vertices) {
    out.points.push_back((H * v.homogeneous()).hnormalized() +
                         noise *
                             Eigen::Vector3d(random->Normal(), random->Normal(), random->Normal()));
  }
  return out;
}

std::vector<VertexMatch> AllPairs(int n) {
  std::vector<VertexMatch> out;
  for (int k = 0; k < n; ++k) out.push_back({k, k});
  return out;
}

double Misfit(const Eigen::Matrix4d& H, const ObjectShape& shape, const SceneStructure& structure) {
  double worst = 0.0;
  for (int k = 0; k < shape.size(); ++k) {
    const Eigen::Vector3d x = (H * shape.vertices[k].homogeneous()).hnormalized();
    worst = std::max(worst, (x - structure.points[k]).norm());
  }
  return worst;
}

TEST(FitTransform, OfExactPointsIsExact) {
  for (unsigned seed = 1; seed <= 20; ++seed) {
    SCOPED_TRACE(testing::Message() << "seed " << seed);
    Random random(seed);
    const ObjectShape shape = ShapeOf(ProfilePart(seed));
    const Eigen::Matrix4d H = RandomCollineation(&random);
    const SceneStructure structure = Structure(shape, H, 0.0, &random);
    const auto fit =
        FitTransform(TransformGroup::kCollineation, structure, shape, AllPairs(shape.size()), {});
    ASSERT_TRUE(fit.ok()) << fit.status();
    EXPECT_LT(Misfit(*fit, shape, structure), 1e-6);
  }
}

TEST(FitTransform, OfEdgesAloneIsExact) {
  for (unsigned seed = 1; seed <= 10; ++seed) {
    SCOPED_TRACE(testing::Message() << "seed " << seed);
    Random random(seed);
    const ObjectShape shape = ShapeOf(ProfilePart(seed));
    const Eigen::Matrix4d H = RandomCollineation(&random);
    SceneStructure structure = Structure(shape, H, 0.0, &random);
    std::vector<EdgeMatch> edges;
    for (int e = 0; e < static_cast<int>(shape.edges.size()); ++e) {
      const auto& [a, b] = shape.edges[e];
      structure.lines.push_back(JoinPoints(Eigen::Vector4d(structure.points[a].homogeneous()),
                                           Eigen::Vector4d(structure.points[b].homogeneous())));
      edges.push_back({e, e});
    }
    const auto fit = FitTransform(TransformGroup::kCollineation, structure, shape, {}, edges);
    ASSERT_TRUE(fit.ok()) << fit.status();
    EXPECT_LT(Misfit(*fit, shape, structure), 1e-5);
  }
}

TEST(FitTransform, ErrorGrowsWithNoiseInProportion) {
  for (const double noise : {1e-5, 1e-4, 1e-3}) {
    std::vector<double> worst;
    for (unsigned seed = 1; seed <= 20; ++seed) {
      Random random(seed);
      const ObjectShape shape = ShapeOf(ProfilePart(seed));
      const Eigen::Matrix4d H = RandomCollineation(&random);
      const SceneStructure exact = Structure(shape, H, 0.0, &random);
      const SceneStructure noisy = Structure(shape, H, noise, &random);
      const auto fit =
          FitTransform(TransformGroup::kCollineation, noisy, shape, AllPairs(shape.size()), {});
      ASSERT_TRUE(fit.ok());
      worst.push_back(Misfit(*fit, shape, exact));
    }
    std::sort(worst.begin(), worst.end());
    EXPECT_LT(worst[10], 8.0 * noise) << "noise " << noise;
  }
}

TEST(FitTransform, SimilarityKeepsAnglesAndHandedness) {
  Random random(3);
  const ObjectShape shape = ShapeOf(ProfilePart(3));
  Eigen::Matrix4d S = Eigen::Matrix4d::Identity();
  S.topLeftCorner<3, 3>() =
      0.7 * Eigen::AngleAxisd(1.1, Eigen::Vector3d(1, 2, 3).normalized()).toRotationMatrix();
  S.topRightCorner<3, 1>() = Eigen::Vector3d(0.3, -0.2, 0.5);
  const SceneStructure structure = Structure(shape, S, 0.0, &random);
  const std::vector<VertexMatch> few = {{0, 0}, {1, 1}, {2, 2}, {7, 7}};
  const auto fit = FitTransform(TransformGroup::kSimilarity, structure, shape, few, {});
  ASSERT_TRUE(fit.ok()) << fit.status();
  EXPECT_LT((*fit - S).norm(), 1e-9);
  const auto rigid = FitTransform(TransformGroup::kCongruence, structure, shape, few, {}, 0.7);
  ASSERT_TRUE(rigid.ok()) << rigid.status();
  EXPECT_LT((*rigid - S).norm(), 1e-9);
}

TEST(FitTransform, RefusesWhatDeterminesNothing) {
  Random random(5);
  const ObjectShape shape = ShapeOf(ProfilePart(5));
  SceneStructure structure = Structure(shape, Eigen::Matrix4d::Identity(), 0.0, &random);
  const auto code = [&](std::vector<VertexMatch> matches, TransformGroup group) {
    return FitTransform(group, structure, shape, matches, {}).status().code();
  };
  constexpr auto kCollineation = TransformGroup::kCollineation;
  constexpr auto kFailed = absl::StatusCode::kFailedPrecondition;
  constexpr auto kInvalid = absl::StatusCode::kInvalidArgument;
  EXPECT_EQ(code({{0, 0}, {1, 1}, {2, 2}, {3, 3}}, kCollineation), kFailed);
  // The vertices of the lower cap: a plane.
  std::vector<VertexMatch> flat;
  for (int k = 0; k < shape.size(); ++k) {
    if (std::abs(shape.vertices[k].z() - shape.vertices[0].z()) < 1e-9) flat.push_back({k, k});
  }
  ASSERT_GE(flat.size(), 4u);
  EXPECT_EQ(code(flat, kCollineation), kFailed);
  EXPECT_EQ(code({{0, 0}, {1, 1}}, TransformGroup::kSimilarity), kFailed);
  EXPECT_EQ(code({{0, 0}, {0, 1}, {2, 2}, {3, 3}, {4, 4}}, kCollineation), kInvalid);
  EXPECT_EQ(code({{0, 0}, {1, 0}, {2, 2}, {3, 3}, {4, 4}}, kCollineation), kInvalid);
  EXPECT_EQ(code({{0, 99}}, kCollineation), kInvalid);
  EXPECT_EQ(code({{-1, 0}}, kCollineation), kInvalid);
  structure.points[0].x() = std::numeric_limits<double>::quiet_NaN();
  EXPECT_EQ(code(AllPairs(shape.size()), kCollineation), kInvalid);
}

TEST(CollineationFromBasis, IsExactOnExactPointsAndRefusesPlanes) {
  for (unsigned seed = 1; seed <= 20; ++seed) {
    SCOPED_TRACE(testing::Message() << "seed " << seed);
    Random random(seed);
    const Eigen::Matrix4d H = RandomCollineation(&random);
    std::vector<Eigen::Vector4d> from, to;
    for (int k = 0; k < 6; ++k) {
      from.emplace_back(random.Normal(), random.Normal(), random.Normal(), 1.0);
      to.push_back((k % 2 == 0 ? 3.0 : -0.5) * H * from.back());
    }
    for (const std::size_t n : {5u, 6u}) {
      const auto fit = CollineationFromBasis(std::span(from.data(), n), std::span(to.data(), n));
      ASSERT_TRUE(fit.ok()) << fit.status();
      const Eigen::Matrix4d expected = H / H.norm();
      EXPECT_LT(std::min((*fit - expected).norm(), (*fit + expected).norm()), 1e-7);
    }
    from[3] = from[0] + from[1] - from[2];
    EXPECT_EQ(CollineationFromBasis(from, to).status().code(),
              absl::StatusCode::kFailedPrecondition);
    EXPECT_EQ(
        CollineationFromBasis(std::span(from.data(), 4), std::span(to.data(), 4)).status().code(),
        absl::StatusCode::kInvalidArgument);
  }
}

TEST(MaximumAssignment, IsTheBestOfAllPermutations) {
  for (unsigned seed = 1; seed <= 50; ++seed) {
    SCOPED_TRACE(testing::Message() << "seed " << seed);
    Random random(seed);
    const int rows = 2 + static_cast<int>(seed % 4), columns = 2 + static_cast<int>(seed % 3);
    Eigen::MatrixXd value(rows, columns);
    for (Eigen::Index i = 0; i < value.size(); ++i) {
      value.data()[i] = random.Uniform(0, 1) < 0.3 ? 0.0 : random.Uniform(0, 1);
    }
    std::vector<int> order(std::max(rows, columns));
    std::iota(order.begin(), order.end(), 0);
    double best = 0.0;
    do {
      double sum = 0.0;
      for (int r = 0; r < rows; ++r) sum += order[r] < columns ? value(r, order[r]) : 0.0;
      best = std::max(best, sum);
    } while (std::next_permutation(order.begin(), order.end()));
    double found = 0.0;
    const std::vector<int> column_of = MaximumAssignment(value);
    for (int r = 0; r < rows; ++r) found += column_of[r] >= 0 ? value(r, column_of[r]) : 0.0;
    EXPECT_NEAR(found, best, 1e-12);
  }
}

TEST(AssociationTable, OutvotesWrongLabelsClutterAndMissingVertices) {
  for (unsigned seed = 1; seed <= 20; ++seed) {
    SCOPED_TRACE(testing::Message() << "seed " << seed);
    Random random(seed);
    constexpr int kVertices = 14,
                  kPoints = 16;  // vertex v is point v; 10 - 13 missing, 14, 15 clutter
    AssociationTable table(kPoints, kVertices);
    for (int tuple = 0; tuple < 60; ++tuple) {
      std::vector<VertexMatch> pairs;
      const bool wrong = random.Uniform(0, 1) < 0.5;
      for (int k = 0; k < 6; ++k) {
        const int point = wrong ? random.Index(kPoints) : random.Index(10);
        pairs.push_back({wrong ? random.Index(kVertices) : point, point});
      }
      table.Add(pairs, 1.0);
    }
    const std::vector<VertexMatch> assigned = table.Assign(0.3 * table.votes().maxCoeff());
    int right = 0;
    for (const VertexMatch& m : assigned) right += m.vertex == m.point && m.point < 10;
    EXPECT_EQ(right, 10);
    EXPECT_LE(assigned.size(), 12u);
  }
}

TEST(FindConsistentMatches, LeavesOutWrongPairs) {
  for (unsigned seed = 1; seed <= 20; ++seed) {
    SCOPED_TRACE(testing::Message() << "seed " << seed);
    Random random(seed);
    const ObjectShape shape = ShapeOf(ProfilePart(seed, {1.0, 1.0}));
    const SceneStructure structure = Structure(shape, RandomCollineation(&random), 1e-3, &random);
    std::vector<VertexMatch> pairs = AllPairs(shape.size());
    // A quarter of them is exchanged in a ring.
    const int wrong = shape.size() / 4;
    for (int k = 0; k < wrong; ++k) pairs[k].vertex = (k + 1) % wrong;
    const auto found = FindConsistentMatches(
        TransformGroup::kCollineation, structure, shape, pairs, {.reach = 0.03, .draws = 400});
    ASSERT_TRUE(found.ok()) << found.status();
    int right = 0;
    for (const VertexMatch& m : found->matches) right += m.vertex == m.point;
    EXPECT_EQ(right, shape.size() - wrong);
  }
}

TEST(AssociateByAxes, FindsThePermutationOfExactPoints) {
  int right = 0;
  for (unsigned seed = 1; seed <= 20; ++seed) {
    Random random(seed);
    std::array<Eigen::Vector4d, 6> vertices, points;
    const Eigen::Matrix4d H = RandomCollineation(&random);
    const std::array<int, 6> order{3, 1, 5, 0, 2, 4};
    for (auto& v : vertices) v = {random.Normal(), random.Normal(), random.Normal(), 1.0};
    for (int k = 0; k < 6; ++k) points[k] = H * vertices[order[k]];
    const auto found = AssociateByAxes(points, vertices, 1e-6);
    ASSERT_TRUE(found.ok());
    right += *found == order;
  }
  EXPECT_EQ(right, 20);
  std::array<Eigen::Vector4d, 6> bad;
  bad.fill(Eigen::Vector4d::Constant(std::numeric_limits<double>::infinity()));
  EXPECT_EQ(AssociateByAxes(bad, bad, 0.1).status().code(), absl::StatusCode::kInvalidArgument);
}

}  // namespace
}  // namespace horopter
