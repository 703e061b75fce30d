#include "server/vision/features/rim_evidence.h"

#include <algorithm>
#include <array>
#include <cmath>

#include "server/vision/features/ellipse_fit.h"
#include "server/vision/features/ellipse_frame.h"

namespace horopter {
namespace {

constexpr int kMaxReach = 4;                 // px across the curve on each side
constexpr int kOffsets = 2 * kMaxReach + 1;  // px across the curve in all
constexpr int kHalfWindow = 2;               // places averaged on each side
constexpr int kMinPlaces = 16;               // along the curve
constexpr int kMaxPlaces = 1500;             // along the curve; for time
constexpr float kMaxAlong = 0.6f;        // slope along the curve over the slope across: 31 degrees
constexpr int kMinSeen = 10;             // twice the five of an ellipse
constexpr double kFullStrength = 1.5;    // thresholds; stronger is not surer
constexpr double kHopelessShare = 0.35;  // of all places seen in the first round
constexpr size_t kMaxRimPoints = 96;     // of an ellipse's fit; for time
// The field's sum over 3x3 pixels is 6 x the slope.
constexpr float kSumPerSlope = 6.0f / static_cast<float>(kSlopeUnits);

struct Place {
  double angle_rad = 0.0;
  Eigen::Vector2f at;
  Eigen::Vector2f normal;
};

std::vector<Place> PlacesOn(const EllipseArc& arc) {
  const EllipseFrame frame(arc);
  const double a = arc.semi_major_px, b = arc.semi_minor_px;
  const double perimeter = M_PI * (3.0 * (a + b) - std::sqrt((3.0 * a + b) * (a + 3.0 * b)));
  const int n = std::clamp(static_cast<int>(perimeter), kMinPlaces, kMaxPlaces);
  std::vector<Place> places;
  places.reserve(n + 8);
  // Equal steps of arc length, not of the angle: a slim ellipse bends only at its ends.
  const double step = perimeter / n;
  for (double t = 0.0; t < 2.0 * M_PI;) {
    const Eigen::Vector2d unit = UnitAt(t);
    places.push_back({t, frame.PointAt(unit).cast<float>(), frame.NormalAt(unit).cast<float>()});
    t += step / frame.DerivativeAt(unit).norm();
  }
  return places;
}

// Slopes across and along the curve, in thresholds.
using SlopeProfile = std::array<Eigen::Vector2f, kOffsets>;

// Slopes of a field in thresholds of their channels.
class SlopeField {
 public:
  explicit SlopeField(const GradientField& field) : field_(field) {
    for (size_t c = 0; c < scale_.size(); ++c) {
      scale_[c] = kSumPerSlope / static_cast<float>(field.threshold[c]);
    }
  }

  // 0 outside the image.
  Eigen::Vector2f At(const Eigen::Vector2f& p, const Eigen::Vector2f& normal) const {
    const int x = static_cast<int>(p.x() + 0.5f), y = static_cast<int>(p.y() + 0.5f);
    if (p.x() < 0.0f || p.y() < 0.0f || x >= field_.dx.cols || y >= field_.dx.rows) {
      return Eigen::Vector2f::Zero();
    }
    const int channel =
        field_.single_channel >= 0 ? field_.single_channel : field_.channel.ptr<uint8_t>(y)[x];
    const float dx = field_.dx.ptr<int16_t>(y)[x], dy = field_.dy.ptr<int16_t>(y)[x];
    return scale_[channel] *
           Eigen::Vector2f(normal.x() * dx + normal.y() * dy, normal.x() * dy - normal.y() * dx);
  }

