#include "server/vision/recognition/initialization/decomposition.h"

#include <gtest/gtest.h>

#include <Eigen/Dense>
#include <algorithm>
#include <random>

#include "tests/support/collineated_scene.h"

namespace horopter {
namespace {

Eigen::Matrix3d RandomMatrix(std::mt19937* rng) {
  std::normal_distribution<double> n;
  Eigen::Matrix3d A;
  for (int i = 0; i < 9; ++i) A(i / 3, i % 3) = n(*rng);
  return A;
}

TEST(PolarDecomposition, RotationTimesSymmetricAndTheNearestRotation) {
  std::mt19937 rng(1);
  for (int i = 0; i < 200; ++i) {
    Eigen::Matrix3d A = RandomMatrix(&rng);
    if (A.determinant() < 0) A.col(0) *= -1.0;
    const auto polar = PolarDecomposition(A);
    ASSERT_TRUE(polar.has_value()) << i;
    EXPECT_LT((polar->Q * polar->S - A).norm(), 1e-10);
    EXPECT_LT((polar->Q.transpose() * polar->Q - Eigen::Matrix3d::Identity()).norm(), 1e-12);
    EXPECT_NEAR(polar->Q.determinant(), 1.0, 1e-12);
    const Eigen::JacobiSVD<Eigen::Matrix3d> svd(A, Eigen::ComputeFullU | Eigen::ComputeFullV);
    EXPECT_LT((polar->Q - svd.matrixU() * svd.matrixV().transpose()).norm(), 1e-9);
  }
  EXPECT_FALSE(PolarDecomposition(Eigen::Matrix3d::Zero()));
  EXPECT_FALSE(PolarDecomposition(-Eigen::Matrix3d::Identity()));
  EXPECT_FALSE(PolarDecomposition(Eigen::Matrix3d::Constant(std::nan(""))));
}

double Median(std::vector<double> v) {
  std::nth_element(v.begin(), v.begin() + static_cast<long>(v.size() / 2), v.end());
  return v[v.size() / 2];
}

TEST(Decomposition, ExactWithoutNoise) {
  const auto scene = MakeCollineatedScene(3, 3, 6, 0.0);
  ASSERT_TRUE(scene.has_value());
  for (const auto& d : {DecomposePerObject(scene->objects), DecomposeCommon(scene->objects)}) {
    ASSERT_TRUE(d.ok()) << d.status();
    for (int k = 1; k < 3; ++k) {
      const BetweenError e = ErrorBetween(*scene, d->metric_from_object, k);
      EXPECT_LT(e.shift_m, 1e-4);
      EXPECT_LT(e.turn_rad, 1e-3);
    }
    for (const double s : d->stretch) EXPECT_NEAR(s, 1.0, 1e-2);
  }
}

// The order the thesis's chapter promises: a common upgrade beats one per object, cameras beat
// both.
TEST(Decomposition, EachMethodBeatsTheOneBefore) {
  std::vector<double> polar, common, on_points, joint;
  for (unsigned seed = 1; seed <= 10; ++seed) {
    const auto scene = MakeCollineatedScene(seed, 3, 6, 0.5);
    if (!scene) continue;
    const auto a = DecomposePerObject(scene->objects);
    const auto b = DecomposeCommon(scene->objects);
    ASSERT_TRUE(a.ok() && b.ok()) << "seed " << seed;
    const auto c = RefineInImages(scene->objects, scene->cameras, scene->observations, *b);
    ASSERT_TRUE(c.ok()) << "seed " << seed;
    const auto adjust = [&](std::span<const ObjectEdgeObservation> edges) {
      return AdjustJointly(scene->cameras, scene->sizes, scene->observations, edges, *c, 0.5);
    };
    const auto p = adjust({}), d = adjust(scene->edge_observations);
    ASSERT_TRUE(p.ok() && d.ok()) << "seed " << seed << " " << p.status() << d.status();
    for (int k = 1; k < 3; ++k) {
      polar.push_back(ErrorBetween(*scene, a->metric_from_object, k).shift_m);
      common.push_back(ErrorBetween(*scene, b->metric_from_object, k).shift_m);
      on_points.push_back(ErrorBetween(*scene, p->metric_from_object, k).shift_m);
      joint.push_back(ErrorBetween(*scene, d->metric_from_object, k).shift_m);
    }
  }
  ASSERT_GE(polar.size(), 14u);
  EXPECT_LT(Median(common), 0.7 * Median(polar));
  EXPECT_LT(Median(on_points), Median(common));
  EXPECT_LT(Median(joint), 0.85 * Median(on_points));
  EXPECT_LT(Median(joint), 0.0006);
}

TEST(Decomposition, DoesNotDependOnTheProjectiveFrame) {
  auto scene = MakeCollineatedScene(5, 3, 6, 0.5);
  ASSERT_TRUE(scene.has_value());
  const auto before = DecomposeCommon(scene->objects);
  ASSERT_TRUE(before.ok());
  Eigen::Matrix4d H;
  H << 1.2, 0.1, -0.2, 0.3, 0.0, 0.9, 0.2, -0.1, 0.1, 0.0, 1.1, 0.2, 0.05, -0.1, 0.02, 1.0;
  for (CollineatedObject& o : scene->objects) {
    o.scene_from_object = -2.0 * H * o.scene_from_object;
    for (auto& X : o.points_in_scene) X = H * X;
  }
  const auto after = DecomposeCommon(scene->objects);
  ASSERT_TRUE(after.ok());
  for (int k = 1; k < 3; ++k) {
    EXPECT_LT((before->metric_from_object[k].t - after->metric_from_object[k].t).norm(), 1e-5);
  }
}

TEST(Decomposition, TheNonlinearUpdateNeverFitsWorse) {
  for (unsigned seed = 11; seed <= 14; ++seed) {
    const auto scene = MakeCollineatedScene(seed, 2, 5, 1.0);
    if (!scene) continue;
    const auto start = DecomposeCommon(scene->objects);
    ASSERT_TRUE(start.ok());
    const auto refined = RefineDecomposition(scene->objects, *start);
    ASSERT_TRUE(refined.ok());
    EXPECT_LE(refined->rms_m, start->rms_m * (1 + 1e-9)) << "seed " << seed;
  }
}

// A part taken for a longer one: no rigid transform, and the stretch says so.
TEST(Decomposition, AnObjectThatIsSomethingElseIsStretched) {
  auto scene = MakeCollineatedScene(7, 3, 6, 0.2);
  ASSERT_TRUE(scene.has_value());
  const Eigen::Vector4d longer(1.25, 1.0, 1.0, 1.0);
  for (auto& x : scene->objects[2].points_in_object) x.x() *= 1.25;
  scene->objects[2].scene_from_object =
      scene->objects[2].scene_from_object * Eigen::Matrix4d(longer.cwiseInverse().asDiagonal());
  const auto d = DecomposePerObject(scene->objects);
  ASSERT_TRUE(d.ok()) << d.status();
  EXPECT_GT(d->stretch[2], 1.15);
  EXPECT_LT(d->stretch[1], 1.1);
}

TEST(Decomposition, UnusableInputIsNamed) {
  EXPECT_EQ(DecomposeCommon({}).status().code(), absl::StatusCode::kInvalidArgument);
  auto scene = MakeCollineatedScene(5, 2, 5, 0.3);
  ASSERT_TRUE(scene.has_value());
  auto few = scene->objects;
  few[1].points_in_object.resize(3);
  EXPECT_EQ(DecomposeCommon(few).status().code(), absl::StatusCode::kInvalidArgument);
  auto singular = scene->objects;
  singular[0].scene_from_object.row(2) = singular[0].scene_from_object.row(1);
  EXPECT_EQ(DecomposePerObject(singular).status().code(), absl::StatusCode::kFailedPrecondition);
  auto mirrored = scene->objects;
  mirrored[1].scene_from_object.col(0) *= -1.0;
  EXPECT_EQ(DecomposePerObject(mirrored).status().code(), absl::StatusCode::kFailedPrecondition);
}

}  // namespace
}  // namespace horopter
