#include "server/vision/recognition/aspects/contour_fragments.h"

#include <algorithm>
#include <cmath>
#include <utility>

#include "server/base/constants.h"
#include "server/base/stop_scope.h"

namespace horopter {
namespace {

constexpr int kMaxWalks = 4;       // ways to go on from one start, over all junctions
constexpr long kMaxPacked = 8000;  // eight squared differences of such fit 31 bits

float WrapPi(float a) {
  while (a > kPiF) a -= 2 * kPiF;
  while (a <= -kPiF) a += 2 * kPiF;
  return a;
}

// A way along contours: points, the arc length to each, and the chains entered so far, the first
// one first. One is gone on with and cut back, so that walks share their beginnings.
struct Walk {
  struct Mark {
    std::size_t points;
    std::size_t chains;
  };

  std::vector<Eigen::Vector2f> points;
  std::vector<float> arc;
  std::vector<int> chains;

  Mark Here() const { return {points.size(), chains.size()}; }
  void BackTo(const Mark& mark) {
    points.resize(mark.points);
    arc.resize(mark.points);
    chains.resize(mark.chains);
  }
};

constexpr int kStartsPerLook = 16;  // chains of large images are long

class Walker {
 public:
  Walker(const ContourGraph& graph, const FragmentOptions& options)
      : graph_(graph), options_(options), step_to_(graph.points.size(), 0.0f) {
    for (double l = options.min_length; l <= options.max_length * 1.0001;
         l *= options.length_factor) {
      lengths_.push_back(static_cast<float>(l));
      steps_.push_back(std::max(
          1, static_cast<int>(std::lround(std::max(options.min_step, l * options.start_share)))));
    }
    for (std::size_t i = 1; i < graph.points.size(); ++i) {
      step_to_[i] = (graph.points[i] - graph.points[i - 1]).norm();
    }
  }

  std::vector<ContourFragment> Run() {
    const int least = std::max(1, static_cast<int>(std::lround(options_.min_step)));
    for (int c = 0; c < static_cast<int>(graph_.chains.size()) && !lengths_.empty(); ++c) {
      for (int i = 0; i < graph_.chains[c].size; i += least) {
        if (i % (kStartsPerLook * least) == 0) LeaveIfStopped();
        Start(c, i, true);
        Start(c, i, false);
      }
    }
    return std::move(fragments_);
  }

 private:
  void Start(int chain, int index, bool forward) {
    start_chain_ = chain;
    start_index_ = index;
    forward_ = forward;
    wanted_ = 0.0f;
    for (std::size_t k = 0; k < lengths_.size(); ++k) {
      if (index % steps_[k] == 0) wanted_ = lengths_[k];
    }
    if (wanted_ <= 0.0f) return;
    walks_left_ = kMaxWalks;
    walk_.BackTo({0, 0});
    walk_.chains.push_back(chain);
    Follow(chain, index, forward, 0.0f);
  }

  // Goes along a chain to its end, or until the walk is long enough or back where it began (true).
  bool GoAlong(int chain, int index, bool forward) {
    const ContourChain& c = graph_.chains[chain];
    const int stop = walk_.chains.size() > 1 && chain == start_chain_ ? start_index_ : -1;
    const int step = forward ? 1 : -1;
    const Eigen::Vector2f& first = graph_.points[c.begin + index];
    float arc =
        walk_.points.empty() ? 0.0f : walk_.arc.back() + (first - walk_.points.back()).norm();
    for (int i = index;;) {
      walk_.points.push_back(graph_.points[c.begin + i]);
      walk_.arc.push_back(arc);
      if (arc >= wanted_ || i == stop) return true;
      i += step;
      if (i < 0 || i >= c.size) return false;
      arc += step_to_[c.begin + std::max(i, i - step)];
    }
  }

