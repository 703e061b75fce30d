// Eigen's solver of symmetric eigenproblems, compiled once for the sizes that several files use:
// each takes a compiler some six seconds, and none in a file that includes this. Expressions are
// evaluated before they are given to it: each kind of them would be compiled again.
#pragma once

#include <Eigen/Eigenvalues>

namespace horopter {

template <int kSize>
using SymmetricEigen = Eigen::SelfAdjointEigenSolver<Eigen::Matrix<double, kSize, kSize>>;

}  // namespace horopter

#define HOROPTER_SYMMETRIC_EIGEN(size)                                                 \
  template horopter::SymmetricEigen<size>&                                             \
  horopter::SymmetricEigen<size>::compute<horopter::SymmetricEigen<size>::MatrixType>( \
      const Eigen::EigenBase<horopter::SymmetricEigen<size>::MatrixType>&, int)

extern HOROPTER_SYMMETRIC_EIGEN(4);
extern HOROPTER_SYMMETRIC_EIGEN(6);
extern HOROPTER_SYMMETRIC_EIGEN(9);
extern HOROPTER_SYMMETRIC_EIGEN(Eigen::Dynamic);
