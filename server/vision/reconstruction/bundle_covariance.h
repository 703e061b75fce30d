// Covariance of a bundle with free gauge, from its normal equations in tangent parameters.
#pragma once

#include <Eigen/Core>
#include <optional>
#include <span>
#include <utility>
#include <vector>

#include "server/vision/reconstruction/bundle_solver.h"

namespace horopter {

// With the normal matrix [U W; W^T V], V block-diagonal over features, S = U - W V^-1 W^T. A
// generalised inverse of the whole follows from one of S, and every quantity that no change of
// gauge alters has the same covariance under all of them.
struct BundleCovariance {
  Eigen::MatrixXd cameras;                 // pseudo-inverse of S; tangent parameters of all views
  Eigen::VectorXd camera_spectrum;         // eigenvalues of S, ascending; the gauge's come first
  int gauge_freedom = 0;                   // how many of them were taken as null
  std::vector<int> feature_size;           // tangent parameters per feature; 0: not in the bundle
  std::vector<Eigen::MatrixXd> V_inverse;  // per feature
  // W V^-1 per feature, and there per camera that sees it: first row among the cameras' parameters.
  std::vector<std::vector<std::pair<int, Eigen::MatrixXd>>> reach;
  // Residual variance about the stated one: chi^2 / degrees of freedom.
  double variance_factor = 1.0;
  int redundancy = 0;

  // Standard deviation along the least determined direction that is not gauge.
  double WeakestDeviation() const;
  // Joint covariance of the tangent parameters of features.
  Eigen::MatrixXd Features(std::span<const int> features) const;
};

// Orthonormal columns: which directions of the solver's parameters are tangent. No residual may
// depend on the others of a feature (their share of V only has to be regular). A feature that is
// not in the bundle has no column.
template <int C>
struct TangentBases {
  std::vector<Eigen::Matrix<double, C, Eigen::Dynamic, 0, C, C>> cameras;
  std::vector<Eigen::Matrix<double, 4, Eigen::Dynamic, 0, 4, 4>> features;
};

// Residuals in units of sigma. Drops exactly `gauge_freedom` eigenvalues of S. Nullopt when a
// feature's V is singular or something is not finite. For C = 10 and 12.
template <int C>
std::optional<BundleCovariance> InvertBundle(const BundleLayout& layout,
                                             const NormalEquations<C>& normal,
                                             const TangentBases<C>& bases,
                                             int gauge_freedom);

}  // namespace horopter
