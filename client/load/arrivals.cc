#include "client/load/arrivals.h"

#include <cmath>
#include <numeric>
#include <utility>

namespace horopter {

Arrivals::Arrivals(const ArrivalOptions& options) : options_(options), random_(options.seed) {}

double Arrivals::TimeOf(double arrivals) const {
  const double r0 = options_.rate_hz, r1 = options_.rate_end_hz, T = options_.ramp_s;
  if (r1 <= 0.0 || T <= 0.0) return arrivals / r0;
  const double within = 0.5 * (r0 + r1) * T;
  if (arrivals >= within) return T + (arrivals - within) / r1;
  const double a = (r1 - r0) / (2.0 * T);
  // The stable root of a t^2 + r0 t - arrivals = 0.
  return 2.0 * arrivals / (r0 + std::sqrt(r0 * r0 + 4.0 * a * arrivals));
}

double Arrivals::Next() {
  const double at = TimeOf(arrivals_);
  // 53 random bits; std::exponential_distribution may differ between libraries.
  const double uniform = static_cast<double>(random_() >> 11) * 0x1p-53;
  arrivals_ += options_.poisson ? -std::log1p(-uniform) : 1.0;
  return at;
}

ItemOrder::ItemOrder(int items, uint64_t seed)
    : order_(static_cast<size_t>(items)), next_(order_.size()), random_(seed) {
  std::iota(order_.begin(), order_.end(), 0);
}

int ItemOrder::Next() {
  if (next_ == order_.size()) {
    for (size_t i = order_.size(); i > 1; --i) std::swap(order_[i - 1], order_[random_() % i]);
    next_ = 0;
  }
  return order_[next_++];
}

}  // namespace horopter
