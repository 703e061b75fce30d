#include "server/vision/features/arcs.h"

#include <algorithm>
#include <cmath>
#include <optional>

#include "server/base/stop_scope.h"
#include "server/vision/features/edge_cover.h"
#include "server/vision/features/ellipse_frame.h"
#include "server/vision/features/rim_evidence.h"

namespace horopter {
namespace {

double ArcLength(const EllipseArc& arc) {
  return arc.sweep_rad * 0.5 * (arc.semi_major_px + arc.semi_minor_px);
}

// Two guesses this near grow into the same rim.
bool SameEllipse(const EllipseArc& a, const EllipseArc& b) {
  constexpr double kSamePx = 1.0;  // of centre, axes and ends: below what seeds differ by noise
  return (a.center - b.center).squaredNorm() < kSamePx * kSamePx &&
         std::abs(a.semi_major_px - b.semi_major_px) < kSamePx &&
         std::abs(a.semi_minor_px - b.semi_minor_px) < kSamePx &&
         a.semi_major_px * std::abs(std::sin(a.angle_rad - b.angle_rad)) *
                 (1.0 - a.semi_minor_px / a.semi_major_px) <
             kSamePx;
}

class RimList {
 public:
  RimList(std::span<const GradientField> fields, const ArcOptions& options)
      : fields_(fields), options_(options) {}

  // Lets a seed grow, unless one like it was tried.
  void Try(const EllipseArc& seed, double min_sweep_rad) {
    for (const EllipseArc& known : tried_) {
      if (SameEllipse(known, seed)) return;
    }
    tried_.push_back(seed);
    const std::optional<FittedRim> rim = FitRim(seed, fields_, options_.rim);
    if (rim && rim->seen_share >= options_.min_seen_share && rim->arc.sweep_rad >= min_sweep_rad &&
        IsPlausibleEllipse(rim->arc, options_.seeds)) {
      tried_.push_back(rim->arc);
      rims_.push_back(*rim);
    }
  }

  std::vector<FittedRim> Take() { return std::move(rims_); }

 private:
  std::span<const GradientField> fields_;
  ArcOptions options_;
  std::vector<EllipseArc> tried_;
  std::vector<FittedRim> rims_;
};

// Calls visit(point, direction of the edge) about every half pixel of the arc.
template <typename Visit>
int AlongArc(const EllipseArc& arc, const Visit& visit) {
  const EllipseFrame frame(arc);
  const int steps = std::max(8, static_cast<int>(2.0 * ArcLength(arc)));
  for (int k = 0; k <= steps; ++k) {
    const Eigen::Vector2d unit = UnitAt(arc.start_rad + arc.sweep_rad * k / steps);
    visit(frame.PointAt(unit).cast<float>(),
          EdgeCover::EdgeDirection(frame.NormalAt(unit).cast<float>()));
  }
  return steps + 1;
}

}  // namespace

std::vector<EllipseArc> FindArcs(const std::vector<EdgeChain>& chains,
                                 std::span<const GradientField> fields,
                                 int width,
                                 int height,
                                 const ArcOptions& options) {
  if (chains.empty()) return {};
  const std::vector<GradientField> strongest = {StrongestOf(fields)};
  RimList list(strongest, options);
  const std::vector<std::vector<ChainPiece>> chords = ChordsOf(chains);
  for (const EllipseArc& seed : SeedsOfRuns(chains, chords, width, height, options.seeds)) {
    LeaveIfStopped();
    list.Try(seed, options.min_sweep_rad);
  }
  for (const EllipseArc& seed : SeedsOfPairs(chains, chords, options.seeds)) {
    LeaveIfStopped();
    list.Try(seed, options.min_pair_sweep_rad);
  }
  std::vector<FittedRim> rims = list.Take();
  std::stable_sort(rims.begin(), rims.end(), [](const FittedRim& a, const FittedRim& b) {
    return a.score > b.score;
  });
  std::vector<EllipseArc> arcs;
  EdgeCover found(width, height);
  for (const FittedRim& rim : rims) {
    int covered = 0;
    const int all = AlongArc(rim.arc, [&](const Eigen::Vector2f& p, uint8_t direction) {
      covered += found.Covers(p, direction) ? 1 : 0;
    });
    if (covered > options.max_covered_share * all) continue;
    AlongArc(rim.arc,
             [&](const Eigen::Vector2f& p, uint8_t direction) { found.Mark(p, direction); });
    arcs.push_back(rim.arc);
  }
  if (static_cast<int>(arcs.size()) > options.max_arcs) {
    arcs.resize(options.max_arcs);
  }
  return arcs;
}

}  // namespace horopter
