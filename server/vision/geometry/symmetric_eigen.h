// Eigen's solver of symmetric eigenproblems, compiled once: each of its sizes takes a compiler some
// six seconds, and each kind of expression given to it again.
#pragma once

#include <Eigen/Core>

namespace horopter {
namespace internal {

// Of the symmetric `size` x `size` matrix at `matrix`, of which the lower half is read: eigenvalues
// in rising order, and eigenvectors of norm one, column by column. All by columns without gaps.
Eigen::ComputationInfo SolveSymmetric(const double* matrix,
                                      int size,
                                      double* eigenvalues,
                                      double* eigenvectors);

}  // namespace internal

// As Eigen::SelfAdjointEigenSolver, and the same bytes. Of three rows and fewer Eigen has other
// formulae: those are used as they are.
template <int kSize>
class SymmetricEigen {
 public:
  static_assert(kSize == Eigen::Dynamic || kSize > 3);
  using Matrix = Eigen::Matrix<double, kSize, kSize>;
  using Vector = Eigen::Matrix<double, kSize, 1>;

  explicit SymmetricEigen(const Matrix& matrix)
      : eigenvalues_(matrix.rows()), eigenvectors_(matrix.rows(), matrix.rows()) {
    info_ = internal::SolveSymmetric(
        matrix.data(), static_cast<int>(matrix.rows()), eigenvalues_.data(), eigenvectors_.data());
  }

  Eigen::ComputationInfo info() const { return info_; }
  const Vector& eigenvalues() const { return eigenvalues_; }
  const Matrix& eigenvectors() const { return eigenvectors_; }

 private:
  Vector eigenvalues_;
  Matrix eigenvectors_;
  Eigen::ComputationInfo info_;
};

}  // namespace horopter
