// Random points, lines and collineations, and the covariance a noisy sample shows.
#pragma once

#include <Eigen/Dense>
#include <array>
#include <random>
#include <vector>

#include "server/vision/invariants/line_sets.h"

namespace horopter {

class RandomSpace {
 public:
  explicit RandomSpace(unsigned seed) : rng_(seed) {}

  double Normal() { return normal_(rng_); }
  int Below(int n) { return static_cast<int>(rng_() % static_cast<unsigned>(n)); }

  Eigen::Vector4d Point() { return {Normal(), Normal(), Normal(), 1.0}; }
  Vector6d Line() { return LineThrough(Point(), Point()); }

  // Condition number below 20: worse ones only cost precision.
  Eigen::Matrix4d Collineation() {
    while (true) {
      Eigen::Matrix4d h;
      for (double& x : h.reshaped()) x = Normal();
      const Eigen::Vector4d values = Eigen::JacobiSVD<Eigen::Matrix4d>(h).singularValues();
      if (values(0) < 20.0 * values(3)) return h;
    }
  }

  // Scale and sign that homogeneous coordinates may have.
  double Scale() { return (Below(2) == 0 ? -1.0 : 1.0) * std::exp(Normal()); }

  Eigen::VectorXd Noise(Eigen::Index n) {
    Eigen::VectorXd noise(n);
    for (double& x : noise) x = Normal();
    return noise;
  }

  std::mt19937& rng() { return rng_; }

 private:
  std::mt19937 rng_;
  std::normal_distribution<double> normal_;
};

// Largest difference of standard deviations between a sample covariance and the stated one.
inline double CovarianceError(const std::vector<Eigen::VectorXd>& samples,
                              const Eigen::MatrixXd& stated) {
  Eigen::VectorXd mean = Eigen::VectorXd::Zero(stated.rows());
  for (const Eigen::VectorXd& s : samples) mean += s;
  mean /= static_cast<double>(samples.size());
  Eigen::MatrixXd found = Eigen::MatrixXd::Zero(stated.rows(), stated.rows());
  for (const Eigen::VectorXd& s : samples) found += (s - mean) * (s - mean).transpose();
  found /= static_cast<double>(samples.size() - 1);
  return (found - stated).norm() / stated.norm();
}

}  // namespace horopter
