// Six-vectors (Plücker lines, perturbations of rigid transforms) and the matrices between them.
#pragma once

#include <Eigen/Core>

namespace horopter {

using Vector6d = Eigen::Matrix<double, 6, 1>;
using Matrix6d = Eigen::Matrix<double, 6, 6>;

}  // namespace horopter
