#include "server/vision/features/arc_refit.h"

#include <cmath>
#include <vector>

#include "server/base/stop_scope.h"
#include "server/vision/features/conic_fit.h"
#include "server/vision/features/ellipse_fit.h"
#include "server/vision/features/ellipse_frame.h"

namespace horopter {
namespace {

constexpr double kNearPx = 1.5;  // chain points this near are the arc's, and it must fit them
constexpr std::size_t kFewestPoints = 12;  // over twice the five of an ellipse
constexpr int kSlopesPerLook = 1024;       // at the stop flag

bool IsInSweep(const EllipseArc& arc, const EllipseFrame& frame, const Eigen::Vector2d& point) {
  const Eigen::Vector2d unit = frame.inverse * (point - frame.center);
  double along = std::atan2(unit.y(), unit.x()) - arc.start_rad;
  along -= 2.0 * M_PI * std::floor(along / (2.0 * M_PI));
  return along <= arc.sweep_rad;
}

std::vector<Eigen::Vector2f> PointsOf(const EllipseArc& arc, const ImageFeatures& features) {
  const EllipseFrame frame(arc);
  std::vector<Eigen::Vector2f> points;
  StopPacer pacer(kSlopesPerLook);
  for (const EdgeChain& chain : features.chains) {
    pacer.Step();
    for (const Eigen::Vector2f& p : chain.points) {
      const Eigen::Vector2d at = p.cast<double>();
      if ((at - frame.center).squaredNorm() > std::pow(arc.semi_major_px + kNearPx, 2)) continue;
      if (EllipseDistance(arc, at) <= kNearPx && IsInSweep(arc, frame, at)) points.push_back(p);
    }
  }
  return points;
}

}  // namespace

void RefitArcs(ImageFeatures* features) {
  int refitted = 0;
  for (EllipseArc& arc : features->arcs) {
    const std::vector<Eigen::Vector2f> points = PointsOf(arc, *features);
    if (points.size() < kFewestPoints) continue;
    absl::StatusOr<EllipseFit> fit = FitEllipseGeometric(points, {});
    if (!fit.ok() || !(fit->arc.rms_px <= kNearPx)) continue;
    // Points come chain by chain, not along the arc.
    SpanOf(points, &fit->arc);
    arc = fit->arc;
    ++refitted;
  }
  features->counts["arcs_refitted"] = refitted;
}

}  // namespace horopter
