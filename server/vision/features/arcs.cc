#include "server/vision/features/arcs.h"

#include <algorithm>
#include <cmath>
#include <optional>

#include "server/vision/features/ellipse_fit.h"

namespace horopter {
namespace {

constexpr int kMinPoints = 14;
constexpr double kMaxRmsPx = 0.6;
constexpr double kMinSweep = M_PI / 3.0;
constexpr double kMinSagittaPx = 2.0;
constexpr double kStraightSagittaPx = 0.6;  // over 28 points: radius above 160 px
constexpr double kMinSemiMinorPx = 2.5;
constexpr double kMaxAspect = 8.0;
constexpr double kMaxSemiMajorPx = 2000.0;
constexpr double kMinRadiusPx = 2.0;  // smallest radius of curvature, b^2 / a
constexpr double kSurelyRound = 2.6;  // an arc that turns this far is no corner
constexpr size_t kApexSkip = 3;       // points left out on each side of a corner's tip
constexpr double kStraightRmsPx = 0.25;
constexpr int kCornerReach = 4;  // points
constexpr double kCornerCosine =
    0.3;  // a turn by over 70 degrees within 8 points ends a smooth piece
constexpr double kMinJoinedCover = 0.75;  // of the joined sweep must be seen
constexpr size_t kMaxCandidates = 1500;
constexpr size_t kMaxFitPoints = 60;  // longer arcs are thinned for the fit

using Points = std::vector<Eigen::Vector2f>;

struct Candidate {
  EllipseArc arc;
  Points points;
};

Points Thin(const Eigen::Vector2f* begin, size_t count) {
  const size_t step = (count + kMaxFitPoints - 1) / kMaxFitPoints;
  Points thinned;
  for (size_t i = 0; i < count; i += step) {
    thinned.push_back(begin[i]);
  }
  return thinned;
}

std::optional<EllipseArc> TryFit(const Eigen::Vector2f* begin, size_t count) {
  const Points points = Thin(begin, count);
  std::optional<EllipseArc> arc = FitEllipse(points);
  if (!arc || arc->rms_px > kMaxRmsPx || arc->semi_minor_px < kMinSemiMinorPx ||
      arc->semi_major_px > kMaxAspect * arc->semi_minor_px ||
      arc->semi_minor_px * arc->semi_minor_px < kMinRadiusPx * arc->semi_major_px ||
      arc->semi_major_px > kMaxSemiMajorPx) {
    return std::nullopt;
  }
  return arc;
}

// Largest distance of the points from the chord between first and last.
double Sagitta(const Eigen::Vector2f* begin, size_t count) {
  const Eigen::Vector2f chord = begin[count - 1] - begin[0];
  const float length = chord.norm();
  float largest = 0.0f;
  for (size_t i = 0; i < count; ++i) {
    const Eigen::Vector2f q = begin[i] - begin[0];
    largest = std::max(
        largest,
        length < 1.0f ? q.norm() : std::abs(chord.x() * q.y() - chord.y() * q.x()) / length);
  }
  return largest;
}

// Rms distance of points from their own least-squares line.
double LineRms(const Eigen::Vector2f* begin, size_t count) {
  Eigen::Vector2d mean = Eigen::Vector2d::Zero();
  for (size_t i = 0; i < count; ++i) {
    mean += begin[i].cast<double>();
  }
  mean /= static_cast<double>(count);
  Eigen::Matrix2d moment = Eigen::Matrix2d::Zero();
  for (size_t i = 0; i < count; ++i) {
    const Eigen::Vector2d q = begin[i].cast<double>() - mean;
    moment += q * q.transpose();
  }
  moment /= static_cast<double>(count);
  const double half_trace = 0.5 * moment.trace();
  const double root = std::hypot(0.5 * (moment(0, 0) - moment(1, 1)), moment(0, 1));
  return std::sqrt(std::max(half_trace - root, 0.0));
}

// An ellipse also hugs the rounded corner of two straight edges: two lines that meet at the point
// farthest from the chord must fit clearly worse.
bool IsCorner(const Eigen::Vector2f* begin, size_t count, const EllipseArc& arc) {
  if (arc.sweep_rad > kSurelyRound) {
    return false;
  }
  const Eigen::Vector2f chord = begin[count - 1] - begin[0];
  size_t apex = 0;
  float largest = -1.0f;
  for (size_t i = 0; i < count; ++i) {
    const Eigen::Vector2f q = begin[i] - begin[0];
    const float distance = std::abs(chord.x() * q.y() - chord.y() * q.x());
    if (distance > largest) {
      largest = distance;
      apex = i;
    }
  }
  const size_t before = apex > kApexSkip ? apex - kApexSkip : 0;
  const size_t after = std::min(apex + kApexSkip, count);
  if (before < 4 || count - after < 4) {
    return true;  // nearly all of the turn happens at one end: not enough of an arc
  }
  const double worst = std::max(LineRms(begin, before), LineRms(begin + after, count - after));
  return worst < std::max(1.5 * arc.rms_px, kStraightRmsPx);
}

// Grows the longest arc that starts at `begin`; returns its number of points, 0 without one.
size_t Grow(const Eigen::Vector2f* begin, size_t available, std::optional<EllipseArc>* arc) {
  size_t good = 0;
  size_t bad = available + 1;
  // The start itself may be nearly straight, so short windows may fail to be ellipses: begin with a
  // few lengths.
  for (size_t length :
       {static_cast<size_t>(kMinPoints), static_cast<size_t>(2 * kMinPoints), available}) {
    if (length <= available && length > good) {
      if (auto fit = TryFit(begin, length)) {
        good = length;
        *arc = fit;
      } else if (good > 0) {
        bad = length;
        break;
      }
    }
  }
  while (good > 0 && bad - good > std::max<size_t>(2, good / 16) && good < available) {
    const size_t length = bad > available ? available : std::min((good + bad) / 2, 2 * good);
    if (auto fit = TryFit(begin, length)) {
      good = length;
      *arc = fit;
    } else {
      bad = length;
    }
  }
  return good;
}

void FromSmoothPiece(const Eigen::Vector2f* begin, size_t count, std::vector<Candidate>* out) {
  size_t i = 0;
  while (i + kMinPoints <= count && out->size() < kMaxCandidates) {
    const size_t window = std::min<size_t>(2 * kMinPoints, count - i);
    if (Sagitta(begin + i, window) < kStraightSagittaPx) {
      i += kMinPoints / 2;  // cheap way over straight parts
      continue;
    }
    std::optional<EllipseArc> arc;
    const size_t length = Grow(begin + i, count - i, &arc);
    if (length > 0 && arc->sweep_rad >= kMinSweep && Sagitta(begin + i, length) >= kMinSagittaPx &&
        !IsCorner(begin + i, length, *arc)) {
      out->push_back({*arc, Thin(begin + i, length)});
      i += length;
    } else {
      i += kMinPoints / 2;
    }
  }
}

// Splits a chain at its corners.
void FromChain(const EdgeChain& chain, std::vector<Candidate>* out) {
  const Points& p = chain.points;
  const int n = static_cast<int>(p.size());
  if (n >= kMinPoints) {
    // The ends of a small flat ellipse turn as fast as a corner: take the chain as a whole first.
    const std::optional<EllipseArc> whole =
        Sagitta(p.data(), p.size()) < kMinSagittaPx ? std::nullopt : TryFit(p.data(), p.size());
    if (whole && whole->sweep_rad > kSurelyRound) {
      out->push_back({*whole, Thin(p.data(), p.size())});
      return;
    }
  }
  int begin = 0;
  for (int i = 0; i <= n; ++i) {
    bool corner = i == n;
    if (i >= kCornerReach && i + kCornerReach < n) {
      const Eigen::Vector2f a = p[i] - p[i - kCornerReach];
      const Eigen::Vector2f b = p[i + kCornerReach] - p[i];
      corner = a.dot(b) < kCornerCosine * a.norm() * b.norm();
    }
    if (corner) {
      if (i - begin >= kMinPoints) {
        FromSmoothPiece(p.data() + begin, i - begin, out);
      }
      begin = i + 1;
    }
  }
}

double ArcLength(const EllipseArc& arc) {
  return arc.sweep_rad * 0.5 * (arc.semi_major_px + arc.semi_minor_px);
}

// Union of two arcs when one ellipse explains both.
bool Join(const Candidate& piece, Candidate* into) {
  const double reach = 0.5 * into->arc.semi_minor_px + 2.0;
  if ((piece.arc.center - into->arc.center).norm() > std::max(reach, piece.arc.semi_minor_px)) {
    return false;
  }
  // Cheap first: the piece must lie near the longer arc's ellipse.
  double worst = 0.0;
  for (const Eigen::Vector2f& p : piece.points) {
    worst = std::max(worst, EllipseDistance(into->arc, p.cast<double>()));
  }
  if (worst > 4.0) {
    return false;
  }
  Points all = into->points;
  all.insert(all.end(), piece.points.begin(), piece.points.end());
  std::optional<EllipseArc> joined = FitEllipse(all);
  if (!joined || joined->rms_px > kMaxRmsPx || joined->semi_minor_px < kMinSemiMinorPx ||
      SpanOf(all, &*joined) < kMinJoinedCover) {
    return false;
  }
  into->arc = *joined;
  into->points = std::move(all);
  return true;
}

}  // namespace

std::vector<EllipseArc> FindArcs(const std::vector<EdgeChain>& chains, int max_arcs) {
  std::vector<Candidate> candidates;
  for (const EdgeChain& chain : chains) {
    FromChain(chain, &candidates);
  }
  const auto longer = [](const Candidate& a, const Candidate& b) {
    return ArcLength(a.arc) > ArcLength(b.arc);
  };
  std::stable_sort(candidates.begin(), candidates.end(), longer);
  std::vector<Candidate> kept;
  for (Candidate& candidate : candidates) {
    const bool joined = std::any_of(
        kept.begin(), kept.end(), [&](Candidate& other) { return Join(candidate, &other); });
    if (!joined) {
      kept.push_back(std::move(candidate));
    }
  }
  std::stable_sort(kept.begin(), kept.end(), longer);
  std::vector<EllipseArc> arcs;
  for (const Candidate& candidate : kept) {
    if (static_cast<int>(arcs.size()) < max_arcs) {
      arcs.push_back(candidate.arc);
    }
  }
  return arcs;
}

}  // namespace horopter
