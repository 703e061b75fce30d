#include "server/vision/features/conic_junctions.h"

#include <algorithm>
#include <cmath>
#include <optional>

#include "server/vision/features/ellipse_frame.h"

namespace horopter {
namespace {

constexpr double kTouchPx = 1.0;  // a line that misses an arc by less touches it

double Wrapped(double angle) {
  const double turn = std::fmod(angle, 2.0 * M_PI);
  return turn < 0.0 ? turn + 2.0 * M_PI : turn;
}

// Parameters of the ellipse where the line through `from` along `direction` meets it; a near miss
// gives the point nearest to the line.
std::vector<double> Meetings(const EllipseFrame& frame,
                             const Eigen::Vector2d& from,
                             const Eigen::Vector2d& direction) {
  const Eigen::Vector2d p = frame.inverse * (from - frame.center);
  const Eigen::Vector2d d = frame.inverse * direction;
  const double dd = d.squaredNorm(), pd = p.dot(d), pp = p.squaredNorm();
  const double discriminant = pd * pd - dd * (pp - 1.0);
  const Eigen::Vector2d foot = p - d * (pd / dd);
  const double miss_px = (frame.axes * (foot - foot.normalized())).norm();
  if (discriminant < 0.0 || (foot.norm() > 0.5 && miss_px < kTouchPx)) {
    return miss_px < kTouchPx ? std::vector<double>{std::atan2(foot.y(), foot.x())}
                              : std::vector<double>{};
  }
  std::vector<double> angles;
  for (double sign : {-1.0, 1.0}) {
    const Eigen::Vector2d x = p + d * ((-pd + sign * std::sqrt(discriminant)) / dd);
    angles.push_back(std::atan2(x.y(), x.x()));
  }
  return angles;
}

Eigen::Matrix2d Covariance(const Segment& segment,
                           const EllipseArc& arc,
                           const Eigen::Vector2d& point,
                           const Eigen::Vector2d& along,
                           const Eigen::Vector2d& tangent) {
  const double lever = along.dot(point - 0.5 * (segment.start + segment.end));
  const double line_variance = segment.offset_sigma_px * segment.offset_sigma_px +
                               lever * lever * segment.angle_sigma_rad * segment.angle_sigma_rad;
  // Five parameters take their share of the arc's points.
  const double points =
      std::max(arc.sweep_rad * 0.5 * (arc.semi_major_px + arc.semi_minor_px), 6.0);
  const double arc_variance = 5.0 * arc.rms_px * arc.rms_px / points;
  // x solves n_line . x = c_line, n_arc . x = c_arc; at a touch the second direction is open and
  // the sine is kept from zero.
  const Eigen::Vector2d line_normal(-along.y(), along.x());
  const Eigen::Vector2d arc_normal(-tangent.y(), tangent.x());
  constexpr double kMinSine = 0.1;  // of line and tangent; bounds the point's uncertainty
  double sine = along.x() * tangent.y() - along.y() * tangent.x();
  sine = std::copysign(std::max(std::abs(sine), kMinSine), sine);
  // Moving the line by e moves the point along the tangent by e / sine, and the other way about.
  return (line_variance * tangent * tangent.transpose() +
          arc_variance * along * along.transpose()) /
         (sine * sine);
}

}  // namespace

std::vector<ConicJunction> FindConicJunctions(const std::vector<Segment>& segments,
                                              const std::vector<EllipseArc>& arcs,
                                              const ConicJunctionOptions& options) {
  std::vector<ConicJunction> junctions;
  for (size_t a = 0; a < arcs.size(); ++a) {
    const EllipseArc& arc = arcs[a];
    const EllipseFrame frame(arc);
    const double reach = arc.semi_major_px + options.max_gap_px;
    for (size_t i = 0; i < segments.size(); ++i) {
      const Segment& segment = segments[i];
      if (segment.arc == static_cast<int>(a)) continue;
      const double length = segment.Length();
      const Eigen::Vector2d along = (segment.end - segment.start) / length;
      const double max_gap = std::min(options.max_gap_px, options.max_gap_fraction * length);
      for (bool at_start : {true, false}) {
        const Eigen::Vector2d& end = at_start ? segment.start : segment.end;
        if ((end - arc.center).squaredNorm() > reach * reach) continue;
        std::optional<ConicJunction> best;
        double best_gap = max_gap;
        for (double angle : Meetings(frame, end, along)) {
          const double travel = Wrapped(angle - arc.start_rad);
          const Eigen::Vector2d unit = UnitAt(angle);
          const Eigen::Vector2d derivative = frame.DerivativeAt(unit);
          const double radius = derivative.norm();
          const double beyond =
              travel <= arc.sweep_rad
                  ? 0.0
                  : std::min(travel - arc.sweep_rad, 2.0 * M_PI - travel) * radius;
          const double from_end = std::min(travel, std::abs(arc.sweep_rad - travel)) * radius;
          const Eigen::Vector2d point = frame.PointAt(unit);
          const double gap = (point - end).norm();
          if (gap > best_gap || beyond > options.end_gap_px) continue;
          best_gap = gap;
          const Eigen::Vector2d tangent = derivative / radius;
          ConicJunction junction;
          junction.segment = static_cast<int>(i);
          junction.at_start = at_start;
          junction.arc = static_cast<int>(a);
          junction.angle_rad = angle;
          junction.at_arc_end =
              arc.sweep_rad < 2.0 * M_PI - 0.2 &&
              std::min(from_end, beyond > 0.0 ? beyond : from_end) <= options.end_gap_px;
          junction.tangent = std::abs(along.x() * tangent.y() - along.y() * tangent.x()) <
                             std::sin(options.tangent_rad);
          junction.point = point;
          junction.covariance = Covariance(segment, arc, point, along, tangent);
          best = junction;
        }
        if (best) junctions.push_back(*best);
      }
    }
  }
  return junctions;
}

}  // namespace horopter
