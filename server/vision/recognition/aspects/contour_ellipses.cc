#include "server/vision/recognition/aspects/contour_ellipses.h"

#include <algorithm>
#include <cmath>
#include <numbers>
#include <span>

#include "server/vision/features/ellipse_fit.h"

namespace horopter {
namespace {

constexpr double kMinMinorPx = 4.0;  // semi-axis
// Of the arc that is seen: sides of a cylinder cut its rim in two
constexpr double kMinSweepRad = 2.0;
constexpr double kMaxRmsPx = 0.5;        // of its points
constexpr int kLeastPoints = 16;         // of a chain that may be an ellipse
constexpr double kSamePx = 2.0;          // ellipses whose centres and axes differ by less are one
constexpr double kPerimeterSlack = 1.3;  // a chain longer than this many perimeters is none

}  // namespace

std::vector<EllipseArc> FindContourEllipses(const ContourGraph& contours,
                                            const ContourEllipseOptions& options) {
  std::vector<EllipseArc> out;
  for (const ContourChain& chain : contours.chains) {
    if (chain.size < kLeastPoints) continue;
    const auto arc = FitEllipse(std::span(contours.points).subspan(chain.begin, chain.size));
    if (!arc || arc->rms_px > kMaxRmsPx || arc->semi_minor_px < kMinMinorPx ||
        std::abs(arc->sweep_rad) < kMinSweepRad)
      continue;
    const double perimeter = 2 * std::numbers::pi *
                             std::sqrt(0.5 * (arc->semi_major_px * arc->semi_major_px +
                                              arc->semi_minor_px * arc->semi_minor_px));
    if (chain.size > kPerimeterSlack * perimeter) continue;
    out.push_back(*arc);
  }
  std::stable_sort(out.begin(), out.end(), [](const EllipseArc& a, const EllipseArc& b) {
    return a.semi_major_px > b.semi_major_px;
  });
  std::vector<EllipseArc> distinct;
  for (const EllipseArc& e : out) {
    if (static_cast<int>(distinct.size()) >= options.most) break;
    const bool known = std::any_of(distinct.begin(), distinct.end(), [&](const EllipseArc& o) {
      return (o.center - e.center).norm() < kSamePx &&
             std::abs(o.semi_major_px - e.semi_major_px) < kSamePx &&
             std::abs(o.semi_minor_px - e.semi_minor_px) < kSamePx;
    });
    if (!known) distinct.push_back(e);
  }
  return distinct;
}

}  // namespace horopter
