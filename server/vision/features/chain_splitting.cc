#include "server/vision/features/chain_splitting.h"

#include <Eigen/Cholesky>
#include <Eigen/Eigenvalues>
#include <algorithm>
#include <cmath>
#include <string>

#include "server/base/status_macros.h"

namespace horopter {
namespace {

constexpr double kSagittaSigmas = 3.0;
// Points that double back by more than this share of the piece's extent are no graph over their
// line: an arc of more than half a turn.
constexpr double kMaxDoublingBack = 0.1;

absl::Status CheckFinite(std::span<const Eigen::Vector2f> points) {
  for (size_t i = 0; i < points.size(); ++i) {
    if (!points[i].allFinite()) {
      return absl::InvalidArgumentError("chain: point " + std::to_string(i) + " is not finite");
    }
  }
  return absl::OkStatus();
}

}  // namespace

absl::Status Validate(const ChainSplittingOptions& options) {
  HOROPTER_RETURN_IF_ERROR(Validate(options.curvature));
  HOROPTER_RETURN_IF_ERROR(Validate(options.templates));
  if (!(options.split_and_merge.split_px > 0.0) || !(options.split_and_merge.merge_rms_px >= 0.0)) {
    return absl::InvalidArgumentError(
        "split_and_merge: split_px must be > 0 and merge_rms_px >= 0");
  }
  if (!(options.max_curvature > 0.0)) {
    return absl::InvalidArgumentError("max_curvature: need > 0, got " +
                                      std::to_string(options.max_curvature));
  }
  if (options.suppression < 1) {
    return absl::InvalidArgumentError("suppression: need at least 1 point, got " +
                                      std::to_string(options.suppression));
  }
  if (options.min_points < 2 || options.split_and_merge.min_points < 2) {
    return absl::InvalidArgumentError("min_points: need at least 2");
  }
  if (!(options.straight_sagitta_px >= 0.0)) {
    return absl::InvalidArgumentError("straight_sagitta_px: need >= 0");
  }
  return absl::OkStatus();
}

bool IsCurved(std::span<const Eigen::Vector2f> points, double straight_sagitta_px) {
  if (points.size() < 5) return false;
  const auto n = static_cast<double>(points.size());
  Eigen::Vector2d mean = Eigen::Vector2d::Zero();
  for (const Eigen::Vector2f& p : points) mean += p.cast<double>() / n;
  Eigen::Matrix2d moment = Eigen::Matrix2d::Zero();
  for (const Eigen::Vector2f& p : points) {
    const Eigen::Vector2d q = p.cast<double>() - mean;
    moment += q * q.transpose() / n;
  }
  const Eigen::Matrix2d axes =
      Eigen::SelfAdjointEigenSolver<Eigen::Matrix2d>(moment).eigenvectors();
  const Eigen::Vector2d along = axes.col(1), across = axes.col(0);
  double lowest = 1e300, highest = -1e300;
  for (const Eigen::Vector2f& p : points) {
    const double x = along.dot(p.cast<double>() - mean);
    lowest = std::min(lowest, x);
    highest = std::max(highest, x);
  }
  const double half = 0.5 * (highest - lowest);
  if (!(half > 0.0)) return false;
  const double ends = std::abs(along.dot((points.back() - points.front()).cast<double>()));
  if (ends < 2.0 * half * (1.0 - kMaxDoublingBack)) {
    return std::sqrt(moment.trace()) > straight_sagitta_px;
  }
  // y = p0 + p1 x + p2 x^2 with x in [-1, 1] or so; p2 is the sagitta.
  Eigen::Matrix3d normal = Eigen::Matrix3d::Zero();
  Eigen::Vector3d right = Eigen::Vector3d::Zero();
  double square = 0.0;
  for (const Eigen::Vector2f& p : points) {
    const Eigen::Vector2d q = p.cast<double>() - mean;
    const double x = along.dot(q) / half, y = across.dot(q);
    const Eigen::Vector3d row(1.0, x, x * x);
    normal += row * row.transpose();
    right += y * row;
    square += y * y;
  }
  const Eigen::LDLT<Eigen::Matrix3d> solver(normal);
  const Eigen::Vector3d parabola = solver.solve(right);
  const double variance = std::max(square - parabola.dot(right), 0.0) / (n - 3.0);
  const double sigma = std::sqrt(variance * solver.solve(Eigen::Vector3d::UnitZ())(2));
  const double sagitta = std::abs(parabola(2));
  return sagitta > straight_sagitta_px && sagitta > kSagittaSigmas * sigma;
}

absl::StatusOr<std::vector<ChainPiece>> SplitChain(std::span<const Eigen::Vector2f> points,
                                                   bool closed,
                                                   const ChainSplittingOptions& options) {
  HOROPTER_RETURN_IF_ERROR(Validate(options));
  if (options.method == ChainSplittingMethod::kSplitAndMerge) {
    HOROPTER_RETURN_IF_ERROR(CheckFinite(points));
    return SplitAndMerge(points, options.split_and_merge);
  }
  HOROPTER_ASSIGN_OR_RETURN(std::vector<double> curvature,
                            ChainCurvature(points, closed, options.curvature));
  std::vector<int> cuts;
  if (options.method == ChainSplittingMethod::kCurvatureTemplates) {
    cuts = FindTemplateCuts(curvature, closed, options.templates);
  } else {
    for (double& kappa : curvature) kappa = std::abs(kappa);
    cuts = SuppressNonMaxima(curvature, closed, options.max_curvature, options.suppression);
  }
  cuts.push_back(static_cast<int>(points.size()) - 1);
  std::vector<ChainPiece> pieces;
  int begin = 0;
  for (int cut : cuts) {
    const int end = cut + 1;
    if (end - begin >= options.min_points) {
      pieces.push_back(
          {begin, end, IsCurved(points.subspan(begin, end - begin), options.straight_sagitta_px)});
    }
    begin = std::max(cut, begin);
  }
  return pieces;
}

}  // namespace horopter
