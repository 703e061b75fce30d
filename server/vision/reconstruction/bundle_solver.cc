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

}  // namespace

template <int C>
bool EliminateFeatures(const BundleLayout& layout,
                       const NormalEquations<C>& normal,
                       double damping,
                       SchurComplement<C>* out) {
  using CameraBlock = Eigen::Matrix<double, C, C>;
  const int n = layout.cameras, features = layout.Features();
  std::vector<CameraBlock> S(static_cast<size_t>(n) * n, CameraBlock::Zero());  // (i, j), i <= j
  for (int i = 0; i < n; ++i) {
    S[i * n + i] = normal.U[i];
    Damp(damping, &S[i * n + i]);
  }
  out->L.assign(features, Eigen::Matrix4d::Identity());
  out->Z.resize(normal.F.size());
  for (int f = 0; f < features; ++f) {
    const int first = layout.first[f], end = layout.first[f + 1];
    if (first == end) continue;
    Eigen::Matrix4d V = normal.V[f];
    Damp(damping, &V);
    const Eigen::LLT<Eigen::Matrix4d> llt(V);
    if (llt.info() != Eigen::Success) return false;
    out->L[f] = llt.matrixL();
    const Eigen::Matrix4d inverse =
        out->L[f].template triangularView<Eigen::Lower>().solve(Eigen::Matrix4d::Identity());
    for (int a = first; a < end; ++a) {
      out->Z[a].noalias() = normal.F[a].lazyProduct(inverse.transpose());
      const int i = layout.camera[a];
      for (int b = first; b <= a; ++b) {
        const Eigen::Matrix2d M = out->Z[b].lazyProduct(out->Z[a].transpose());
        const Eigen::Matrix<double, 2, C> MK = M.lazyProduct(normal.K[a].transpose());
        S[layout.camera[b] * n + i].noalias() -= normal.K[b].lazyProduct(MK);
      }
    }
  }
  out->S.resize(n * C, n * C);
  for (int i = 0; i < n; ++i) {
    for (int j = i; j < n; ++j) out->S.template block<C, C>(C * i, C * j) = S[i * n + j];
  }
  if (normal.coupling.size() > 0) out->S.template triangularView<Eigen::Upper>() += normal.coupling;
  return true;
}

template <int C>
bool SolveDamped(const BundleLayout& layout,
                 const NormalEquations<C>& normal,
                 double damping,
                 BundleStep<C>* step) {
  SchurComplement<C> schur;
  if (!EliminateFeatures(layout, normal, damping, &schur)) return false;
  const int n = layout.cameras, features = layout.Features();
  const Eigen::LLT<Eigen::MatrixXd, Eigen::Upper> llt(schur.S);
  if (llt.info() != Eigen::Success) return false;
  Eigen::VectorXd rhs(n * C);
  for (int i = 0; i < n; ++i) rhs.segment<C>(C * i) = -normal.camera_gradient[i];
  for (int f = 0; f < features; ++f) {
    const Eigen::Vector4d g =
        schur.L[f].template triangularView<Eigen::Lower>().solve(normal.feature_gradient[f]);
    for (int k = layout.first[f]; k < layout.first[f + 1]; ++k) {
      const Eigen::Vector2d Zg = schur.Z[k] * g;
      rhs.segment<C>(C * layout.camera[k]) += normal.K[k] * Zg;
    }
  }
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
      const Eigen::Vector2d Kx = normal.K[k].transpose() * step->cameras[layout.camera[k]];
      sum += normal.F[k].transpose() * Kx;
    }
    const Eigen::Matrix4d& L = schur.L[f];
    const Eigen::Vector4d half = L.triangularView<Eigen::Lower>().solve(sum);
    step->features[f] = -L.transpose().triangularView<Eigen::Upper>().solve(half);
    if (!step->features[f].allFinite()) return false;
    count_decrease(normal.feature_gradient[f], normal.V[f], step->features[f]);
  }
  step->predicted = decrease;
  return std::isfinite(decrease) && decrease >= 0.0;
}

template bool EliminateFeatures<10>(const BundleLayout&,
                                    const NormalEquations<10>&,
                                    double,
                                    SchurComplement<10>*);
template bool EliminateFeatures<12>(const BundleLayout&,
                                    const NormalEquations<12>&,
                                    double,
                                    SchurComplement<12>*);
template bool SolveDamped<10>(const BundleLayout&,
                              const NormalEquations<10>&,
                              double,
                              BundleStep<10>*);
template bool SolveDamped<12>(const BundleLayout&,
                              const NormalEquations<12>&,
                              double,
                              BundleStep<12>*);

}  // namespace horopter
