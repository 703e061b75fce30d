#include "server/vision/euclidean/transform_graph.h"

#include <gtest/gtest.h>

#include <Eigen/Eigenvalues>
#include <Eigen/Geometry>
#include <random>

namespace horopter {
namespace {

struct Random {
  explicit Random(unsigned seed) : rng(seed) {}
  double Normal(double s) { return s * std::normal_distribution<double>()(rng); }
  Rigid3 Pose() {
    const Eigen::Quaterniond q(Normal(1), Normal(1), Normal(1), Normal(1));
    return {q.normalized().toRotationMatrix(), {Normal(0.3), Normal(0.3), Normal(0.3)}};
  }
  Vector6d Small(double s) {
    Vector6d d;
    for (int i = 0; i < 6; ++i) d(i) = Normal(s);
    return d;
  }
  std::mt19937 rng;
};

TEST(Perturbation, IsUndoneByItsDifference) {
  Random random(1);
  for (int i = 0; i < 100; ++i) {
    const Rigid3 pose = random.Pose();
    const Vector6d d = random.Small(0.3);
    EXPECT_LT((PerturbationBetween(pose, Perturbed(pose, d)) - d).norm(), 1e-9) << i;
  }
}

TEST(Perturbation, TravelsThroughProductsAndInversesToFirstOrder) {
  Random random(2);
  for (int i = 0; i < 100; ++i) {
    const Rigid3 a = random.Pose(), b = random.Pose();
    const Vector6d d = random.Small(1e-6), e = random.Small(1e-6);
    EXPECT_LT((PerturbationBetween(a * b, Perturbed(a, d) * Perturbed(b, e)) -
               FirstInProduct(a, b) * d - SecondInProduct(a) * e)
                  .norm(),
              1e-10);
    EXPECT_LT(
        (PerturbationBetween(a.Inverse(), Perturbed(a, d).Inverse()) - InInverse(a) * d).norm(),
        1e-10);
  }
}

TEST(TransformGraph, PosesComposeAlongThePathInBothDirections) {
  Random random(3);
  TransformGraph graph;
  for (const char* name : {"base", "camera", "scene", "part"}) graph.AddFrame(name);
  const Rigid3 bc = random.Pose(), sc = random.Pose(), sp = random.Pose();
  ASSERT_TRUE(graph.Connect(0, 1, bc).ok());
  ASSERT_TRUE(graph.Connect(2, 1, sc).ok());
  ASSERT_TRUE(graph.Connect(2, 3, sp).ok());
  const Rigid3 expected = bc * sc.Inverse() * sp;
  EXPECT_LT(PerturbationBetween(graph.Between(0, 3)->pose, expected).norm(), 1e-12);
  EXPECT_LT(PerturbationBetween(graph.Between(3, 0)->pose, expected.Inverse()).norm(), 1e-12);
  EXPECT_EQ(graph.Between(0, 3)->covariance, Matrix6d::Zero());
}

// The stated covariance against draws of the joint distribution, correlations included.
TEST(TransformGraph, CovarianceIsThatOfTheDraws) {
  constexpr unsigned kSeed = 4;
  Random random(kSeed);
  Eigen::MatrixXd root(12, 12);
  for (int i = 0; i < 144; ++i) root(i / 12, i % 12) = random.Normal(1e-3);
  const Eigen::MatrixXd joint = root * root.transpose();
  const Rigid3 ab = random.Pose(), cb = random.Pose();
  TransformGraph graph;
  for (int i = 0; i < 3; ++i) graph.AddFrame("f");
  const int first = graph.AddUncertainty(joint);
  ASSERT_TRUE(graph.Connect(0, 1, ab, first).ok());
  ASSERT_TRUE(graph.Connect(2, 1, cb, first + 6).ok());
  const UncertainPose stated = *graph.Between(0, 2);
  constexpr int kDraws = 20000;
  Matrix6d sampled = Matrix6d::Zero();
  for (int i = 0; i < kDraws; ++i) {
    Eigen::VectorXd z(12);
    for (int k = 0; k < 12; ++k) z(k) = random.Normal(1.0);
    const Eigen::VectorXd d = root * z;
    const Rigid3 drawn = Perturbed(ab, d.head<6>()) * Perturbed(cb, d.tail<6>()).Inverse();
    const Vector6d e = PerturbationBetween(stated.pose, drawn);
    sampled += e * e.transpose() / kDraws;
  }
  EXPECT_LT((sampled - stated.covariance).norm(), 0.05 * stated.covariance.norm())
      << "seed " << kSeed;
}

// A part seen in its own frame by way of the same uncertain transform: the error cancels.
TEST(TransformGraph, SharedErrorsCancel) {
  Random random(5);
  TransformGraph graph;
  for (int i = 0; i < 3; ++i) graph.AddFrame("f");
  const int column = graph.AddUncertainty(1e-4 * Matrix6d::Identity());
  ASSERT_TRUE(graph.Connect(0, 1, random.Pose(), column).ok());
  ASSERT_TRUE(graph.Connect(1, 2, random.Pose()).ok());
  EXPECT_GT(graph.Between(0, 2)->covariance.norm(), 1e-5);
  EXPECT_EQ(graph.Between(1, 2)->covariance.norm(), 0.0);
  const Matrix6d cross = *graph.CrossCovariance(0, 1, 0, 2);
  EXPECT_LT((cross - (*graph.CrossCovariance(0, 2, 0, 1)).transpose()).norm(), 1e-15);
}

TEST(TransformGraph, ClosedLoopsAreRefusedAndTheirGapIsMeasured) {
  Random random(6);
  TransformGraph graph;
  for (int i = 0; i < 3; ++i) graph.AddFrame("f");
  const int column = graph.AddUncertainty(1e-6 * Matrix6d::Identity());
  const Rigid3 ab = random.Pose(), bc = random.Pose();
  ASSERT_TRUE(graph.Connect(0, 1, ab, column).ok());
  ASSERT_TRUE(graph.Connect(1, 2, bc).ok());
  EXPECT_EQ(graph.Connect(0, 2, ab * bc).code(), absl::StatusCode::kAlreadyExists);
  EXPECT_LT(graph.Gap(0, 1, ab)->chi_square, 1e-9);
  Vector6d d = Vector6d::Zero();
  d(3) = 0.01;  // ten sigmas
  EXPECT_NEAR(graph.Gap(0, 1, Perturbed(ab, d))->chi_square, 100.0, 1e-3);
}

TEST(TransformGraph, BadInputIsNamed) {
  TransformGraph graph;
  graph.AddFrame("a");
  graph.AddFrame("b");
  EXPECT_EQ(graph.Between(0, 1).status().code(), absl::StatusCode::kNotFound);
  EXPECT_EQ(graph.Between(0, 7).status().code(), absl::StatusCode::kNotFound);
  EXPECT_EQ(graph.Connect(0, 0, {}).code(), absl::StatusCode::kInvalidArgument);
  EXPECT_EQ(graph.Connect(0, 1, {}, 3).code(), absl::StatusCode::kInvalidArgument);
  Rigid3 bad;
  bad.t.x() = std::nan("");
  EXPECT_EQ(graph.Connect(0, 1, bad).code(), absl::StatusCode::kInvalidArgument);
}

}  // namespace
}  // namespace horopter
