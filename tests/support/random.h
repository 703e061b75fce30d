// Random numbers that are the same with every standard library.
#pragma once

#include <Eigen/Core>
#include <algorithm>
#include <random>

namespace horopter {

// The standard's distributions differ between libraries; these do not.
class Random {
 public:
  explicit Random(unsigned seed) : rng_(seed) {}
  double Uniform(double low, double high) {
    return low + (high - low) * (static_cast<double>(rng_()) / 4294967296.0);
  }
  // Sum of twelve uniform numbers: mean 0, deviation 1, never beyond 6.
  double Normal() {
    double sum = -6.0;
    for (int i = 0; i < 12; ++i) sum += Uniform(0.0, 1.0);
    return sum;
  }
  Eigen::Vector2d Noise(double sigma) {
    const double x = Normal();
    return sigma * Eigen::Vector2d(x, Normal());
  }
  int Index(int n) { return std::min(n - 1, static_cast<int>(Uniform(0.0, n))); }

 private:
  std::mt19937 rng_;
};

}  // namespace horopter
