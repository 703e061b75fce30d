#include "tests/bench/straightness.h"

#include <Eigen/Eigenvalues>
#include <algorithm>
#include <cmath>
#include <string>
#include <vector>

#include "absl/strings/str_format.h"
#include "server/base/status_macros.h"
#include "server/vision/features/split_and_merge.h"

namespace horopter {
namespace {

constexpr int kEndPoints = 4;        // blur rounds corners: points left out at both ends of a piece
constexpr int kMaxPoints = 128;      // of a piece; more are thinned
constexpr double kPointRmsPx = 0.1;  // least deviation of a point, and what correlates neighbours:
constexpr double kCorrelatedPx = 3.0;  // ... only one point in so many is new
constexpr double kStepK1 = 1e-4;       // of numerical derivatives
constexpr double kTukey = 4.685;       // deviations; 95 % efficient for normal noise
constexpr double kInlierSigmas = 3.0;  // votes further off are no noise
constexpr double kTellingShare = 0.5;  // of max_k1: the deviation of a vote that counts
constexpr int kRounds = 2;           // the second cuts the chains where they bend without the lens
constexpr size_t kMaxPieces = 2000;  // longest first; for time

struct Piece {
  std::vector<Eigen::Vector2d> points;  // distorted, pixels
  double spacing_px = 1.0;
};

// What one piece says alone.
struct Vote {
  double k1 = 0.0;
  double variance = 0.0;
};

Eigen::Vector2d Undistorted(const PinholeCamera& camera, const Eigen::Vector2d& pixel) {
  return camera.focal_px * NormalizedPoint(camera, pixel) + Eigen::Vector2d(camera.cx, camera.cy);
}

// The k1 that makes the piece straightest, linearised about the camera's k1.
Vote VoteOf(const Piece& piece, PinholeCamera camera, const StraightnessOptions& options) {
  const auto n = static_cast<double>(piece.points.size());
  const double at = camera.k1;
  std::vector<Eigen::Vector2d> now, slope;
  Eigen::Vector2d mean = Eigen::Vector2d::Zero();
  for (const Eigen::Vector2d& p : piece.points) {
    camera.k1 = at;
    now.push_back(Undistorted(camera, p));
    mean += now.back() / n;
    camera.k1 = at + kStepK1;
    const Eigen::Vector2d more = Undistorted(camera, p);
    camera.k1 = at - kStepK1;
    slope.push_back((more - Undistorted(camera, p)) / (2.0 * kStepK1));
  }
  Eigen::Matrix2d scatter = Eigen::Matrix2d::Zero();
  for (const Eigen::Vector2d& u : now) scatter += (u - mean) * (u - mean).transpose();
  const Eigen::Matrix2d axes =
      Eigen::SelfAdjointEigenSolver<Eigen::Matrix2d>(scatter).eigenvectors();
  const Eigen::Vector2d across = axes.col(0), along = axes.col(1);
  // Residual e + k g of the line a + b s: k from the parts of e and g that no line explains.
  double ss = 0.0, g_mean = 0.0, gs = 0.0;
  for (size_t i = 0; i < now.size(); ++i) {
    const double s = along.dot(now[i] - mean), g = across.dot(slope[i]);
    ss += s * s;
    gs += g * s;
    g_mean += g / n;
  }
  double gg = 0.0, eg = 0.0, ee = 0.0;
  for (size_t i = 0; i < now.size(); ++i) {
    const double s = along.dot(now[i] - mean), e = across.dot(now[i] - mean);
    const double g = across.dot(slope[i]) - g_mean - gs / ss * s;
    gg += g * g;
    eg += e * g;
    ee += e * e;
  }
  if (!(gg > 1e-12)) return {at, 1e12};
  const double left = std::max(ee - eg * eg / gg, 0.0) / (n - 3.0);
  const double independent = std::max(1.0, kCorrelatedPx / piece.spacing_px);
  const double point = std::max(left, kPointRmsPx * kPointRmsPx) * independent;
  const double edge = options.edge_rms_px * options.edge_rms_px;
  return {at - eg / gg, point / gg + edge / (gg / n)};
}

std::vector<Vote> Votes(const std::vector<Piece>& pieces,
                        const PinholeCamera& camera,
                        const StraightnessOptions& options) {
  std::vector<Vote> votes;
  for (const Piece& piece : pieces) votes.push_back(VoteOf(piece, camera, options));
  return votes;
}

// Leaves out the pieces that say nothing about a lens (many of them together would say what bends
// their edges alike) and those that bend more than any lens within max_k1 does: curves.
void KeepTelling(const PinholeCamera& camera,
                 const StraightnessOptions& options,
                 std::vector<Piece>* pieces) {
  std::erase_if(*pieces, [&](const Piece& piece) {
    const Vote vote = VoteOf(piece, camera, options);
    const double sigma = std::sqrt(vote.variance);
    return sigma > kTellingShare * options.max_k1 ||
           std::abs(vote.k1) > options.max_k1 + kInlierSigmas * sigma;
  });
}

// Long pieces that are straight once `camera` has undistorted them, longest first.
std::vector<Piece> LongPieces(std::span<const EdgeChain> chains,
                              const PinholeCamera& camera,
                              const StraightnessOptions& options) {
  std::vector<std::pair<double, Piece>> found;
  for (const EdgeChain& chain : chains) {
    std::vector<Eigen::Vector2f> straight;
    for (const Eigen::Vector2f& p : chain.points) {
      straight.push_back(Undistorted(camera, p.cast<double>()).cast<float>());
    }
    for (const ChainPiece& part : SplitAndMerge(straight, SplitAndMergeOptions())) {
      const int begin = part.begin + kEndPoints, end = part.end - kEndPoints;
      if (end - begin < 12) continue;
      const double length = (chain.points[end - 1] - chain.points[begin]).norm();
      if (!(length >= options.min_length_px)) continue;
      Piece piece;
      const int step = (end - begin + kMaxPoints - 1) / kMaxPoints;
      for (int i = begin; i < end; i += step) {
        piece.points.push_back(chain.points[i].cast<double>());
      }
      piece.spacing_px = length / static_cast<double>(piece.points.size() - 1);
      found.emplace_back(length, std::move(piece));
    }
  }
  std::stable_sort(
      found.begin(), found.end(), [](const auto& a, const auto& b) { return a.first > b.first; });
  if (found.size() > kMaxPieces) found.resize(kMaxPieces);
  std::vector<Piece> pieces;
  for (auto& [length, piece] : found) pieces.push_back(std::move(piece));
  return pieces;
}

// Tukey's loss, 1 for what disagrees.
double Loss(const std::vector<Vote>& votes, double k1) {
  double sum = 0.0;
  for (const Vote& v : votes) {
    const double z = (v.k1 - k1) * (v.k1 - k1) / (v.variance * kTukey * kTukey);
    const double rest = z < 1.0 ? 1.0 - z : 0.0;
    sum += 1.0 - rest * rest * rest;
  }
  return sum;
}

// The value most votes agree on: the best of all votes, then reweighted means from it.
double Consensus(const std::vector<Vote>& votes, double max_k1) {
  double best = 0.0, least = Loss(votes, 0.0);
  for (const Vote& v : votes) {
    if (!(std::abs(v.k1) <= max_k1)) continue;
    if (const double loss = Loss(votes, v.k1); loss < least) {
      least = loss;
      best = v.k1;
    }
  }
  for (int i = 0; i < 20; ++i) {
    double sum = 0.0, weights = 0.0;
    for (const Vote& v : votes) {
      const double z = (v.k1 - best) * (v.k1 - best) / (v.variance * kTukey * kTukey);
      const double w = z < 1.0 ? (1.0 - z) * (1.0 - z) / v.variance : 0.0;
      sum += w * v.k1;
      weights += w;
    }
    if (!(weights > 0.0)) break;
    best = sum / weights;
  }
  return best;
}

// Mean of the votes of `inlier` weighted by their information.
double WeightedMean(const std::vector<Vote>& votes, const std::vector<bool>& inlier) {
  double sum = 0.0, weights = 0.0;
  for (size_t j = 0; j < votes.size(); ++j) {
    if (!inlier[j]) continue;
    sum += votes[j].k1 / votes[j].variance;
    weights += 1.0 / votes[j].variance;
  }
  return sum / weights;
}

absl::Status CheckInput(std::span<const EdgeChain> chains, const PinholeCamera& camera) {
  if (camera.width <= 0 || camera.height <= 0 || !(camera.focal_px > 0.0) ||
      !std::isfinite(camera.focal_px) || !std::isfinite(camera.cx) || !std::isfinite(camera.cy)) {
    return absl::InvalidArgumentError("camera: need a size, a focal length and a principal point");
  }
  for (size_t c = 0; c < chains.size(); ++c) {
    for (const Eigen::Vector2f& p : chains[c].points) {
      if (!p.allFinite()) {
        return absl::InvalidArgumentError("chains: " + std::to_string(c) +
                                          " has a point that is not finite");
      }
    }
  }
  return absl::OkStatus();
}

// Votes that agree with the consensus.
struct Agreement {
  std::vector<bool> inlier;
  double weight = 0.0, chi_square = 0.0;  // of these
  size_t best = 0;                        // the surest of them
};

// Counts the lines that agree. Errors: FAILED_PRECONDITION (too few).
absl::StatusOr<Agreement> Agree(const std::vector<Vote>& votes,
                                const StraightnessOptions& options,
                                StraightnessEstimate* estimate) {
  StraightnessEstimate& out = *estimate;
  Agreement agreed;
  auto& [inlier, weight, chi_square, best] = agreed;
  double all = 0.0;
  for (size_t j = 0; j < votes.size(); ++j) {
    const Vote& v = votes[j];
    const double z = (v.k1 - out.k1) * (v.k1 - out.k1) / v.variance;
    inlier.push_back(z < kInlierSigmas * kInlierSigmas);
    all += 1.0 / v.variance;
    if (!inlier[j]) continue;
    if (out.lines == 0 || v.variance < votes[best].variance) best = j;
    ++out.lines;
    weight += 1.0 / v.variance;
    chi_square += z;
  }
  if (out.lines < options.min_lines) {
    return absl::FailedPreconditionError(
        absl::StrFormat("straightness: %d of %d long pieces agree, need %d",
                        out.lines,
                        out.candidates,
                        options.min_lines));
  }
  if (weight < options.min_agreement * all) {
    return absl::FailedPreconditionError(absl::StrFormat(
        "straightness: %d of %d pieces agree, with %.2f of the information, need %.2f",
        out.lines,
        out.candidates,
        weight / all,
        options.min_agreement));
  }
  return agreed;
}

// The variance with what the same lines say when the principal point is elsewhere.
double WithCenterVariance(double variance,
                          const std::vector<Piece>& pieces,
                          const std::vector<bool>& inlier,
                          const PinholeCamera& guess,
                          double center,
                          const StraightnessOptions& options) {
  for (int axis = 0; axis < 2; ++axis) {
    PinholeCamera moved = guess;
    (axis == 0 ? moved.cx : moved.cy) += options.center_sigma * guess.width;
    const double shift = WeightedMean(Votes(pieces, moved, options), inlier) - center;
    variance += shift * shift;
  }
  return variance;
}

}  // namespace

absl::Status Validate(const StraightnessOptions& options) {
  const auto positive = [](const char* name, double value) -> absl::Status {
    if (value > 0.0 && std::isfinite(value)) return absl::OkStatus();
    return absl::InvalidArgumentError(std::string(name) + ": need a finite value > 0");
  };
  HOROPTER_RETURN_IF_ERROR(positive("min_length_px", options.min_length_px));
  HOROPTER_RETURN_IF_ERROR(positive("edge_rms_px", options.edge_rms_px));
  HOROPTER_RETURN_IF_ERROR(positive("max_k1", options.max_k1));
  HOROPTER_RETURN_IF_ERROR(positive("max_k1_sigma", options.max_k1_sigma));
  HOROPTER_RETURN_IF_ERROR(
      positive("max_k1_sigma_without_best", options.max_k1_sigma_without_best));
  if (options.min_lines < 2) {
    return absl::InvalidArgumentError("min_lines: need at least 2");
  }
  if (!(options.center_sigma >= 0.0) || !std::isfinite(options.center_sigma)) {
    return absl::InvalidArgumentError("center_sigma: need a finite value >= 0");
  }
  if (!(options.min_agreement >= 0.0 && options.min_agreement <= 1.0)) {
    return absl::InvalidArgumentError("min_agreement: need 0 to 1");
  }
  return absl::OkStatus();
}

absl::StatusOr<StraightnessEstimate> EstimateRadialDistortion(std::span<const EdgeChain> chains,
                                                              const PinholeCamera& camera,
                                                              const StraightnessOptions& options) {
  HOROPTER_RETURN_IF_ERROR(Validate(options));
  HOROPTER_RETURN_IF_ERROR(CheckInput(chains, camera));
  PinholeCamera guess = camera;
  guess.k1 = 0.0;
  std::vector<Piece> pieces;
  std::vector<Vote> votes;
  for (int round = 0; round < kRounds; ++round) {
    pieces = LongPieces(chains, guess, options);
    KeepTelling(guess, options, &pieces);
    votes = Votes(pieces, guess, options);
    guess.k1 = std::clamp(Consensus(votes, options.max_k1), -options.max_k1, options.max_k1);
  }
  votes = Votes(pieces, guess, options);
  StraightnessEstimate out;
  out.k1 = Consensus(votes, options.max_k1);
  out.candidates = static_cast<int>(votes.size());
  HOROPTER_ASSIGN_OR_RETURN(const Agreement agreed, Agree(votes, options, &out));
  const auto& [inlier, weight, chi_square, best] = agreed;
  const double center = WeightedMean(votes, inlier);
  const double scatter = std::max(chi_square / std::max(out.lines - 1.0, 1.0), 1.0);
  std::vector<bool> rest = inlier;
  rest[best] = false;
  const double rest_variance = scatter / std::max(weight - 1.0 / votes[best].variance, 1e-12);
  const double difference = WeightedMean(votes, rest) - votes[best].k1;
  const bool corroborated =
      difference * difference <
      kInlierSigmas * kInlierSigmas * (rest_variance + scatter * votes[best].variance);
  out.k1_sigma_without_best = std::sqrt(rest_variance);
  out.k1_sigma =
      std::sqrt(WithCenterVariance(scatter / weight, pieces, inlier, guess, center, options));
  if (!(out.k1_sigma <= options.max_k1_sigma) || !(std::abs(out.k1) <= options.max_k1)) {
    return absl::FailedPreconditionError(
        absl::StrFormat("straightness: k1 = %.3f with a deviation of %.3f, need at most %.3f",
                        out.k1,
                        out.k1_sigma,
                        options.max_k1_sigma));
  }
  if (!corroborated || !(out.k1_sigma_without_best <= options.max_k1_sigma_without_best)) {
    return absl::FailedPreconditionError(absl::StrFormat(
        "straightness: one line alone says k1 = %.3f, the others %.3f with a deviation of %.3f",
        votes[best].k1,
        WeightedMean(votes, rest),
        out.k1_sigma_without_best));
  }
  return out;
}

}  // namespace horopter
