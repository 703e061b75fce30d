// When the requests of an open loop are due, and in which order the recorded sets are sent. The
// same seed gives the same run.
#pragma once

#include <cstdint>
#include <random>
#include <vector>

namespace horopter {

struct ArrivalOptions {
  double rate_hz = 1.0;      // > 0
  double rate_end_hz = 0.0;  // > 0: the rate goes there linearly within ramp_s; 0: it stays
  double ramp_s = 0.0;
  bool poisson = false;  // independent arrivals; else evenly spaced
  uint64_t seed = 1;
};

// Start times in seconds from the start of the run, ascending.
class Arrivals {
 public:
  explicit Arrivals(const ArrivalOptions& options);
  double Next();

 private:
  // Inverse of the expected number of arrivals until t, N(t) = r0 t + (r1 - r0) t^2 / (2 T),
  // continued with rate r1 after T.
  double TimeOf(double arrivals) const;

  ArrivalOptions options_;
  std::mt19937_64 random_;
  double arrivals_ = 0.0;
};

// Every set once, in random order, then every set once again in another order, and so on.
class ItemOrder {
 public:
  ItemOrder(int items, uint64_t seed);
  int Next();

 private:
  std::vector<int> order_;
  size_t next_ = 0;
  std::mt19937_64 random_;
};

}  // namespace horopter
