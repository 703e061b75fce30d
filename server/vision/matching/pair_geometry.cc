#include "server/vision/matching/pair_geometry.h"

#include <Eigen/Dense>
#include <algorithm>
#include <cmath>
#include <cstdio>

#include "server/base/stop_scope.h"
#include "server/vision/geometry/fundamental_matrix.h"
#include "server/vision/matching/homography.h"
#include "server/vision/matching/match_features.h"
#include "server/vision/matching/plane_parallax.h"
#include "server/vision/matching/robust_fundamental.h"

namespace horopter {
namespace {

// What a free F needs. Chosen in a one-off experiment on all pairs of parts-train without a plane;
// what they let through is in tests/bench/results.md.
constexpr int kMinGuided = 13;          // inliers among the matches along its lines
constexpr double kMinBeam = 0.4;        // mean overlap of the segments matched before F was known
constexpr double kSureShare = 0.7;      // ... not asked when so many of
constexpr int kSureMatches = 40;        // ... so many first matches agree
constexpr double kMaxStrainCost = 0.1;  // per inlier: what plausible cameras add to the cost
// Image widths; of plausible lenses.
constexpr double kMinFocalWidths = 0.6, kMaxFocalWidths = 3.2, kMaxFocalRatio = 1.6;
constexpr double kMaxSigmaPx = 0.8;     // of epipolar lines: wider bands tell no match
constexpr double kRefineScalePx = 1.0;  // of the robust loss
constexpr double kNearPx = 2.0;         // of the epipolar line, for a match along it
// Strain of F; right ones of parts-train stay under 0.07.
constexpr double kMaxStrain = 0.12;
// A free F must explain so much more than plane and parallax, which has five freedoms less.
constexpr double kFreeMustBeat = 1.15;
constexpr double kOnPlanePx = 3.0;    // of the plane's transfer: as accurate as junctions and lens
constexpr double kLikelyRatio = 1.0;  // log-likelihood that two corners are one
constexpr double kShiftedPx = 5.0;    // parallax that no such inaccuracy explains

// Junction matches of a pair as points, in its order.
std::vector<WeightedMatch> PointsOf(const MatchingView& a,
                                    const MatchingView& b,
                                    const std::vector<JunctionMatch>& matches) {
  std::vector<WeightedMatch> points;
  for (const JunctionMatch& m : matches) {
    points.push_back({a.features->junctions[m.junction_a].point,
                      b.features->junctions[m.junction_b].point,
                      std::max(0.5, m.log_ratio)});
  }
  return points;
}

PairComparison Compare(const MatchingView& a, const MatchingView& b, const PairPrior& prior) {
  return {a, b, WarpedPatches(b, prior), prior};
}

// Corners of a regular texture match as well a period away, all of them by the same shift, and such
// matches have an F. A corner that the plane takes to another that looks like it lies on the plane:
// what it is matched with away from there is none.
void DropShiftedTexture(const PairComparison& compare,
                        const std::optional<Eigen::Matrix3d>& b_from_a,
                        const SimilarityOptions& options,
                        std::vector<JunctionMatch>* matches) {
  if (!b_from_a) return;
  const std::vector<Junction>& of_a = compare.a().features->junctions;
  const std::vector<Junction>& of_b = compare.b().features->junctions;
  std::vector<Eigen::Vector2d> warped;
  for (const Junction& j : of_a) warped.push_back(Transfer(*b_from_a, j.point));
  const auto explains = [&](int a, int b) {
    return (warped[a] - of_b[b].point).squaredNorm() < kOnPlanePx * kOnPlanePx &&
           LogRatio(compare.Junctions(a, b), compare.has_plane(), options) > kLikelyRatio;
  };
  std::erase_if(*matches, [&](const JunctionMatch& m) {
    LeaveIfStopped();
    if ((warped[m.junction_a] - of_b[m.junction_b].point).norm() < kShiftedPx) return false;
    for (int b = 0; b < static_cast<int>(of_b.size()); ++b) {
      if (explains(m.junction_a, b)) return true;
    }
    for (int a = 0; a < static_cast<int>(of_a.size()); ++a) {
      if (explains(a, m.junction_b)) return true;
    }
    return false;
  });
}

void FillMatches(const PairComparison& compare,
                 const std::optional<Eigen::Matrix3d>& b_from_a,
                 const FeatureMatchOptions& options,
                 PairGeometry* pair) {
  pair->matches.clear();
  pair->segments.clear();
  for (const FeatureMatch& m : MatchFeatures(compare, options)) {
    if (m.kind == FeatureKind::kSegment) {
      pair->segments.push_back({m.a, m.b, m.log_ratio});
    } else if (!compare.has_epipolar() || compare.EpipolarDistance(m.a, m.b) < kNearPx) {
      pair->matches.push_back({m.a, m.b, m.log_ratio});
    }
  }
  DropShiftedTexture(compare, b_from_a, options.similarity, &pair->matches);
}

FocalPrior PriorOf(const MatchingView& a, const MatchingView& b) {
  FocalPrior prior;
  prior.width_a = a.features->width;
  prior.height_a = a.features->height;
  prior.width_b = b.features->width;
  prior.height_b = b.features->height;
  return prior;
}

// Mean overlap with their beams of segments matched without F; texture repeats itself and does not
// count. NaN: no segment can tell.
double MeanBeam(const PairComparison& with_F, const std::vector<SegmentMatch>& segments) {
  double sum = 0.0;
  int count = 0;
  for (const SegmentMatch& m : segments) {
    if (with_F.a().features->segments[m.segment_a].in_texture) continue;
    const float beam = with_F.Segments(m.segment_a, m.segment_b)[kBeam];
    if (!std::isfinite(beam)) continue;
    sum += beam;
    ++count;
  }
  return count > 0 ? sum / count : std::nan("");
}

std::string Format(const char* format, double x, double y) {
  char text[160];
  std::snprintf(text, sizeof(text), format, x, y);
  return text;
}

// Empty when plausible cameras have the fundamental matrix. strain: what they cost a match more.
std::string WhyImplausible(const CalibratedFundamental& calibrated,
                           double strain,
                           const MatchingView& a,
                           const MatchingView& b) {
  if (!(strain <= kMaxStrainCost)) {
    return Format("no plausible cameras have it: they cost %.2f a match more, allowed %.2f",
                  strain,
                  kMaxStrainCost);
  }
  const double focal_a = calibrated.focal_a_px / a.features->width;
  const double focal_b = calibrated.focal_b_px / b.features->width;
  if (!(std::min(focal_a, focal_b) >= kMinFocalWidths &&
        std::max(focal_a, focal_b) <= kMaxFocalWidths &&
        std::max(focal_a / focal_b, focal_b / focal_a) <= kMaxFocalRatio)) {
    return Format(
        "focal lengths of %.2f and %.2f image widths are not plausible", focal_a, focal_b);
  }
  const double sigma = *std::max_element(calibrated.refined.line_sigma_px.begin(),
                                         calibrated.refined.line_sigma_px.end());
  if (!(sigma <= kMaxSigmaPx)) {
    return Format(
        "epipolar lines uncertain by %.1f px, need %.2f px", std::min(sigma, 999.0), kMaxSigmaPx);
  }
  return {};
}
// A free F from matches made without one, or the refusal.
std::optional<Eigen::Matrix3d> EstimateFree(const MatchingView& a,
                                            const MatchingView& b,
                                            const PairGeometry& pair,
                                            const std::optional<Eigen::Matrix3d>& b_from_a,
                                            const MatchingOptions& options,
                                            std::string* refusal) {
  const std::vector<WeightedMatch> first = PointsOf(a, b, pair.matches);
  RobustFundamentalOptions robust = options.fundamental;
  robust.inlier_px = options.epipolar_px;
  robust.seed = options.seed;
  const RobustFundamental estimate = EstimateFundamental(first, robust);
  if (!estimate.F) {
    *refusal = estimate.refusal;
    return std::nullopt;
  }
  PairPrior prior;
  prior.F = estimate.F;
  const PairComparison compare(a, b, b.patches, prior);
  const size_t inliers = estimate.inliers.size();
  const double beam = MeanBeam(compare, pair.segments);
  const bool sure = inliers >= kSureMatches && inliers >= kSureShare * first.size();
  if (!sure && !(beam >= kMinBeam)) {
    *refusal = Format("segments contradict it: they share %.2f of their epipolar beams, need %.2f",
                      beam,
                      kMinBeam);
    return std::nullopt;
  }
  PairGeometry along;
  FillMatches(compare, b_from_a, options.features, &along);
  const std::vector<WeightedMatch> guided = PointsOf(a, b, along.matches);
  robust.min_inliers = kMinGuided;
  const RobustFundamental again = EstimateFundamental(guided, robust);
  if (!again.F) {
    *refusal = again.refusal;
    return std::nullopt;
  }
  std::vector<WeightedMatch> agreeing;
  for (int i : again.inliers) agreeing.push_back(guided[i]);
  const CalibratedFundamental calibrated =
      RefineCalibrated(*again.F, agreeing, kRefineScalePx, PriorOf(a, b));
  const double free_cost = RefineFundamental(*again.F, agreeing, kRefineScalePx).cost;
  const double strain =
      (calibrated.refined.cost - free_cost) / static_cast<double>(agreeing.size());
  *refusal = WhyImplausible(calibrated, strain, a, b);
  if (!refusal->empty()) return std::nullopt;
  return calibrated.refined.F;
}

double Explained(const Eigen::Matrix3d& F,
                 const std::vector<WeightedMatch>& matches,
                 double limit_px) {
  double sum = 0.0;
  for (const WeightedMatch& m : matches) {
    const double r2 = SampsonSquared(F, m.a, m.b) / (limit_px * limit_px);
    sum += std::max(0.0, 1.0 - r2);
  }
  return sum;
}

std::vector<MatchCandidate> ToCandidates(const Eigen::Matrix3d& b_from_a,
                                         const std::vector<JunctionMatch>& indices,
                                         const std::vector<WeightedMatch>& points) {
  const Eigen::Matrix3d a_from_b = b_from_a.inverse();
  std::vector<MatchCandidate> candidates;
  for (size_t k = 0; k < indices.size(); ++k) {
    const WeightedMatch& m = points[k];
    candidates.push_back({indices[k].junction_a,
                          indices[k].junction_b,
                          m.a,
                          m.b,
                          m.weight / (m.weight + 3.0),  // likelihood ratios saturate
                          (Transfer(a_from_b, m.b) - m.a).norm()});
  }
  return candidates;
}

}  // namespace

void MatchAlongEpipolarLines(const MatchingView& a,
                             const MatchingView& b,
                             const std::optional<Eigen::Matrix3d>& b_from_a,
                             PairGeometry* pair,
                             const FeatureMatchOptions& options) {
  FillMatches(Compare(a, b, {b_from_a, pair->F}), b_from_a, options, pair);
}

PairGeometry MatchPair(int view_a,
                       int view_b,
                       const MatchingView& a,
                       const MatchingView& b,
                       const std::optional<Eigen::Matrix3d>& b_from_a,
                       const FeatureMatchOptions& options) {
  PairGeometry pair;
  pair.view_a = view_a;
  pair.view_b = view_b;
  FillMatches(Compare(a, b, {b_from_a, std::nullopt}), b_from_a, options, &pair);
  return pair;
}

bool HasPlausibleCameras(const Eigen::Matrix3d& F, const MatchingView& a, const MatchingView& b) {
  return CalibrationStrain(F, PriorOf(a, b)) <= kMaxStrain;
}

void EstimateEpipolarGeometry(const MatchingView& a,
                              const MatchingView& b,
                              const std::optional<Eigen::Matrix3d>& b_from_a,
                              const MatchingOptions& options,
                              PairGeometry* pair) {
  pair->refusal.clear();
  pair->F = EstimateFree(a, b, *pair, b_from_a, options, &pair->refusal);
  if (!b_from_a) {
    if (!pair->F) pair->refusal = "no plane, and " + pair->refusal;
    return;
  }
  const std::vector<WeightedMatch> points = PointsOf(a, b, pair->matches);
  ParallaxOptions parallax = options.parallax;
  parallax.epipolar_px = options.epipolar_px;
  parallax.seed = options.seed;
  ParallaxResult plane =
      EstimatePlaneParallax(*b_from_a, ToCandidates(*b_from_a, pair->matches, points), parallax);
  if (plane.F && !HasPlausibleCameras(*plane.F, a, b)) {
    plane.F.reset();
    plane.refusal = "no plausible cameras have it";
  }
  const auto explained = [&](const Eigen::Matrix3d& F) {
    return Explained(F, points, options.epipolar_px);
  };
  if (plane.F && (!pair->F || explained(*pair->F) < kFreeMustBeat * explained(*plane.F)))
    pair->F = plane.F;
  if (!pair->F) pair->refusal = plane.refusal + "; without the plane: " + pair->refusal;
}

}  // namespace horopter
