#include "server/vision/recognition/invariant_matching/mean_shift.h"

#include <Eigen/Dense>
#include <algorithm>
#include <cmath>
#include <numeric>

#include "server/base/status_macros.h"

namespace horopter {
namespace {

// Neighbour whose distance is a vote's bandwidth: the larger of the two. Raising them joins modes.
constexpr int kMinNeighbour = 5;
constexpr double kNeighbourShare = 0.02;
constexpr int kMaxShifts = 60;
constexpr double kArrived = 1e-3;  // bandwidths; a path that shifts by less has arrived

// Distance of each vote to its k-th neighbour, within the bounds.
Eigen::VectorXd Bandwidths(const Eigen::MatrixXd& votes, const ClusterOptions& options) {
  const Eigen::Index n = votes.cols();
  const auto share = static_cast<Eigen::Index>(kNeighbourShare * static_cast<double>(n));
  const Eigen::Index k =
      std::min<Eigen::Index>(n - 1, std::max<Eigen::Index>(kMinNeighbour, share));
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
    for (int step = 0; step < kMaxShifts; ++step) {
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
      if (shift < kArrived * h(i)) break;
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

}  // namespace

absl::Status Validate(const ClusterOptions& options) {
  if (!(options.min_bandwidth >= 0.0)) return absl::InvalidArgumentError("min_bandwidth: negative");
  if (!(options.max_bandwidth >= options.min_bandwidth) || !(options.max_bandwidth > 0.0)) {
    return absl::InvalidArgumentError("max_bandwidth: below min_bandwidth");
  }
  if (!(options.join > 0.0)) return absl::InvalidArgumentError("join: not positive");
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
  return SortedModes(AdaptiveMeanShift(votes, weights, options));
}

}  // namespace horopter
