#include "server/vision/features/arc_seeds.h"

#include <algorithm>
#include <cmath>
#include <optional>

#include "server/base/stop_scope.h"
#include "server/vision/features/edge_cover.h"
#include "server/vision/features/ellipse_fit.h"
#include "server/vision/features/line_scatter.h"
#include "server/vision/features/stop_paces.h"

namespace horopter {
namespace {

constexpr int kMinArcPoints = 12;           // over twice the five of an ellipse
constexpr double kMaxTurn = 1.25;           // between neighbouring chords of one run
constexpr double kMaxSemiMajorPx = 2000.0;  // larger ones are straight within an image
constexpr double kMinRadiusPx = 1.2;        // smallest radius of curvature, b^2 / a
constexpr double kSurelyRound = 2.6;        // an arc that turns this far is no corner
constexpr size_t kMaxFitPoints = 48;        // longer arcs are thinned for the fit
constexpr double kMaxTried = 0.85;          // of a run by runs of other channels tried before
constexpr size_t kMaxRuns = 1500;           // longest first; for time
constexpr int kMaxDropped = 4;              // chords, in all
constexpr double kTurnShare = 0.6;  // of the least sweep: the chords at both ends miss some of it
constexpr double kChordPx = 0.6;    // how closely chords follow a run

using Points = std::vector<Eigen::Vector2f>;

// Points [begin, end) of a chain that turn to one side; `cuts` are the ends of its chords.
struct Run {
  int chain = 0;
  std::vector<int> cuts;
  int Size() const { return cuts.back() - cuts.front() + 1; }
};

Points Thin(const Eigen::Vector2f* begin, size_t count) {
  const size_t step = (count + kMaxFitPoints - 1) / kMaxFitPoints;
  Points thinned;
  for (size_t i = 0; i < count; i += step) {
    thinned.push_back(begin[i]);
  }
  return thinned;
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
  return std::sqrt(ScatterOf({begin, count}).SquareAcross());
}

// An ellipse also hugs the rounded corner of two straight edges: two lines that meet at the point
// farthest from the chord must fit clearly worse.
bool IsCorner(const Eigen::Vector2f* begin, size_t count, const EllipseArc& arc) {
  constexpr size_t kApexSkip = 3;          // points left out on each side of a corner's tip
  constexpr double kStraightRmsPx = 0.25;  // two straight pieces that fit as well are a corner
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
void CollectRuns(const EdgeChain& chain,
                 const std::vector<ChainPiece>& pieces,
                 int index,
                 std::vector<Run>* runs) {
  Run run;
  run.chain = index;
  double side = 0.0;
  Eigen::Vector2f last = Eigen::Vector2f::Zero();
  const auto finish = [&] {
    if (run.cuts.size() >= 3 && run.Size() >= kMinArcPoints) runs->push_back(run);
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
                                   const ArcSeedOptions& options) {
  const auto count = static_cast<size_t>(last - first + 1);
  if (count < kMinArcPoints) {
    return std::nullopt;
  }
  const Eigen::Vector2f* begin = chain.points.data() + first;
  if (Sagitta(begin, count).first < options.min_sagitta_px) {
    return std::nullopt;
  }
  std::optional<EllipseArc> arc = FitEllipse(Thin(begin, count));
  if (!arc || !IsPlausibleEllipse(*arc, options) || arc->sweep_rad < options.min_sweep_rad ||
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

// Seeds of a run: the whole of it, then what is left without chords at its ends, which may be
// straight edges that run into the arc, or another rim.
std::vector<EllipseArc> SeedsOf(const EdgeChain& chain,
                                const Run& run,
                                const ArcSeedOptions& options) {
  std::vector<EllipseArc> seeds;
  const int n = static_cast<int>(run.cuts.size());
  for (int dropped = 0; dropped <= std::min(n - 3, kMaxDropped); ++dropped) {
    for (int front = 0; front <= dropped; ++front) {
      const int back = n - 1 - (dropped - front);
      // The chords at both ends of an arc miss about half a chord's turn each.
      if (Turn(chain, run, front, back) < kTurnShare * options.min_sweep_rad) continue;
      if (auto arc = TryRange(chain, run.cuts[front], run.cuts[back], options)) {
        seeds.push_back(*arc);
      }
    }
  }
  return seeds;
}

// A short piece of chain bent to one side.
struct Bow {
  const Eigen::Vector2f* begin = nullptr;
  int count = 0;
  Eigen::Vector2f middle = Eigen::Vector2f::Zero();
  Eigen::Vector2f inward = Eigen::Vector2f::Zero();  // unit, to the side it is bent to
  float weight = 0.0f;
};

constexpr int kMinBowPoints = 7;          // to have a direction at both ends
constexpr int kMaxBowPoints = 60;         // longer ones are runs of their own
constexpr double kMinBowTurn = 0.25;      // rad; less may be a straight edge's noise
constexpr double kMaxBowTurn = 0.85;      // between its chords: more is a corner
constexpr float kMinFacing = 0.25f;       // sine of half the angle between two bows of a rim
constexpr size_t kMaxPairFitPoints = 24;  // of a pair of bows; for time

void CollectBows(const EdgeChain& chain,
                 const std::vector<ChainPiece>& pieces,
                 std::vector<Bow>* bows) {
  for (size_t k = 0; k + 1 < pieces.size(); ++k) {
    const ChainPiece& a = pieces[k];
    const ChainPiece& b = pieces[k + 1];
    const int count = b.end - a.begin;
    if (a.end - 1 != b.begin || count < kMinBowPoints || count > kMaxBowPoints) continue;
    const Eigen::Vector2f u = chain.points[a.end - 1] - chain.points[a.begin];
    const Eigen::Vector2f v = chain.points[b.end - 1] - chain.points[b.begin];
    const float turn = std::atan2(u.x() * v.y() - u.y() * v.x(), u.dot(v));
    if (std::abs(turn) < kMinBowTurn || std::abs(turn) > kMaxBowTurn) continue;
    Bow bow;
    bow.begin = chain.points.data() + a.begin;
    bow.count = count;
    bow.middle = chain.points[a.begin + count / 2];
    const Eigen::Vector2f chord = (u + v).normalized();
    bow.inward = turn > 0.0f ? Eigen::Vector2f(-chord.y(), chord.x())
                             : Eigen::Vector2f(chord.y(), -chord.x());
    for (int i = a.begin; i < b.end; ++i) bow.weight += chain.gradients[i].norm();
    bows->push_back(bow);
  }
}

// Each bow lies on the inner side of the other.
bool Face(const Bow& a, const Bow& b, float max_distance_px) {
  const Eigen::Vector2f between = b.middle - a.middle;
  const float distance = between.norm();
  return distance > 3.0f && distance < max_distance_px &&
         a.inward.dot(between) > kMinFacing * distance &&
         -b.inward.dot(between) > kMinFacing * distance;
}

std::optional<EllipseArc> FitPair(const Bow& a, const Bow& b, const ArcSeedOptions& options) {
  const size_t step = (a.count + b.count + kMaxPairFitPoints - 1) / kMaxPairFitPoints;
  Points points;
  for (const Bow* bow : {&a, &b}) {
    for (int i = 0; i < bow->count; i += static_cast<int>(step)) points.push_back(bow->begin[i]);
  }
  std::optional<EllipseArc> arc = FitEllipse(points);
  if (!arc || arc->rms_px > options.max_pair_rms_px || !IsPlausibleEllipse(*arc, options)) {
    return std::nullopt;
  }
  return arc;
}

}  // namespace

bool IsPlausibleEllipse(const EllipseArc& arc, const ArcSeedOptions& options) {
  return arc.rms_px <= options.max_rms_px && arc.semi_minor_px >= options.min_semi_minor_px &&
         arc.semi_major_px <= options.max_aspect * arc.semi_minor_px &&
         arc.semi_minor_px * arc.semi_minor_px >= kMinRadiusPx * arc.semi_major_px &&
         arc.semi_major_px <= kMaxSemiMajorPx;
}

std::vector<std::vector<ChainPiece>> ChordsOf(const std::vector<EdgeChain>& chains) {
  SplitAndMergeOptions split;
  split.split_px = kChordPx;
  split.merge_rms_px = 0.0;
  split.min_points = 2;
  std::vector<std::vector<ChainPiece>> chords;
  chords.reserve(chains.size());
  StopPacer pacer(kChainsPerLook);
  for (const EdgeChain& chain : chains) {
    pacer.Step();
    chords.push_back(SplitAndMerge(chain.points, split));
  }
  return chords;
}

std::vector<EllipseArc> SeedsOfRuns(const std::vector<EdgeChain>& chains,
                                    const std::vector<std::vector<ChainPiece>>& chords,
                                    int width,
                                    int height,
                                    const ArcSeedOptions& options) {
  std::vector<Run> runs;
  StopPacer pacer(kChainsPerLook);
  for (size_t c = 0; c < chains.size(); ++c) {
    pacer.Step();
    if (chains[c].points.size() >= static_cast<size_t>(kMinArcPoints)) {
      CollectRuns(chains[c], chords[c], static_cast<int>(c), &runs);
    }
  }
  StopPacer comparisons(kComparisonsPerLook);
  std::stable_sort(runs.begin(), runs.end(), [&](const Run& a, const Run& b) {
    comparisons.Step();
    return a.Size() > b.Size();
  });
  if (runs.size() > kMaxRuns) runs.resize(kMaxRuns);
  std::vector<EllipseArc> seeds;
  EdgeCover tried(width, height);
  for (const Run& run : runs) {
    LeaveIfStopped();
    if (seeds.size() >= static_cast<size_t>(options.max_run_seeds)) break;
    const EdgeChain& chain = chains[run.chain];
    int known = 0;
    for (int i = run.cuts.front(); i <= run.cuts.back(); ++i) {
      known += tried.Covers(chain.points[i], EdgeCover::EdgeDirection(chain.gradients[i])) ? 1 : 0;
    }
    if (known > kMaxTried * run.Size()) continue;
    for (int i = run.cuts.front(); i <= run.cuts.back(); ++i) {
      tried.Mark(chain.points[i], EdgeCover::EdgeDirection(chain.gradients[i]));
    }
    const std::vector<EllipseArc> of_run = SeedsOf(chain, run, options);
    seeds.insert(seeds.end(), of_run.begin(), of_run.end());
  }
  return seeds;
}

std::vector<EllipseArc> SeedsOfPairs(const std::vector<EdgeChain>& chains,
                                     const std::vector<std::vector<ChainPiece>>& chords,
                                     const ArcSeedOptions& options) {
  std::vector<Bow> bows;
  StopPacer pacer(kChainsPerLook);
  for (size_t c = 0; c < chains.size(); ++c) {
    pacer.Step();
    CollectBows(chains[c], chords[c], &bows);
  }
  StopPacer comparisons(kComparisonsPerLook);
  std::stable_sort(bows.begin(), bows.end(), [&](const Bow& a, const Bow& b) {
    comparisons.Step();
    return a.weight > b.weight;
  });
  if (bows.size() > static_cast<size_t>(options.max_bows)) bows.resize(options.max_bows);
  std::vector<EllipseArc> seeds;
  const auto reach = static_cast<float>(options.max_bow_distance_px);
  std::vector<std::pair<float, size_t>> partners;
  for (size_t i = 0; i < bows.size(); ++i) {
    LeaveIfStopped();
    partners.clear();
    for (size_t j = i + 1; j < bows.size(); ++j) {
      if (Face(bows[i], bows[j], reach)) {
        partners.emplace_back((bows[j].middle - bows[i].middle).squaredNorm(), j);
      }
    }
    const size_t count = std::min<size_t>(partners.size(), options.partners);
    std::partial_sort(partners.begin(), partners.begin() + count, partners.end());
    for (size_t p = 0; p < count; ++p) {
      if (auto arc = FitPair(bows[i], bows[partners[p].second], options)) seeds.push_back(*arc);
    }
  }
  std::stable_sort(seeds.begin(), seeds.end(), [](const EllipseArc& a, const EllipseArc& b) {
    return a.rms_px < b.rms_px;
  });
  if (seeds.size() > static_cast<size_t>(options.max_pairs)) seeds.resize(options.max_pairs);
  return seeds;
}

}  // namespace horopter
