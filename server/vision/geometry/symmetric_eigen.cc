#include "server/vision/geometry/symmetric_eigen.h"

#include <Eigen/Eigenvalues>

namespace horopter::internal {
namespace {

// The largest size that is solved without memory from the heap: those of the searches.
constexpr int kSmall = 9;

template <typename Matrix>
Eigen::ComputationInfo Solve(const double* matrix,
                             int size,
                             double* eigenvalues,
                             double* eigenvectors) {
  const Eigen::SelfAdjointEigenSolver<Matrix> solver(
      Matrix{Eigen::Map<const Eigen::MatrixXd>(matrix, size, size)});
  if (solver.info() != Eigen::InvalidInput) {
    Eigen::Map<Eigen::VectorXd>(eigenvalues, size) = solver.eigenvalues();
    Eigen::Map<Eigen::MatrixXd>(eigenvectors, size, size) = solver.eigenvectors();
  }
  return solver.info();
}

}  // namespace

Eigen::ComputationInfo SolveSymmetric(const double* matrix,
                                      int size,
                                      double* eigenvalues,
                                      double* eigenvectors) {
  using Small = Eigen::Matrix<double, Eigen::Dynamic, Eigen::Dynamic, 0, kSmall, kSmall>;
  return size <= kSmall ? Solve<Small>(matrix, size, eigenvalues, eigenvectors)
                        : Solve<Eigen::MatrixXd>(matrix, size, eigenvalues, eigenvectors);
}

}  // namespace horopter::internal
