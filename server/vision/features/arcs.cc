#include "server/vision/features/arcs.h"

#include <algorithm>
#include <cmath>
#include <optional>

#include "server/vision/features/edge_cover.h"
#include "server/vision/features/ellipse_fit.h"
#include "server/vision/features/split_and_merge.h"

namespace horopter {
namespace {

constexpr int kMinPoints = 12;
constexpr double kMaxTurn = 1.25;  // between neighbouring chords of one run
constexpr double kMaxSemiMajorPx = 2000.0;
constexpr double kMinRadiusPx = 1.2;  // smallest radius of curvature, b^2 / a
constexpr double kSurelyRound = 2.6;  // an arc that turns this far is no corner
constexpr size_t kMaxFitPoints = 48;  // longer arcs are thinned for the fit
constexpr double kNearPx = 1.6;       // points this near the ellipse may be its own
constexpr double kSameDirectionCosine = 0.9;
constexpr double kMaxCovered = 0.6;  // of a run by arcs found before
constexpr double kMaxTried = 0.85;   // ... by runs of other channels tried before
constexpr double kMinSupport = 0.7;  // of the final sweep must be seen
constexpr size_t kMaxRuns = 1500;
constexpr int kMaxDropped = 2;  // chords, in all
constexpr double kTurnShare = 0.6;
constexpr double kChordPx = 0.6;  // how closely chords follow a run

using Points = std::vector<Eigen::Vector2f>;

// Points [begin, end) of a chain that turn to one side; `cuts` are the ends of its chords.
struct Run {
  int chain = 0;
  std::vector<int> cuts;
  int Size() const { return cuts.back() - cuts.front() + 1; }
};

// Gradient of the nearest edge point at each pixel.
class PointMap {
 public:
  PointMap(const std::vector<EdgeChain>& chains, int width, int height)
      : width_(width), height_(height), index_(static_cast<size_t>(width) * height, -1) {
    for (const EdgeChain& chain : chains) {
      for (size_t i = 0; i < chain.points.size(); ++i) {
        const Eigen::Vector2f& p = chain.points[i];
        const int x = static_cast<int>(p.x() + 0.5f), y = static_cast<int>(p.y() + 0.5f);
        if (x < 0 || y < 0 || x >= width || y >= height) continue;
        int32_t& slot = index_[static_cast<size_t>(y) * width + x];
        const float strength = chain.gradients[i].squaredNorm();
        if (slot >= 0 && points_[slot].strength >= strength) continue;
        slot = static_cast<int32_t>(points_.size());
        points_.push_back({p, chain.gradients[i].normalized(), strength});
      }
    }
  }

  // The points on the ellipse whose gradient is along its normal, in order of the angle.
  Points On(const EllipseArc& arc) const {
    Points found;
    const double c = std::cos(arc.angle_rad), s = std::sin(arc.angle_rad);
    const double perimeter = 2.0 * M_PI *
                             std::sqrt(0.5 * (arc.semi_major_px * arc.semi_major_px +
                                              arc.semi_minor_px * arc.semi_minor_px));
    const int steps = std::clamp(static_cast<int>(perimeter), 16, 4000);
    int32_t last = -1;
    for (int k = 0; k < steps; ++k) {
      const double t = 2.0 * M_PI * k / steps;
      const double u = arc.semi_major_px * std::cos(t), v = arc.semi_minor_px * std::sin(t);
      const Eigen::Vector2f at(static_cast<float>(arc.center.x() + c * u - s * v),
                               static_cast<float>(arc.center.y() + s * u + c * v));
      const double nu = std::cos(t) / arc.semi_major_px, nv = std::sin(t) / arc.semi_minor_px;
      const Eigen::Vector2f normal =
          Eigen::Vector2d(c * nu - s * nv, s * nu + c * nv).normalized().cast<float>();
      const int32_t best = Nearest(at, normal);
      if (best >= 0 && best != last) {
        found.push_back(points_[best].position);
        last = best;
      }
    }
    return found;
  }