  // Goes along a chain, then over its links. `done`: lengths below were cut from a walk that shares
  // this one's beginning.
  void Follow(int chain, int index, bool forward, float done) {
    if (GoAlong(chain, index, forward)) {
      Cut(chain, done);
      return;
    }
    const ContourChain& c = graph_.chains[chain];
    const bool again = walk_.chains.size() > 1 && chain == start_chain_;
    bool went_on = false;
    const float here = walk_.arc.back();
    const Walk::Mark mark = walk_.Here();
    for (const ChainLink& link : forward ? c.after_back : c.after_front) {
      const bool closes = link.chain == start_chain_ && !again && link.at_front == forward_;
      const bool entered =
          std::find(walk_.chains.begin(), walk_.chains.end(), link.chain) != walk_.chains.end();
      if (entered && !closes) continue;
      if (went_on && walks_left_ <= 1) break;
      if (went_on) --walks_left_;
      walk_.chains.push_back(link.chain);
      Follow(link.chain,
             link.at_front ? 0 : graph_.chains[link.chain].size - 1,
             link.at_front,
             went_on ? here : done);
      walk_.BackTo(mark);
      went_on = true;
    }
    if (!went_on) Cut(chain, done);
  }

  // All wanted lengths of the walk, which ended on a chain, that are longer than `done`.
  void Cut(int end_chain, float done) {
    const Walk& walk = walk_;
    for (std::size_t k = 0; k < lengths_.size(); ++k) {
      const float length = lengths_[k];
      if (length > walk.arc.back()) break;
      if (length <= done || start_index_ % steps_[k] != 0) continue;
      // Each piece is met from both ends: kept from the end on the lower chain, and along a chain.
      const bool one_chain = walk.chains.size() == 1;
      if (one_chain ? !forward_ : end_chain < start_chain_) continue;
      std::array<Eigen::Vector2f, kFragmentPoints> points;
      std::size_t at = 0;
      for (int i = 0; i < kFragmentPoints; ++i) {
        const float want = length * static_cast<float>(i) / kFragmentAngles;
        while (at + 2 < walk.arc.size() && walk.arc[at + 1] < want) ++at;
        const float span = std::max(walk.arc[at + 1] - walk.arc[at], 1e-6f);
        const float w = std::clamp((want - walk.arc[at]) / span, 0.0f, 1.0f);
        points[i] = walk.points[at] + w * (walk.points[at + 1] - walk.points[at]);
      }
      if (auto fragment = MakeFragment(points, options_)) {
        fragment->length = length;
        fragments_.push_back(*fragment);
      }
    }
  }

