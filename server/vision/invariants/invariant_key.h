// A vector of invariants with its uncertainty, and first-order propagation for all of them.
#pragma once

#include <Eigen/Core>
#include <algorithm>
#include <cmath>

#include "server/vision/geometry/matrix6.h"

namespace horopter {

struct InvariantKey {
  Eigen::VectorXd values;
  Eigen::MatrixXd covariance;  // J C J'; empty when the input came without one
};

// J C J' of f at x by central differences; f: VectorXd -> VectorXd, smooth around x. Homogeneous
// coordinates may have a singular C. Relative error of J about 1e-9 for |x| of order 1.
template <typename Function>
Eigen::MatrixXd PropagateCovariance(const Function& f,
                                    const Eigen::VectorXd& x,
                                    const Eigen::MatrixXd& covariance) {
  constexpr double kStep = 1e-5;  // cube root of the double's precision
  Eigen::MatrixXd jacobian;
  Eigen::VectorXd moved = x;
  for (Eigen::Index i = 0; i < x.size(); ++i) {
    const double step = kStep * std::max(1e-3, std::abs(x(i)));
    moved(i) = x(i) + step;
    const Eigen::VectorXd above = f(moved);
    moved(i) = x(i) - step;
    const Eigen::VectorXd below = f(moved);
    moved(i) = x(i);
    if (i == 0) jacobian.resize(above.size(), x.size());
    jacobian.col(i) = (above - below) / (2.0 * step);
  }
  return jacobian * covariance * jacobian.transpose();
}

}  // namespace horopter