 private:
  const GradientField& field_;
  std::array<float, 5> scale_{};
};

// Mean of each offset over the neighbouring places, across without sign.
std::vector<SlopeProfile> Profiles(const std::vector<Place>& places,
                                   const SlopeField& field,
                                   int reach) {
  const int n = static_cast<int>(places.size());
  std::vector<SlopeProfile> raw(n), mean(n);
  for (int k = 0; k < n; ++k) {
    for (int o = -reach; o <= reach; ++o) {
      raw[k][o + kMaxReach] =
          field.At(places[k].at + static_cast<float>(o) * places[k].normal, places[k].normal);
    }
  }
  for (int o = kMaxReach - reach; o <= kMaxReach + reach; ++o) {
    Eigen::Vector2f sum = Eigen::Vector2f::Zero();
    for (int k = -kHalfWindow; k <= kHalfWindow; ++k) sum += raw[(k + n) % n][o];
    for (int k = 0; k < n; ++k) {
      mean[k][o] = sum.cwiseAbs() / (2 * kHalfWindow + 1);
      sum += raw[(k + kHalfWindow + 1) % n][o] - raw[(k - kHalfWindow + n) % n][o];
    }
  }
  return mean;
}

}  // namespace

std::vector<RimPoint> MeasureRim(const EllipseArc& ellipse,
                                 std::span<const GradientField> fields,
                                 double reach_px) {
  const std::vector<Place> places = PlacesOn(ellipse);
  const int reach = std::clamp(static_cast<int>(std::ceil(reach_px)), 1, kMaxReach);
  std::vector<RimPoint> rim(places.size());
  for (size_t k = 0; k < places.size(); ++k) rim[k].angle_rad = places[k].angle_rad;
  for (const GradientField& field : fields) {
    const std::vector<SlopeProfile> profiles = Profiles(places, SlopeField(field), reach);
    for (size_t k = 0; k < places.size(); ++k) {
      const SlopeProfile& v = profiles[k];
      // An end of the reach is no peak: the slope may go on beyond.
      for (int o = kMaxReach - reach + 1; o < kMaxReach + reach; ++o) {
        const float before = v[o - 1].x(), here = v[o].x(), after = v[o + 1].x();
        // An edge that crosses the curve is none of its own.
        if (here <= rim[k].strength || here < before || here <= after ||
            v[o].y() > kMaxAlong * here) {
          continue;
        }
        const float bend = before - 2.0f * here + after;
        const float shift = bend < 0.0f ? 0.5f * (before - after) / bend : 0.0f;
        rim[k].strength = here;
        rim[k].offset_px = static_cast<float>(o - kMaxReach) + shift;
      }
    }
  }
  for (size_t k = 0; k < places.size(); ++k) {
    rim[k].peak = places[k].at + static_cast<float>(rim[k].offset_px) * places[k].normal;
  }
  return rim;
}

namespace {

std::vector<Eigen::Vector2f> ThinRim(const std::vector<Eigen::Vector2f>& points) {
  const size_t step = (points.size() + kMaxRimPoints - 1) / kMaxRimPoints;
  if (step <= 1) return points;
  std::vector<Eigen::Vector2f> thinned;
  for (size_t i = 0; i < points.size(); i += step) thinned.push_back(points[i]);
  return thinned;
}

// Fit, then again without the points that lie off.
std::optional<EllipseArc> FitRobustly(std::vector<Eigen::Vector2f> points, double max_offset_px) {
  std::optional<EllipseArc> arc = FitWholeEllipse(ThinRim(points));
  if (arc) {
    const EllipseFrame frame(*arc);
    std::vector<Eigen::Vector2f> near;
    for (const Eigen::Vector2f& p : points) {
      if (frame.DistanceOf(p.cast<double>()) <= max_offset_px) near.push_back(p);
    }
    if (static_cast<int>(near.size()) < kMinSeen) return std::nullopt;
    arc = FitWholeEllipse(ThinRim(near));
  }
  return arc;
}

// A first look at a few places, without averaging: most guesses in clutter end here.
bool IsHopeless(const EllipseArc& seed,
                std::span<const GradientField> fields,
                const RimOptions& options,
                double min_share) {
  constexpr int kLooks = 24;  // places along the curve, 15 degrees apart
  constexpr int kReach = 2;   // px across the curve on each side
  static const auto kUnits = [] {
    std::array<Eigen::Vector2d, kLooks> units;
    for (int k = 0; k < kLooks; ++k) units[k] = UnitAt(2.0 * M_PI * k / kLooks);
    return units;
  }();
  const EllipseFrame frame(seed);
  std::array<bool, kLooks> seen{};
  for (const GradientField& field : fields) {
    const SlopeField slopes(field);
    for (int k = 0; k < kLooks; ++k) {
      const Eigen::Vector2f at = frame.PointAt(kUnits[k]).cast<float>();
      const Eigen::Vector2f normal = frame.NormalAt(kUnits[k]).cast<float>();
      for (int o = -kReach; o <= kReach && !seen[k]; ++o) {
        const Eigen::Vector2f slope =
            slopes.At(at + static_cast<float>(o) * normal, normal).cwiseAbs();
        seen[k] = slope.x() >= static_cast<float>(options.min_strength) &&
                  slope.y() <= kMaxAlong * slope.x();
      }
    }
  }
  return std::count(seen.begin(), seen.end(), true) < min_share * kLooks;
}

}  // namespace

std::optional<FittedRim> FitRim(const EllipseArc& seed,
                                std::span<const GradientField> fields,
                                const RimOptions& options) {
  FittedRim rim;
  rim.arc = seed;
  const double min_share = std::min(kHopelessShare, seed.sweep_rad / (2.0 * M_PI));
  // What a guess claims of the rim it must show.
  if (IsHopeless(seed, fields, options, options.first_look_share * min_share / kHopelessShare)) {
    return std::nullopt;
  }
  for (int round = 0; round <= options.rounds; ++round) {
    const bool last = round == options.rounds;
    const std::vector<RimPoint> places = MeasureRim(rim.arc, fields, round == 0 ? 3.0 : 2.0);
    std::vector<Eigen::Vector2f> seen;
    rim.score = 0.0;
    for (const RimPoint& place : places) {
      if (place.strength >= options.min_strength &&
          (!last || std::abs(place.offset_px) <= options.max_offset_px)) {
        seen.push_back(place.peak);
        const double r = place.offset_px / options.max_offset_px;
        rim.score += std::min(place.strength / kFullStrength, 1.0) * (1.0 - r * r);
      }
    }
    if (static_cast<int>(seen.size()) < kMinSeen ||
        static_cast<double>(seen.size()) < min_share * static_cast<double>(places.size())) {
      return std::nullopt;
    }
    if (last) {
      rim.seen_share = SpanOf(seen, &rim.arc);
      rim.score -= (1.0 - rim.seen_share) * rim.arc.sweep_rad / (2.0 * M_PI) *
                   static_cast<double>(places.size());
      return rim;
    }
    std::optional<EllipseArc> arc = FitRobustly(std::move(seen), options.max_offset_px);
    if (!arc) {
      return std::nullopt;
    }
    rim.arc = *arc;
  }
  return std::nullopt;
}

}  // namespace horopter