  const ContourGraph& graph_;
  const FragmentOptions& options_;
  std::vector<float> lengths_;
  std::vector<int> steps_;
  std::vector<float> step_to_;  // of each point, from the one before it in its chain
  Walk walk_;
  std::vector<ContourFragment> fragments_;
  int start_chain_ = -1, start_index_ = 0, walks_left_ = 0;
  bool forward_ = true;
  float wanted_ = 0.0f;
};

// The bin of a fragment's shape, size and direction; `shift` moves the bins by a share of theirs.
std::uint32_t ShapeHash(const ContourFragment& f, float shift) {
  constexpr float kKeyBin = 0.6f, kLogSizeBin = 0.15f, kChordBin = 0.3f;  // rad, log, rad; chosen
  std::uint32_t hash = 0;
  const auto mix = [&](float v, float width) {
    const auto bin = static_cast<std::int32_t>(std::floor(v / width + shift));
    hash = (hash ^ static_cast<std::uint32_t>(bin)) * 0x9E3779B1u;
    hash ^= hash >> 15;
  };
  for (int i = 0; i < kFragmentAngles; i += 2) mix(f.key[i] + f.key[i + 1], kKeyBin);
  mix(std::log(f.spread), kLogSizeBin);
  mix(f.chord_rad, kChordBin);
  return hash;
}

}  // namespace

std::optional<ContourFragment> MakeFragment(
    const std::array<Eigen::Vector2f, kFragmentPoints>& points, const FragmentOptions& options) {
  ContourFragment f;
  const Eigen::Vector2f chord = points.back() - points.front();
  for (int i = 0; i < kFragmentAngles; ++i) f.length += (points[i + 1] - points[i]).norm();
  if (!(chord.norm() >= options.min_chord_share * f.length) || !(f.length > 0)) {
    return std::nullopt;
  }
  f.chord_rad = std::atan2(chord.y(), chord.x());
  float sharpest = -1.0f;
  float mean = 0.0f;
  for (int i = 0; i < kFragmentAngles; ++i) {
    const Eigen::Vector2f d = points[i + 1] - points[i];
    const float angle = std::atan2(d.y(), d.x()) - f.chord_rad;
    // Continuous along the piece: a spiral keeps counting.
    f.key[i] = i == 0 ? WrapPi(angle) : f.key[i - 1] + WrapPi(angle - f.key[i - 1]);
    mean += f.key[i] / kFragmentAngles;
    if (i == 0) continue;
    const float turn = std::abs(f.key[i] - f.key[i - 1]);
    f.turning += turn;
    if (turn > sharpest) {
      sharpest = turn;
      f.pivot = points[i];
    }
  }
  const float turns = 2 * kPiF * std::round(mean / (2 * kPiF));
  float squares = 0.0f;
  for (float& angle : f.key) {
    angle -= turns;
    squares += angle * angle;
  }
  if (squares < kFragmentAngles * options.min_bend_rad * options.min_bend_rad) return std::nullopt;
  for (const Eigen::Vector2f& p : points) f.center += p / kFragmentPoints;
  for (const Eigen::Vector2f& p : points) f.spread += (p - f.center).squaredNorm();
  f.spread = std::sqrt(f.spread / kFragmentPoints);
  return f;
}

PackedFragmentKey PackKey(const FragmentKey& key) {
  PackedFragmentKey packed;
  for (int i = 0; i < kFragmentAngles; ++i) {
    packed[i] = static_cast<std::int16_t>(
        std::clamp(std::lround(key[i] * kKeyScale), -kMaxPacked, kMaxPacked));
  }
  return packed;
}

FragmentKey UnpackKey(const PackedFragmentKey& packed) {
  FragmentKey key;
  for (int i = 0; i < kFragmentAngles; ++i) key[i] = packed[i] / kKeyScale;
  return key;
}

ContourFragment Reversed(const ContourFragment& fragment) {
  ContourFragment out = fragment;
  std::reverse(out.key.begin(), out.key.end());
  out.chord_rad = WrapPi(fragment.chord_rad + kPiF);
  return out;
}

std::vector<ContourFragment> CollectFragments(const ContourGraph& graph,
                                              const FragmentOptions& options) {
  return Walker(graph, options).Run();
}

void DropRepeated(int max_repeats, std::vector<ContourFragment>* fragments) {
  std::vector<char> repeated(fragments->size(), 0);
  // Two grids of bins: what falls on a border of one lies inside of the other.
  for (int grid = 0; grid < 2; ++grid) {
    LeaveIfStopped();
    std::vector<std::pair<std::uint32_t, std::uint32_t>> keyed;
    for (std::size_t i = 0; i < fragments->size(); ++i)
      keyed.emplace_back(ShapeHash((*fragments)[i], 0.5f * static_cast<float>(grid)),
                         static_cast<std::uint32_t>(i));
    std::sort(keyed.begin(), keyed.end());
    std::vector<Eigen::Vector2f> places;
    for (std::size_t from = 0, to; from < keyed.size(); from = to) {
      places.clear();
      for (to = from; to < keyed.size() && keyed[to].first == keyed[from].first; ++to) {
        const ContourFragment& f = (*fragments)[keyed[to].second];
        if (static_cast<int>(places.size()) > max_repeats) continue;
        if (std::none_of(places.begin(), places.end(), [&](const Eigen::Vector2f& p) {
              return (p - f.center).squaredNorm() < f.spread * f.spread;
            })) {
          places.push_back(f.center);
        }
      }
      if (static_cast<int>(places.size()) <= max_repeats) continue;
      for (std::size_t k = from; k < to; ++k) repeated[keyed[k].second] = 1;
    }
  }
  std::size_t kept = 0;
  for (std::size_t i = 0; i < fragments->size(); ++i) {
    if (!repeated[i]) (*fragments)[kept++] = (*fragments)[i];
  }
  fragments->resize(kept);
}

}  // namespace horopter
