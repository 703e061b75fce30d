// The transformation of keys that makes their density flat (thesis 4.3.1).
#pragma once

#include <Eigen/Core>
#include <cstdint>
#include <string>
#include <string_view>
#include <vector>

#include "absl/status/statusor.h"
#include "server/vision/invariants/invariant_key.h"

namespace horopter {

// Each component goes through its empirical distribution function, so that a query box of fixed
// size has the same expected content wherever it lies. Piecewise linear between quantiles; linear
// continuation outside, so that it stays invertible and order-preserving.
//
// Byte layout, little-endian: magic "HFTR", u16 version (1), u16 zero, u32 catalog generation, u32
// dimensions d, u32 knots k, then d x k f64 ascending.
class FeatureTransform {
 public:
  FeatureTransform() = default;

  // Errors: INVALID_ARGUMENT (fewer than 2 keys, knots < 2, keys of different lengths, not finite).
  static absl::StatusOr<FeatureTransform> Fit(const std::vector<Eigen::VectorXd>& keys,
                                              int knots,
                                              uint32_t catalog_generation);

  int dimensions() const { return static_cast<int>(quantiles_.rows()); }
  // Of the catalog that it was computed from.
  uint32_t catalog_generation() const { return catalog_generation_; }

  // Components of catalog keys land in [0, 1]. Covariances go with the local slopes.
  Eigen::VectorXd Apply(const Eigen::VectorXd& key) const;
  InvariantKey Apply(const InvariantKey& key) const;

  std::string Encode() const;
  // Errors: DATA_LOSS.
  static absl::StatusOr<FeatureTransform> Decode(std::string_view blob);

 private:
  Eigen::VectorXd Slopes(const Eigen::VectorXd& key) const;

  Eigen::MatrixXd quantiles_;  // component x knot, strictly ascending
  uint32_t catalog_generation_ = 0;
};

}  // namespace horopter
