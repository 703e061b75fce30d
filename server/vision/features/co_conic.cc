#include "server/vision/features/co_conic.h"

#include <algorithm>
#include <cmath>

#include "server/vision/features/ellipse_frame.h"

namespace horopter {
namespace {

struct RimSample {
  Eigen::Vector2d point;
  Eigen::Vector2d tangent;
  bool straight = false;
};

std::vector<RimSample> Sample(const EllipseArc& arc) {
  const EllipseFrame frame(arc);
  const double length = arc.sweep_rad * 0.5 * (arc.semi_major_px + arc.semi_minor_px);
  const int steps = std::clamp(static_cast<int>(length), 8, 4000);
  std::vector<RimSample> samples(steps + 1);
  for (int k = 0; k <= steps; ++k) {
    const Eigen::Vector2d unit = UnitAt(arc.start_rad + arc.sweep_rad * k / steps);
    samples[k].point = frame.PointAt(unit);
    samples[k].tangent = frame.DerivativeAt(unit).normalized();
  }
  return samples;
}

// Marks the samples on the segment; returns the share of the segment that they span.
double SpanOnSegment(const Segment& segment,
                     const CoConicOptions& options,
                     std::vector<RimSample>* samples,
                     std::vector<int>* on) {
  on->clear();
  const double length = segment.Length();
  const Eigen::Vector2d u = (segment.end - segment.start) / length;
  const double sine = std::sin(options.angle_rad);
  double first = length, last = 0.0;
  for (size_t k = 0; k < samples->size(); ++k) {
    const RimSample& sample = (*samples)[k];
    const Eigen::Vector2d q = sample.point - segment.start;
    const double along = u.dot(q);
    if (along < -options.near_px || along > length + options.near_px ||
        std::abs(u.x() * q.y() - u.y() * q.x()) > options.near_px ||
        std::abs(u.x() * sample.tangent.y() - u.y() * sample.tangent.x()) > sine) {
      continue;
    }
    on->push_back(static_cast<int>(k));
    first = std::min(first, along);
    last = std::max(last, along);
  }
  return std::clamp((last - first) / length, 0.0, 1.0);
}

}  // namespace

int ReconcileArcs(const CoConicOptions& options,
                  std::vector<EllipseArc>* arcs,
                  std::vector<Segment>* segments) {
  std::vector<EllipseArc> kept;
  std::vector<int> on, chords;
  for (const EllipseArc& arc : *arcs) {
    std::vector<RimSample> samples = Sample(arc);
    Eigen::Vector2d low = samples[0].point, high = low;
    for (const RimSample& sample : samples) {
      low = low.cwiseMin(sample.point);
      high = high.cwiseMax(sample.point);
    }
    low.array() -= options.near_px;
    high.array() += options.near_px;
    chords.clear();
    for (size_t i = 0; i < segments->size(); ++i) {
      const Segment& segment = (*segments)[i];
      if ((segment.start.cwiseMax(segment.end).array() < low.array()).any() ||
          (segment.start.cwiseMin(segment.end).array() > high.array()).any()) {
        continue;
      }
      if (SpanOnSegment(segment, options, &samples, &on) >= options.chord_share) {
        chords.push_back(static_cast<int>(i));
      } else {
        for (int k : on) samples[k].straight = true;
      }
    }
    const auto straight = std::count_if(
        samples.begin(), samples.end(), [](const RimSample& sample) { return sample.straight; });
    if (static_cast<double>(straight) >
        options.max_straight_share * static_cast<double>(samples.size())) {
      continue;
    }
    for (int i : chords) (*segments)[i].arc = static_cast<int>(kept.size());
    kept.push_back(arc);
  }
  const int dropped = static_cast<int>(arcs->size() - kept.size());
  *arcs = std::move(kept);
  return dropped;
}

}  // namespace horopter
