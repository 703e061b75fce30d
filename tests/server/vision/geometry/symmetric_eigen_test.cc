#include "server/vision/geometry/symmetric_eigen.h"

#include <gtest/gtest.h>

#include <Eigen/Eigenvalues>
#include <cmath>
#include <cstring>
#include <limits>
#include <random>

namespace horopter {
namespace {

template <typename A, typename B>
bool SameBytes(const A& a, const B& b) {
  return a.size() == b.size() && std::memcmp(a.data(), b.data(), a.size() * sizeof(double)) == 0;
}

// Of full rank, of one eigenvalue that is zero, of entries of very different size, in turn.
Eigen::MatrixXd Drawn(int size, int run, std::mt19937_64& random) {
  std::normal_distribution<double> normal;
  Eigen::MatrixXd a(size, size);
  for (double& x : a.reshaped()) x = normal(random) * std::pow(10.0, (run % 4) * normal(random));
  if (run % 3 == 0) a.row(size - 1).setZero();
  return run % 2 == 0 ? Eigen::MatrixXd(a * a.transpose()) : Eigen::MatrixXd(a + a.transpose());
}

// Searches and refinements are to be what they were with Eigen's own sizes.
template <int kSize>
void ExpectEigensBytes(int size) {
  std::mt19937_64 random(size);
  for (int run = 0; run < 300; ++run) {
    const typename SymmetricEigen<kSize>::Matrix matrix = Drawn(size, run, random);
    const Eigen::SelfAdjointEigenSolver<typename SymmetricEigen<kSize>::Matrix> expected(matrix);
    const SymmetricEigen<kSize> found(matrix);
    ASSERT_EQ(found.info(), Eigen::Success);
    ASSERT_TRUE(SameBytes(found.eigenvalues(), expected.eigenvalues())) << size << ", " << run;
    ASSERT_TRUE(SameBytes(found.eigenvectors(), expected.eigenvectors())) << size << ", " << run;
  }
}

TEST(SymmetricEigenTest, GivesTheBytesOfEigensFixedSizes) {
  ExpectEigensBytes<4>(4);
  ExpectEigensBytes<6>(6);
  ExpectEigensBytes<9>(9);
}

TEST(SymmetricEigenTest, GivesTheBytesOfEigensDynamicSize) {
  for (const int size : {1, 2, 3, 4, 8, 9, 10, 12, 27}) ExpectEigensBytes<Eigen::Dynamic>(size);
}

TEST(SymmetricEigenTest, SaysThatWhatIsNoNumberDoesNotConverge) {
  Eigen::Matrix4d matrix = Eigen::Matrix4d::Identity();
  matrix(2, 1) = std::numeric_limits<double>::quiet_NaN();
  EXPECT_EQ(SymmetricEigen<4>(matrix).info(),
            Eigen::SelfAdjointEigenSolver<Eigen::Matrix4d>(matrix).info());
}

}  // namespace
}  // namespace horopter