 private:
  struct Entry {
    Eigen::Vector2f position;
    Eigen::Vector2f normal;
    float strength = 0.0f;
  };

  int32_t Nearest(const Eigen::Vector2f& at, const Eigen::Vector2f& normal) const {
    const int cx = static_cast<int>(std::lround(at.x())),
              cy = static_cast<int>(std::lround(at.y()));
    int32_t best = -1;
    float best_square = static_cast<float>(kNearPx * kNearPx);
    for (int y = std::max(cy - 1, 0); y <= std::min(cy + 1, height_ - 1); ++y) {
      for (int x = std::max(cx - 1, 0); x <= std::min(cx + 1, width_ - 1); ++x) {
        const int32_t id = index_[static_cast<size_t>(y) * width_ + x];
        if (id < 0 || std::abs(points_[id].normal.dot(normal)) < kSameDirectionCosine) continue;
        const float square = (points_[id].position - at).squaredNorm();
        if (square < best_square) {
          best_square = square;
          best = id;
        }
      }
    }
    return best;
  }

  int width_;
  int height_;
  std::vector<int32_t> index_;
  std::vector<Entry> points_;
};

Points Thin(const Eigen::Vector2f* begin, size_t count) {
  const size_t step = (count + kMaxFitPoints - 1) / kMaxFitPoints;
  Points thinned;
  for (size_t i = 0; i < count; i += step) {
    thinned.push_back(begin[i]);
  }
  return thinned;
}

bool Plausible(const EllipseArc& arc, const ArcOptions& options) {
  return arc.rms_px <= options.max_rms_px && arc.semi_minor_px >= options.min_semi_minor_px &&
         arc.semi_major_px <= options.max_aspect * arc.semi_minor_px &&
         arc.semi_minor_px * arc.semi_minor_px >= kMinRadiusPx * arc.semi_major_px &&
         arc.semi_major_px <= kMaxSemiMajorPx;
}

// Largest distance of the points from the chord between first and last, and where.
std::pair<double, size_t> Sagitta(const Eigen::Vector2f* begin, size_t count) {
  const Eigen::Vector2f chord = begin[count - 1] - begin[0];
  const float length = chord.norm();
  std::pair<double, size_t> largest = {-1.0, 0};
  for (size_t i = 0; i < count; ++i) {
    const Eigen::Vector2f q = begin[i] - begin[0];
    const double distance =
        length < 1.0f ? q.norm() : std::abs(chord.x() * q.y() - chord.y() * q.x()) / length;
    if (distance > largest.first) {
      largest = {distance, i};
    }
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
  const double skew = 0.5 * (moment(0, 0) - moment(1, 1));
  const double root = std::sqrt(skew * skew + moment(0, 1) * moment(0, 1));
  return std::sqrt(std::max(half_trace - root, 0.0));
}

// An ellipse also hugs the rounded corner of two straight edges: two lines that meet at the point
// farthest from the chord must fit clearly worse.
bool IsCorner(const Eigen::Vector2f* begin, size_t count, const EllipseArc& arc) {
  constexpr size_t kApexSkip = 3;  // points left out on each side of a corner's tip
  constexpr double kStraightRmsPx = 0.25;
  if (arc.sweep_rad > kSurelyRound) {
    return false;
  }
  const size_t apex = Sagitta(begin, count).second;
  const size_t before = apex > kApexSkip ? apex - kApexSkip : 0;
  const size_t after = std::min(apex + kApexSkip, count);
  if (before < 4 || count - after < 4) {
    return true;  // nearly all of the turn happens at one end: not enough of an arc
  }
  const double worst = std::max(LineRms(begin, before), LineRms(begin + after, count - after));
  return worst < std::max(1.5 * arc.rms_px, kStraightRmsPx);
}

// Cuts a chain into runs that turn to one side.
void CollectRuns(const EdgeChain& chain, int index, std::vector<Run>* runs) {
  SplitAndMergeOptions split;
  split.split_px = kChordPx;
  split.merge_rms_px = 0.0;
  split.min_points = 2;
  const std::vector<ChainPiece> pieces = SplitAndMerge(chain.points, split);
  Run run;
  run.chain = index;
  double side = 0.0;
  Eigen::Vector2f last = Eigen::Vector2f::Zero();
  const auto finish = [&] {
    if (run.cuts.size() >= 4 && run.Size() >= kMinPoints) runs->push_back(run);
  };
  for (const ChainPiece& piece : pieces) {
    const Eigen::Vector2f chord = chain.points[piece.end - 1] - chain.points[piece.begin];
    const double turn = std::atan2(last.x() * chord.y() - last.y() * chord.x(), last.dot(chord));
    const bool goes_on = !run.cuts.empty() && run.cuts.back() == piece.begin &&
                         std::abs(turn) < kMaxTurn && turn * side >= 0.0;
    if (goes_on) {
      run.cuts.push_back(piece.end - 1);
      side = turn;
    } else {
      finish();
      // The chord before may open the next run: a turn to the other side starts there.
      const bool share = !run.cuts.empty() && run.cuts.size() >= 2 &&
                         run.cuts.back() == piece.begin && std::abs(turn) < kMaxTurn;
      const int before = share ? run.cuts[run.cuts.size() - 2] : -1;
      run.cuts.clear();
      if (share) run.cuts.push_back(before);
      run.cuts.push_back(piece.begin);
      run.cuts.push_back(piece.end - 1);
      side = share ? turn : 0.0;
    }
    last = chord;
  }
  finish();
}

std::optional<EllipseArc> TryRange(const EdgeChain& chain,
                                   int first,
                                   int last,
                                   const ArcOptions& options) {
  const auto count = static_cast<size_t>(last - first + 1);
  if (count < kMinPoints) {
    return std::nullopt;
  }
  const Eigen::Vector2f* begin = chain.points.data() + first;
  if (Sagitta(begin, count).first < options.min_sagitta_px) {
    return std::nullopt;
  }
  std::optional<EllipseArc> arc = FitEllipse(Thin(begin, count));
  if (!arc || !Plausible(*arc, options) || arc->sweep_rad < options.min_sweep_rad ||
      IsCorner(begin, count, *arc)) {
    return std::nullopt;
  }
  return arc;
}

// Angle between the first and the last chord of cuts [front, back], along the way.
double Turn(const EdgeChain& chain, const Run& run, int front, int back) {
  double turn = 0.0;
  for (int k = front; k + 2 <= back; ++k) {
    const Eigen::Vector2f a = chain.points[run.cuts[k + 1]] - chain.points[run.cuts[k]];
    const Eigen::Vector2f b = chain.points[run.cuts[k + 2]] - chain.points[run.cuts[k + 1]];
    turn += std::atan2(a.x() * b.y() - a.y() * b.x(), a.dot(b));
  }
  return std::abs(turn);
}

// The whole run, or what is left of it without the chords at its ends, which may be straight edges
// that run into the arc.
std::optional<EllipseArc> FitRun(const EdgeChain& chain,
                                 const Run& run,
                                 const ArcOptions& options) {
  const int n = static_cast<int>(run.cuts.size());
  for (int dropped = 0; dropped <= std::min(n - 4, kMaxDropped); ++dropped) {
    for (int front = 0; front <= dropped; ++front) {
      const int back = n - 1 - (dropped - front);
      const int first = run.cuts[front], last = run.cuts[back];
      // The chords at both ends of an arc miss about half a chord's turn each.
      if (Turn(chain, run, front, back) < kTurnShare * options.min_sweep_rad) continue;
      if (auto arc = TryRange(chain, first, last, options)) {
        return arc;
      }
    }
  }
  return std::nullopt;
}

double ArcLength(const EllipseArc& arc) {
  return arc.sweep_rad * 0.5 * (arc.semi_major_px + arc.semi_minor_px);
}

// Fits again to every point on the ellipse; empty when they no longer make one.
std::optional<EllipseArc> Collect(EllipseArc arc, const PointMap& map, const ArcOptions& options) {
  for (int round = 0; round < 2; ++round) {
    const Points points = map.On(arc);
    if (points.size() < static_cast<size_t>(kMinPoints)) {
      return std::nullopt;
    }
    std::optional<EllipseArc> again = FitEllipse(Thin(points.data(), points.size()));
    if (!again || !Plausible(*again, options)) {
      return round == 0 ? std::nullopt : std::optional<EllipseArc>(arc);
    }
    arc = *again;
    if (SpanOf(points, &arc) < kMinSupport || arc.sweep_rad < options.min_sweep_rad) {
      return std::nullopt;
    }
  }
  return arc;
}

}  // namespace

std::vector<EllipseArc> FindArcs(const std::vector<EdgeChain>& chains,
                                 int width,
                                 int height,
                                 const ArcOptions& options) {
  std::vector<Run> runs;
  for (size_t c = 0; c < chains.size(); ++c) {
    if (chains[c].points.size() >= static_cast<size_t>(kMinPoints)) {
      CollectRuns(chains[c], static_cast<int>(c), &runs);
    }
  }
  std::stable_sort(
      runs.begin(), runs.end(), [](const Run& a, const Run& b) { return a.Size() > b.Size(); });
  if (runs.size() > kMaxRuns) runs.resize(kMaxRuns);
  std::vector<EllipseArc> arcs;
  if (runs.empty()) {
    return arcs;
  }
  const PointMap map(chains, width, height);
  EdgeCover found(width, height), tried(width, height);
  for (const Run& run : runs) {
    const EdgeChain& chain = chains[run.chain];
    int covered = 0, known = 0;
    for (int i = run.cuts.front(); i <= run.cuts.back(); ++i) {
      const uint8_t direction = EdgeCover::EdgeDirection(chain.gradients[i]);
      covered += found.Covers(chain.points[i], direction) ? 1 : 0;
      known += tried.Covers(chain.points[i], direction) ? 1 : 0;
    }
    if (covered > kMaxCovered * run.Size() || known > kMaxTried * run.Size()) {
      continue;
    }
    for (int i = run.cuts.front(); i <= run.cuts.back(); ++i) {
      tried.Mark(chain.points[i], EdgeCover::EdgeDirection(chain.gradients[i]));
    }
    const std::optional<EllipseArc> seed = FitRun(chain, run, options);
    std::optional<EllipseArc> arc = seed ? Collect(*seed, map, options) : std::nullopt;
    if (!arc) {
      continue;
    }
    const double c = std::cos(arc->angle_rad), s = std::sin(arc->angle_rad);
    const int steps = std::max(8, static_cast<int>(2.0 * ArcLength(*arc)));
    for (int k = 0; k <= steps; ++k) {
      const double t = arc->start_rad + arc->sweep_rad * k / steps;
      const double u = arc->semi_major_px * std::cos(t), v = arc->semi_minor_px * std::sin(t);
      const double nu = std::cos(t) / arc->semi_major_px, nv = std::sin(t) / arc->semi_minor_px;
      found.Mark(Eigen::Vector2d(arc->center.x() + c * u - s * v, arc->center.y() + s * u + c * v)
                     .cast<float>(),
                 EdgeCover::EdgeDirection(
                     Eigen::Vector2d(c * nu - s * nv, s * nu + c * nv).cast<float>()));
    }
    arcs.push_back(*arc);
  }
  std::stable_sort(arcs.begin(), arcs.end(), [](const EllipseArc& a, const EllipseArc& b) {
    return ArcLength(a) > ArcLength(b);
  });
  if (static_cast<int>(arcs.size()) > options.max_arcs) {
    arcs.resize(options.max_arcs);
  }
  return arcs;
}

}  // namespace horopter
