#include "server/vision/features/chain_splitting.h"

#include <Eigen/Cholesky>
#include <Eigen/Eigenvalues>
#include <algorithm>
#include <cmath>
#include <limits>
#include <optional>
#include <string>

#include "server/base/status_macros.h"
#include "server/vision/features/ellipse_fit.h"
#include "server/vision/features/line_scatter.h"

namespace horopter {
namespace {

constexpr double kSagittaSigmas = 3.0;  // of the bow's height, to be no noise
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

// Points that a fit looks at: more do not change the comparison of two fits.
constexpr int kMaxLinePoints = 200;
// Blur rounds a corner off: points this near to a cut do not speak against the pieces beside it.
constexpr int kCornerPoints = 3;
// Deviations from a fit below this (rms) are the pixel grid's.
constexpr double kGridRmsPx = 0.04;

// Sum of squares about the line or, when the points bend, the ellipse of least algebraic error, and
// the degrees of freedom left.
struct Residual {
  double square = 0.0;
  double freedom = 0.0;
};

Residual LineResidual(std::span<const Eigen::Vector2f> points) {
  const auto n = static_cast<double>(points.size());
  return {n * ScatterOf(points).SquareAcross(), n - 2.0};
}

std::optional<Residual> FitResidual(std::span<const Eigen::Vector2f> points,
                                    double straight_sagitta_px) {
  std::vector<Eigen::Vector2f> thinned;
  const size_t step = (points.size() + kMaxLinePoints - 1) / kMaxLinePoints;
  for (size_t i = 0; i < points.size(); i += step) thinned.push_back(points[i]);
  if (!IsCurved(thinned, straight_sagitta_px)) {
    return LineResidual(thinned);
  }
  const std::optional<EllipseArc> arc = FitEllipse(thinned);
  if (!arc || thinned.size() < 7) return std::nullopt;
  const auto n = static_cast<double>(thinned.size());
  return Residual{arc->rms_px * arc->rms_px * n, n - 5.0};
}

// Rms of one fit to both pieces over that of their own fits; empty where no ellipse fits or it
// leaves too much: beside a piece that hides a corner every joint fit looks good.
std::optional<double> JointRatio(std::span<const Eigen::Vector2f> points,
                                 const ChainPiece& a,
                                 const ChainPiece& b,
                                 const ChainSplittingOptions& options) {
  const double straight_sagitta_px = options.straight_sagitta_px;
  const auto part = [&](int begin, int end) { return points.subspan(begin, end - begin); };
  const auto joint = FitResidual(part(a.begin, b.end), straight_sagitta_px);
  const auto inner = [&](const ChainPiece& piece, int skip_begin, int skip_end) {
    const bool long_enough = piece.end - piece.begin > 6 + kCornerPoints;
    return FitResidual(part(piece.begin + (long_enough ? skip_begin : 0),
                            piece.end - (long_enough ? skip_end : 0)),
                       straight_sagitta_px);
  };
  const auto first = inner(a, 0, kCornerPoints), second = inner(b, kCornerPoints, 0);
  if (!joint || !first || !second || joint->freedom <= 0.0) return std::nullopt;
  const double limit = options.rejoin_rms_px;
  if (joint->square > limit * limit * joint->freedom) return std::nullopt;
  const double own = (first->square + second->square) / (first->freedom + second->freedom);
  return std::sqrt(joint->square / joint->freedom / std::max(own, kGridRmsPx * kGridRmsPx));
}

// Removes the cuts (inner ends of `pieces`, which cover the chain) that the fits do not bear out,
// least borne out first.
void Rejoin(std::span<const Eigen::Vector2f> points,
            const ChainSplittingOptions& options,
            std::vector<ChainPiece>* pieces) {
  const auto ratio = [&](size_t k) {
    return JointRatio(points, (*pieces)[k], (*pieces)[k + 1], options)
        .value_or(std::numeric_limits<double>::infinity());
  };
  std::vector<double> ratios;
  for (size_t k = 0; k + 1 < pieces->size(); ++k) ratios.push_back(ratio(k));
  while (!ratios.empty()) {
    const auto best = std::min_element(ratios.begin(), ratios.end());
    if (*best > options.rejoin_factor) break;
    const auto k = static_cast<size_t>(best - ratios.begin());
    (*pieces)[k].end = (*pieces)[k + 1].end;
    pieces->erase(pieces->begin() + static_cast<ptrdiff_t>(k) + 1);
    ratios.erase(best);
    if (k > 0) ratios[k - 1] = ratio(k - 1);
    if (k < ratios.size()) ratios[k] = ratio(k);
  }
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
  if (!(options.rejoin_factor >= 0.0) || !(options.rejoin_rms_px >= 0.0)) {
    return absl::InvalidArgumentError("rejoin_factor and rejoin_rms_px: need >= 0");
  }
  if (!(options.straight_sagitta_px >= 0.0)) {
    return absl::InvalidArgumentError("straight_sagitta_px: need >= 0");
  }
  return absl::OkStatus();
}

bool IsCurved(std::span<const Eigen::Vector2f> points, double straight_sagitta_px) {
  if (points.size() < 5) return false;
  const auto n = static_cast<double>(points.size());
  const auto& [mean, moment] = ScatterOf(points);
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
    cuts = SuppressNonMaxima(curvature, {}, closed, options.max_curvature, options.suppression);
  }
  const int n = static_cast<int>(points.size());
  std::vector<ChainPiece> pieces;
  int begin = 0;
  cuts.push_back(n - 1);
  for (int cut : cuts) {
    if (cut > begin) pieces.push_back({begin, cut + 1});
    begin = std::max(cut, begin);
  }
  if (options.rejoin_factor > 0.0) Rejoin(points, options, &pieces);
  std::erase_if(pieces, [&](const ChainPiece& p) { return p.end - p.begin < options.min_points; });
  for (ChainPiece& p : pieces) {
    const int skip = p.end - p.begin >= 6 * kCornerPoints ? kCornerPoints : 0;
    p.curved = IsCurved(points.subspan(p.begin + skip, p.end - p.begin - 2 * skip),
                        options.straight_sagitta_px);
  }
  return pieces;
}

}  // namespace horopter
