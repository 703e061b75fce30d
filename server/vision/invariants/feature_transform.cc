#include "server/vision/invariants/feature_transform.h"

#include <algorithm>
#include <bit>
#include <cmath>
#include <cstring>

#include "absl/strings/str_cat.h"

namespace horopter {
namespace {

static_assert(std::endian::native == std::endian::little);
constexpr std::string_view kMagic = "HFTR";  // first bytes of the blob
constexpr uint16_t kVersion = 1;             // of the blob's layout
constexpr size_t kHeaderBytes = 20;          // magic, version, reserved, three sizes

// Interval of row d that holds x; the outermost ones reach to infinity.
Eigen::Index IntervalOf(const Eigen::MatrixXd& quantiles, Eigen::Index d, double x) {
  Eigen::Index low = 0, high = quantiles.cols() - 1;
  while (high - low > 1) {
    const Eigen::Index middle = (low + high) / 2;
    (quantiles(d, middle) <= x ? low : high) = middle;
  }
  return low;
}

}  // namespace

absl::StatusOr<FeatureTransform> FeatureTransform::Fit(const std::vector<Eigen::VectorXd>& keys,
                                                       int knots,
                                                       uint32_t catalog_generation) {
  if (keys.size() < 2) return absl::InvalidArgumentError("keys: fewer than 2");
  if (knots < 2) return absl::InvalidArgumentError("knots: fewer than 2");
  const Eigen::Index dimensions = keys[0].size();
  for (const Eigen::VectorXd& key : keys) {
    if (key.size() != dimensions || !key.allFinite()) {
      return absl::InvalidArgumentError("keys: of different lengths or not finite");
    }
  }
  FeatureTransform transform;
  transform.catalog_generation_ = catalog_generation;
  transform.quantiles_.resize(dimensions, knots);
  std::vector<double> values(keys.size());
  for (Eigen::Index d = 0; d < dimensions; ++d) {
    for (size_t i = 0; i < keys.size(); ++i) values[i] = keys[i](d);
    std::sort(values.begin(), values.end());
    const double extent = std::max(values.back() - values.front(), 1e-9);
    // Many catalog keys are equal (right angles): knots are kept apart, or slopes would be
    // infinite.
    const double apart = 1e-5 * extent / knots;
    for (int k = 0; k < knots; ++k) {
      const double at = static_cast<double>(k) / (knots - 1) * static_cast<double>(keys.size() - 1);
      const size_t i = std::min(static_cast<size_t>(at), values.size() - 2);
      double q = values[i] + (at - static_cast<double>(i)) * (values[i + 1] - values[i]);
      if (k > 0) q = std::max(q, transform.quantiles_(d, k - 1) + apart);
      transform.quantiles_(d, k) = q;
    }
  }
  return transform;
}

Eigen::VectorXd FeatureTransform::Slopes(const Eigen::VectorXd& key) const {
  const double step = 1.0 / static_cast<double>(quantiles_.cols() - 1);
  Eigen::VectorXd slopes(key.size());
  for (Eigen::Index d = 0; d < key.size(); ++d) {
    const Eigen::Index k = IntervalOf(quantiles_, d, key(d));
    slopes(d) = step / (quantiles_(d, k + 1) - quantiles_(d, k));
  }
  return slopes;
}

Eigen::VectorXd FeatureTransform::Apply(const Eigen::VectorXd& key) const {
  const double step = 1.0 / static_cast<double>(quantiles_.cols() - 1);
  Eigen::VectorXd result(key.size());
  for (Eigen::Index d = 0; d < key.size(); ++d) {
    const Eigen::Index k = IntervalOf(quantiles_, d, key(d));
    const double share = (key(d) - quantiles_(d, k)) / (quantiles_(d, k + 1) - quantiles_(d, k));
    result(d) = (static_cast<double>(k) + share) * step;
  }
  return result;
}

InvariantKey FeatureTransform::Apply(const InvariantKey& key) const {
  InvariantKey result{Apply(key.values), {}};
  if (key.covariance.size() > 0) {
    const Eigen::VectorXd slopes = Slopes(key.values);
    result.covariance = slopes.asDiagonal() * key.covariance * slopes.asDiagonal();
  }
  return result;
}

std::string FeatureTransform::Encode() const {
  std::string out(kMagic);
  const auto append = [&](const auto& value) {
    out.append(reinterpret_cast<const char*>(&value), sizeof(value));
  };
  append(kVersion);
  append(uint16_t{0});
  append(catalog_generation_);
  append(static_cast<uint32_t>(quantiles_.rows()));
  append(static_cast<uint32_t>(quantiles_.cols()));
  for (Eigen::Index d = 0; d < quantiles_.rows(); ++d) {
    for (Eigen::Index k = 0; k < quantiles_.cols(); ++k) append(quantiles_(d, k));
  }
  return out;
}

absl::StatusOr<FeatureTransform> FeatureTransform::Decode(std::string_view blob) {
  const auto lost = [](std::string_view what) {
    return absl::DataLossError(absl::StrCat("feature transformation: ", std::string(what)));
  };
  if (blob.size() < kHeaderBytes || blob.substr(0, 4) != kMagic) return lost("wrong magic");
  uint16_t version = 0;
  std::memcpy(&version, blob.data() + 4, sizeof(version));
  if (version != kVersion) return lost("unknown version");
  uint32_t sizes[3];
  std::memcpy(sizes, blob.data() + 8, sizeof(sizes));
  if (sizes[2] < 2 || blob.size() != kHeaderBytes + uint64_t{sizes[1]} * sizes[2] * 8) {
    return lost("wrong size");
  }
  FeatureTransform transform;
  transform.catalog_generation_ = sizes[0];
  transform.quantiles_.resize(sizes[1], sizes[2]);
  const char* at = blob.data() + kHeaderBytes;
  for (uint32_t d = 0; d < sizes[1]; ++d) {
    for (uint32_t k = 0; k < sizes[2]; ++k, at += sizeof(double)) {
      std::memcpy(&transform.quantiles_(d, k), at, sizeof(double));
      if (k > 0 && !(transform.quantiles_(d, k) > transform.quantiles_(d, k - 1))) {
        return lost("not ascending");
      }
    }
  }
  return transform;
}

}  // namespace horopter
