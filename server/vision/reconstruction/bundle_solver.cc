#include "server/vision/reconstruction/bundle_solver.h"

#include <Eigen/Dense>

namespace horopter {
namespace {

// Diagonal entries that are damped at least as if they were this: parameters no residual moves.
constexpr double kMinDiagonal = 1e-6;

template <typename Matrix>
void Damp(double damping, Matrix* A) {
  for (Eigen::Index k = 0; k < A->rows(); ++k) {
    (*A)(k, k) += damping * std::max((*A)(k, k), kMinDiagonal);
  }
}

// What back-substitution needs of a feature: L of V = L L^T, and L^-1 g.
struct Eliminated {
  Eigen::Matrix4d L;
  Eigen::Vector4d g;
};

}  // namespace

template <int C>
bool SolveDamped(const BundleLayout& layout,
                 const NormalEquations<C>& normal,
                 double damping,
                 BundleStep<C>* step) {
  using CameraBlock = Eigen::Matrix<double, C, C>;
  using CrossBlock = typename NormalEquations<C>::CrossBlock;
  const int n = layout.cameras, features = layout.Features();
  // Blocks (i, j), i <= j, of S = U - sum Y Y^T with Y = W L^-T.
  std::vector<CameraBlock> S(static_cast<size_t>(n) * n, CameraBlock::Zero());
  Eigen::VectorXd rhs(n * C);
  for (int i = 0; i < n; ++i) {
    S[i * n + i] = normal.U[i];
    Damp(damping, &S[i * n + i]);
    rhs.segment<C>(C * i) = -normal.camera_gradient[i];
  }
  std::vector<Eliminated> eliminated(features);
  std::vector<CrossBlock> Y;
  for (int f = 0; f < features; ++f) {
    const int first = layout.first[f], count = layout.first[f + 1] - first;
    if (count == 0) continue;
    Eigen::Matrix4d V = normal.V[f];
    Damp(damping, &V);
    const Eigen::LLT<Eigen::Matrix4d> llt(V);
    if (llt.info() != Eigen::Success) return false;
    eliminated[f].L = llt.matrixL();
    eliminated[f].g = llt.matrixL().solve(normal.feature_gradient[f]);
    const Eigen::Matrix4d to_unit =
        eliminated[f].L.triangularView<Eigen::Lower>().solve(Eigen::Matrix4d::Identity());
    Y.resize(count);
    for (int a = 0; a < count; ++a) {
      Y[a].noalias() = normal.W[first + a].lazyProduct(to_unit.transpose());
      const int i = layout.camera[first + a];
      rhs.segment<C>(C * i) += Y[a] * eliminated[f].g;
      for (int b = 0; b <= a; ++b) {
        S[layout.camera[first + b] * n + i].noalias() -= Y[b].lazyProduct(Y[a].transpose());
      }
    }
  }
  Eigen::MatrixXd dense(n * C, n * C);
  for (int i = 0; i < n; ++i) {
    for (int j = i; j < n; ++j) dense.block<C, C>(C * i, C * j) = S[i * n + j];
  }
  const Eigen::LLT<Eigen::MatrixXd, Eigen::Upper> llt(dense);
  if (llt.info() != Eigen::Success) return false;
  const Eigen::VectorXd x = llt.solve(rhs);
  if (!x.allFinite()) return false;

  step->cameras.resize(n);
  step->features.assign(features, Eigen::Vector4d::Zero());
  // Decrease of r^T r / 2 + g^T x + x^T A x / 2: the damped system gives -g^T x - damping part.
  double decrease = 0.0;
  const auto count_decrease = [&](const auto& g, const auto& A, const auto& d) {
    decrease -= 0.5 * g.dot(d);
    for (Eigen::Index k = 0; k < d.size(); ++k) {
      decrease += 0.5 * damping * std::max(A(k, k), kMinDiagonal) * d(k) * d(k);
    }
  };
  for (int i = 0; i < n; ++i) {
    step->cameras[i] = x.segment<C>(C * i);
    count_decrease(normal.camera_gradient[i], normal.U[i], step->cameras[i]);
  }
  for (int f = 0; f < features; ++f) {
    const int first = layout.first[f], end = layout.first[f + 1];
    if (first == end) continue;
    Eigen::Vector4d sum = normal.feature_gradient[f];
    for (int k = first; k < end; ++k) {
      sum += normal.W[k].transpose().lazyProduct(step->cameras[layout.camera[k]]);
    }
    const Eigen::Matrix4d& L = eliminated[f].L;
    const Eigen::Vector4d half = L.triangularView<Eigen::Lower>().solve(sum);
    step->features[f] = -L.transpose().triangularView<Eigen::Upper>().solve(half);
    if (!step->features[f].allFinite()) return false;
    count_decrease(normal.feature_gradient[f], normal.V[f], step->features[f]);
  }
  step->predicted = decrease;
  return std::isfinite(decrease) && decrease >= 0.0;
}

template bool SolveDamped<10>(const BundleLayout&,
                              const NormalEquations<10>&,
                              double,
                              BundleStep<10>*);
template bool SolveDamped<12>(const BundleLayout&,
                              const NormalEquations<12>&,
                              double,
                              BundleStep<12>*);

}  // namespace horopter
