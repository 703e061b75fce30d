// Covariance of a bundle with free gauge, from its Jacobian in tangent parameters.
#pragma once

#include <Eigen/Core>
#include <optional>
#include <span>
#include <vector>

namespace ceres {
struct CRSMatrix;
}

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
  std::vector<Eigen::MatrixXd> W;          // per feature: camera parameters x its own
  // Residual variance about the stated one: chi^2 / degrees of freedom.
  double variance_factor = 1.0;
  int redundancy = 0;

  // Standard deviation along the least determined direction that is not gauge.
  double WeakestDeviation() const;
  // Joint covariance of the tangent parameters of features.
  Eigen::MatrixXd Features(std::span<const int> features) const;
};

// J: rows in units of sigma; columns: `camera_parameters` first, then the features' one after the
// other. Every row may touch one feature. Drops exactly `gauge_freedom` eigenvalues of S. Nullopt
// when a feature's V is singular or something is not finite.
std::optional<BundleCovariance> InvertBundle(const ceres::CRSMatrix& J,
                                             int camera_parameters,
                                             std::span<const int> feature_size,
                                             int gauge_freedom);

}  // namespace horopter
