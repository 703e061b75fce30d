#include "server/vision/reconstruction/bundle_covariance.h"

#include <Eigen/Dense>
#include <cmath>
#include <limits>

#include "server/vision/geometry/symmetric_eigen.h"

namespace horopter {
namespace {

// A feature whose own normal matrix is worse conditioned is not determined.
constexpr double kSingularFeature = 1e-15;

}  // namespace

double BundleCovariance::WeakestDeviation() const {
  if (gauge_freedom >= camera_spectrum.size()) return std::numeric_limits<double>::infinity();
  const double value = camera_spectrum(gauge_freedom);
  return value > 0.0 ? 1.0 / std::sqrt(value) : std::numeric_limits<double>::infinity();
}

Eigen::MatrixXd BundleCovariance::Features(std::span<const int> features) const {
  int total = 0;
  for (const int f : features) total += feature_size[f];
  // Columns W_f V_f^-1 side by side.
  Eigen::MatrixXd all = Eigen::MatrixXd::Zero(cameras.rows(), total);
  int at = 0;
  for (const int f : features) {
    for (const auto& [row, block] : reach[f]) {
      all.block(row, at, block.rows(), block.cols()) = block;
    }
    at += feature_size[f];
  }
  Eigen::MatrixXd joint = all.transpose() * cameras * all;
  at = 0;
  for (const int f : features) {
    joint.block(at, at, feature_size[f], feature_size[f]) += V_inverse[f];
    at += feature_size[f];
  }
  return joint;
}

template <int C>
std::optional<BundleCovariance> InvertBundle(const BundleLayout& layout,
                                             const NormalEquations<C>& normal,
                                             const TangentBases<C>& bases,
                                             int gauge_freedom) {
  BundleCovariance out;
  out.gauge_freedom = gauge_freedom;
  std::vector<int> row_of = {0};  // per camera its first row; one past the end at the end
  for (const auto& basis : bases.cameras) {
    row_of.push_back(row_of.back() + static_cast<int>(basis.cols()));
  }
  const int size = row_of.back();
  if (size <= gauge_freedom) return std::nullopt;
  SchurComplement<C> schur;
  if (!EliminateFeatures(layout, normal, 0.0, &schur)) return std::nullopt;
  // Both triangles, in tangent parameters.
  Eigen::MatrixXd S(size, size);
  for (int i = 0; i < layout.cameras; ++i) {
    for (int j = i; j < layout.cameras; ++j) {
      const Eigen::MatrixXd block = bases.cameras[i].transpose() *
                                    schur.S.template block<C, C>(C * i, C * j) * bases.cameras[j];
      S.block(row_of[i], row_of[j], block.rows(), block.cols()) = block;
      S.block(row_of[j], row_of[i], block.cols(), block.rows()) = block.transpose();
    }
  }
  if (!S.allFinite()) return std::nullopt;
  out.reach.resize(layout.Features());
  for (int f = 0; f < layout.Features(); ++f) {
    const auto& basis = bases.features[f];
    out.feature_size.push_back(static_cast<int>(basis.cols()));
    out.V_inverse.emplace_back(Eigen::MatrixXd::Zero(basis.cols(), basis.cols()));
    if (basis.cols() == 0) continue;
    const Eigen::Vector4d pivots = schur.L[f].diagonal().cwiseAbs2();
    if (!(pivots.minCoeff() > kSingularFeature * pivots.maxCoeff())) return std::nullopt;
    const Eigen::Matrix<double, 4, Eigen::Dynamic, 0, 4, 4> half =
        schur.L[f].template triangularView<Eigen::Lower>().solve(basis);
    out.V_inverse[f] = half.transpose() * half;
    for (int k = layout.first[f]; k < layout.first[f + 1]; ++k) {
      const int i = layout.camera[k];
      out.reach[f].emplace_back(row_of[i],
                                bases.cameras[i].transpose() * (normal.K[k] * (schur.Z[k] * half)));
    }
  }
  const SymmetricEigen<Eigen::Dynamic> solver(S);
  if (solver.info() != Eigen::Success) return std::nullopt;
  out.camera_spectrum = solver.eigenvalues();
  Eigen::VectorXd inverse = Eigen::VectorXd::Zero(size);
  const double floor = 1e-14 * std::max(0.0, out.camera_spectrum.maxCoeff());
  for (int k = gauge_freedom; k < size; ++k) {
    inverse(k) = 1.0 / std::max(out.camera_spectrum(k), floor);
  }
  out.cameras = solver.eigenvectors() * inverse.asDiagonal() * solver.eigenvectors().transpose();
  if (!out.cameras.allFinite()) return std::nullopt;
  return out;
}

template std::optional<BundleCovariance> InvertBundle<10>(const BundleLayout&,
                                                          const NormalEquations<10>&,
                                                          const TangentBases<10>&,
                                                          int);
template std::optional<BundleCovariance> InvertBundle<12>(const BundleLayout&,
                                                          const NormalEquations<12>&,
                                                          const TangentBases<12>&,
                                                          int);

}  // namespace horopter
