// Points about their best line.
#pragma once

#include <Eigen/Core>
#include <algorithm>
#include <cmath>
#include <span>

namespace horopter {

struct LineScatter {
  Eigen::Vector2d mean = Eigen::Vector2d::Zero();
  Eigen::Matrix2d moment = Eigen::Matrix2d::Zero();  // mean of q q^T, q from the mean, px^2

  // Mean square distance from the least-squares line: the smaller eigenvalue.
  double SquareAcross() const {
    const double skew = 0.5 * (moment(0, 0) - moment(1, 1));
    const double root = std::sqrt(skew * skew + moment(0, 1) * moment(0, 1));
    return std::max(0.5 * moment.trace() - root, 0.0);
  }
};

// At least one point, pixels.
inline LineScatter ScatterOf(std::span<const Eigen::Vector2f> points) {
  const auto n = static_cast<double>(points.size());
  LineScatter scatter;
  for (const Eigen::Vector2f& p : points) scatter.mean += p.cast<double>();
  scatter.mean /= n;
  for (const Eigen::Vector2f& p : points) {
    const Eigen::Vector2d q = p.cast<double>() - scatter.mean;
    scatter.moment += q * q.transpose();
  }
  scatter.moment /= n;
  return scatter;
}

}  // namespace horopter
