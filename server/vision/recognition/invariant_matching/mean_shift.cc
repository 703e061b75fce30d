#include "server/vision/recognition/invariant_matching/mean_shift.h"

#include <Eigen/Dense>
#include <algorithm>
#include <cmath>
#include <numeric>
#include <optional>

#include "server/base/status_macros.h"
#include "server/vision/geometry/symmetric_eigen.h"

namespace horopter {
namespace {

constexpr int kDensityBins = 128;         // of the density in which the lowest valley is sought
constexpr double kPieceDeviations = 4.0;  // bins reach this many bandwidths beyond the votes

// Distance of each vote to its k-th neighbour, within the bounds.
Eigen::VectorXd Bandwidths(const Eigen::MatrixXd& votes, const ClusterOptions& options) {
  const Eigen::Index n = votes.cols();
  const auto share = static_cast<Eigen::Index>(options.neighbour_share * static_cast<double>(n));
  const Eigen::Index k =
      std::min<Eigen::Index>(n - 1, std::max<Eigen::Index>(options.min_neighbour, share));
  Eigen::VectorXd h(n);
  for (Eigen::Index i = 0; i < n; ++i) {
    Eigen::VectorXd distances = (votes.colwise() - votes.col(i)).colwise().norm().transpose();
    std::nth_element(distances.data(), distances.data() + k, distances.data() + n);
    h(i) = std::clamp(distances(k), options.min_bandwidth, options.max_bandwidth);
  }
  // Votes that coincide still need a width.
  const double smallest = std::max(1e-12, 1e-9 * votes.cwiseAbs().maxCoeff());
  return h.cwiseMax(smallest);
}

std::vector<DensityMode> SortedModes(std::vector<DensityMode> modes) {
  std::stable_sort(modes.begin(), modes.end(), [](const DensityMode& a, const DensityMode& b) {
    return a.weight > b.weight;
  });
  return modes;
}

std::vector<DensityMode> AdaptiveMeanShift(const Eigen::MatrixXd& votes,
                                           const Eigen::VectorXd& weights,
                                           const ClusterOptions& options) {
  const Eigen::Index n = votes.cols(), d = votes.rows();
  const Eigen::VectorXd h = Bandwidths(votes, options);
  // Gaussian kernel cut off at three bandwidths; the profile's derivative is the kernel again.
  const double h_typical = std::exp(h.array().log().mean());
  const Eigen::VectorXd density =
      weights.array() * (-(static_cast<double>(d) + 2.0) * (h / h_typical).array().log()).exp();
  std::vector<DensityMode> modes;
  std::vector<double> mode_width;
  for (Eigen::Index i = 0; i < n; ++i) {
    Eigen::VectorXd x = votes.col(i);
    for (int step = 0; step < options.max_iterations; ++step) {
      Eigen::VectorXd sum = Eigen::VectorXd::Zero(d);
      double total = 0.0;
      for (Eigen::Index j = 0; j < n; ++j) {
        const double u = (votes.col(j) - x).squaredNorm() / (h(j) * h(j));
        if (u > 9.0) continue;
        const double w = density(j) * std::exp(-0.5 * u);
        sum += w * votes.col(j);
        total += w;
      }
      if (!(total > 0.0)) break;
      const Eigen::VectorXd next = sum / total;
      const double shift = (next - x).norm();
      x = next;
      if (shift < options.tolerance * h(i)) break;
    }
    int at = -1;
    for (std::size_t m = 0; m < modes.size() && at < 0; ++m) {
      const double reach = options.join * std::max(mode_width[m], h(i));
      if ((modes[m].position - x).norm() <= reach) at = static_cast<int>(m);
    }
    if (at < 0) {
      at = static_cast<int>(modes.size());
      modes.push_back({x, 0.0, {}});
      mode_width.push_back(h(i));
    }
    modes[at].weight += weights(i);
    modes[at].members.push_back(static_cast<int>(i));
  }
  return modes;
}

// The deepest valley of a density over `values`, or nothing: where the derivative changes from
// falling to rising and the density is low enough. bandwidth: of the kernel.
std::optional<double> DeepestValley(const Eigen::VectorXd& values,
                                    const Eigen::VectorXd& weights,
                                    double bandwidth,
                                    double valley) {
  const double low = values.minCoeff() - kPieceDeviations * bandwidth;
  const double high = values.maxCoeff() + kPieceDeviations * bandwidth;
  const double bin = (high - low) / kDensityBins;
  Eigen::VectorXd density = Eigen::VectorXd::Zero(kDensityBins);
  for (int b = 0; b < kDensityBins; ++b) {
    const Eigen::ArrayXd u = ((values.array() - (low + (b + 0.5) * bin)) / bandwidth).square();
    density(b) = (weights.array() * (-0.5 * u).exp()).sum();
  }
  std::optional<double> best;
  double depth = valley;
  for (int b = 1; b + 1 < kDensityBins; ++b) {
    if (!(density(b) <= density(b - 1) && density(b) < density(b + 1))) continue;
    const double peaks =
        std::min(density.head(b).maxCoeff(), density.tail(kDensityBins - b).maxCoeff());
    if (density(b) < depth * peaks) {
      depth = density(b) / peaks;
      best = low + (b + 0.5) * bin;
    }
  }
  return best;
}

std::vector<DensityMode> DensityDerivative(const Eigen::MatrixXd& votes,
                                           const Eigen::VectorXd& weights,
                                           const ClusterOptions& options) {
  std::vector<int> all(votes.cols());
  std::iota(all.begin(), all.end(), 0);
  std::vector<std::vector<int>> open = {all};
  std::vector<DensityMode> modes;
  while (!open.empty()) {
    const std::vector<int> piece = std::move(open.back());
    open.pop_back();
    const auto n = static_cast<Eigen::Index>(piece.size());
    Eigen::MatrixXd x(votes.rows(), n);
    Eigen::VectorXd w(n);
    for (Eigen::Index i = 0; i < n; ++i) x.col(i) = votes.col(piece[i]), w(i) = weights(piece[i]);
    const double total = std::max(w.sum(), 1e-300);
    const Eigen::VectorXd mean = x * w / total;
    const Eigen::MatrixXd centred = x.colwise() - mean;
    std::optional<double> cut;
    Eigen::VectorXd along;
    if (n > 1) {
      const Eigen::MatrixXd moment = centred * w.asDiagonal() * centred.transpose() / total;
      const SymmetricEigen<Eigen::Dynamic> scatter(moment);
      // Directions of large scatter first; the others may still separate.
      for (Eigen::Index k = votes.rows() - 1; k >= 0 && !cut; --k) {
        const double deviation = std::sqrt(std::max(0.0, scatter.eigenvalues()(k)));
        if (!(deviation > options.min_bandwidth) || !(deviation > 0.0)) break;
        along = (scatter.eigenvectors().col(k).transpose() * centred).transpose();
        // Silverman's rule, of the smaller of deviation and quartile range: modes far apart inflate
        // the first.
        Eigen::VectorXd sorted = along;
        std::sort(sorted.data(), sorted.data() + n);
        const double range = (sorted(3 * (n - 1) / 4) - sorted((n - 1) / 4)) / 1.34;
        const double spread = range > 0.0 ? std::min(range, deviation) : deviation;
        const double width = std::clamp(0.9 * spread * std::pow(static_cast<double>(n), -0.2),
                                        std::max(options.min_bandwidth, 1e-3 * deviation),
                                        options.max_bandwidth);
        cut = DeepestValley(along, w, width, options.valley);
      }
    }
    if (!cut) {
      modes.push_back({mean, w.sum(), piece});
      continue;
    }
    std::vector<int> low, high;
    for (Eigen::Index i = 0; i < n; ++i) (along(i) < *cut ? low : high).push_back(piece[i]);
    if (low.empty() || high.empty()) {
      modes.push_back({mean, w.sum(), piece});
      continue;
    }
    open.push_back(std::move(low));
    open.push_back(std::move(high));
  }
  return modes;
}

}  // namespace

absl::Status Validate(const ClusterOptions& options) {
  if (options.min_neighbour < 1) return absl::InvalidArgumentError("min_neighbour: below 1");
  if (!(options.neighbour_share >= 0.0 && options.neighbour_share <= 1.0)) {
    return absl::InvalidArgumentError("neighbour_share: not in [0, 1]");
  }
  if (!(options.min_bandwidth >= 0.0)) return absl::InvalidArgumentError("min_bandwidth: negative");
  if (!(options.max_bandwidth >= options.min_bandwidth) || !(options.max_bandwidth > 0.0)) {
    return absl::InvalidArgumentError("max_bandwidth: below min_bandwidth");
  }
  if (options.max_iterations < 1) return absl::InvalidArgumentError("max_iterations: below 1");
  if (!(options.tolerance > 0.0)) return absl::InvalidArgumentError("tolerance: not positive");
  if (!(options.join > 0.0)) return absl::InvalidArgumentError("join: not positive");
  if (!(options.valley > 0.0 && options.valley <= 1.0)) {
    return absl::InvalidArgumentError("valley: not in (0, 1]");
  }
  return absl::OkStatus();
}

absl::StatusOr<std::vector<DensityMode>> FindModes(const Eigen::MatrixXd& votes,
                                                   const Eigen::VectorXd& weights,
                                                   const ClusterOptions& options) {
  HOROPTER_RETURN_IF_ERROR(Validate(options));
  if (weights.size() != votes.cols()) return absl::InvalidArgumentError("weights: one per vote");
  if (votes.cols() == 0) return std::vector<DensityMode>{};
  if (!votes.allFinite() || !weights.allFinite() || weights.minCoeff() < 0.0) {
    return absl::InvalidArgumentError("votes or weights: not finite, or negative");
  }
  return SortedModes(options.method == ClusterMethod::kAdaptiveMeanShift
                         ? AdaptiveMeanShift(votes, weights, options)
                         : DensityDerivative(votes, weights, options));
}

}  // namespace horopter
