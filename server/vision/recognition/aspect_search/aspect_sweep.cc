#include "server/vision/recognition/aspect_search/aspect_sweep.h"

#include <Eigen/Geometry>
#include <algorithm>
#include <array>
#include <cmath>
#include <numbers>

#include "server/base/parallel_for.h"
#include "server/vision/recognition/aspect_search/vote_support.h"

namespace horopter {
namespace {

constexpr double kSweepReachRad = 0.9;  // between a pose and one of those expected
constexpr double kTurnStepRad = 0.2;    // about the line of sight
constexpr double kSizeStep = 1.15;
constexpr double kPlaceShare = 0.11;  // of the size: between places
constexpr double kSweepTauShare =
    0.10;  // of the size: an edge farther away supports nothing at first
constexpr double kSweepSupport = 0.5;  // least, on 6 and on 16 points
constexpr int kMostClimbed = 4000;     // of an expectation
constexpr int kFirst = 6;              // points that refuse a place; chosen, for time
constexpr int kClimbs = 3;             // rounds, each with half the steps and tolerance

struct Found {
  std::int32_t aspect = -1;
  Similarity s;
  float support = 0.0f;
};

class Sweep {
 public:
  Sweep(const AspectImage& image, const FragmentIndex& index, const AspectVoteOptions& votes)
      : image_(image), maps_(image), index_(index), votes_(votes) {}

  // One aspect at all places, sizes and turns that are expected.
  std::vector<Found> Places(int aspect, const AspectExpectation& expected) const {
    std::vector<Found> out;
    const IndexedAspect& a = index_.aspects[aspect];
    const Eigen::Matrix3f& from_object =
        index_.models[a.model].object->aspects.aspects[a.aspect].camera_from_object;
    const float least = 1.0f + 2.0f * static_cast<float>(std::cos(kSweepReachRad));
    const int turns = static_cast<int>(2 * std::numbers::pi / kTurnStepRad);
    for (int k = 0; k < turns; ++k) {
      const float turn = 2 * std::numbers::pi_v<float> * k / turns;
      const Eigen::Matrix3f R =
          Eigen::AngleAxisf(turn, Eigen::Vector3f::UnitZ()).toRotationMatrix() * from_object;
      const bool wanted =
          std::any_of(expected.rotations.begin(), expected.rotations.end(), [&](const auto& other) {
            return R.cwiseProduct(other).sum() > least;
          });
      if (!wanted) continue;
      for (float size = expected.min_size_px; size <= expected.max_size_px;
           size *= static_cast<float>(kSizeStep)) {
        PlacesOf(aspect, MakeSimilarity(size, turn), &out);
      }
    }
    return out;
  }

  // The vote that a place climbs to; rank 0: none.
  AspectVote Climbed(const Found& start) const {
    const IndexedAspect& a = index_.aspects[start.aspect];
    const VotePoint* points = index_.points.data() + a.first_point;
    Similarity s = start.s;
    float move = 0.5f * static_cast<float>(kPlaceShare);
    float turn = 0.5f * static_cast<float>(kTurnStepRad);
    float grow = std::sqrt(static_cast<float>(kSizeStep));
    float tau = static_cast<float>(kSweepTauShare);
    const float narrower =
        std::pow(static_cast<float>(votes_.tau_share) / tau, 1.0f / static_cast<float>(kClimbs));
    float best = 0.0f;
    for (int round = 0; round < kClimbs; ++round) {
      tau *= narrower;
      best = Support(image_, points, 0, a.points, s, Tau8(tau, s.size));
      for (const std::array<float, 4>& step : {std::array{move, 0.0f, 1.0f, 0.0f},
                                               std::array{-move, 0.0f, 1.0f, 0.0f},
                                               std::array{0.0f, move, 1.0f, 0.0f},
                                               std::array{0.0f, -move, 1.0f, 0.0f},
                                               std::array{0.0f, 0.0f, grow, 0.0f},
                                               std::array{0.0f, 0.0f, 1.0f / grow, 0.0f},
                                               std::array{0.0f, 0.0f, 1.0f, turn},
                                               std::array{0.0f, 0.0f, 1.0f, -turn}}) {
        Similarity other = MakeSimilarity(s.size * step[2], s.turn + step[3]);
        other.x = s.x + step[0] * s.size;
        other.y = s.y + step[1] * s.size;
        const float support = Support(image_, points, 0, a.points, other, Tau8(tau, other.size));
        if (support > best) best = support, s = other;
      }
      move *= 0.5f;
      turn *= 0.5f;
      grow = std::sqrt(grow);
    }
    const float gain = AboveChance(best, Chance(points, a.points, s, tau)) -
                       static_cast<float>(votes_.rank_support);
    const float rank = best < votes_.min_support ? 0.0f : a.edge_length * s.size * gain;
    return {rank, best, start.aspect, s.size, s.turn, s.x, s.y};
  }

 private:
  void PlacesOf(int aspect, Similarity s, std::vector<Found>* out) const {
    const FirstVotePoints& points = index_.first_points[aspect];
    const int tau8 = Tau8(static_cast<float>(kSweepTauShare), s.size);
    const CoarseMap& map = maps_.For(tau8);
    const float step = static_cast<float>(kPlaceShare) * s.size;
    for (s.y = 0.5f * step; s.y < static_cast<float>(image_.height); s.y += step) {
      for (s.x = 0.5f * step; s.x < static_cast<float>(image_.width); s.x += step) {
        const float six = map.Support(points, 0, kFirst, s, tau8);
        if (six < kSweepSupport) continue;
        const float rest = map.Support(points, kFirst, kFirstVotePoints, s, tau8);
        const float sixteen =
            (kFirst * six + (kFirstVotePoints - kFirst) * rest) / kFirstVotePoints;
        if (sixteen < kSweepSupport) continue;
        // Where anything is supported, thousands of places are: those that say more come first.
        const VotePoint* fine = index_.points.data() + index_.aspects[aspect].first_point;
        const float chance = Chance(fine, kFirstVotePoints, s, static_cast<float>(kSweepTauShare));
        out->push_back({aspect, s, AboveChance(sixteen, chance)});
      }
    }
  }

  float Chance(const VotePoint* points, int n, const Similarity& s, float tau_share) const {
    return ExcessChance(image_, points, n, s, Tau8(tau_share, s.size), votes_.free_chance);
  }

  int Tau8(float share, float size) const {
    const float tau = std::max(static_cast<float>(votes_.min_tau_px), share * size);
    return std::clamp(static_cast<int>(tau * AspectImage::kDistanceScale), 1, 254);
  }

  const AspectImage& image_;
  CoarseMaps maps_;
  const FragmentIndex& index_;
  const AspectVoteOptions& votes_;
};

std::vector<AspectVote> VotesOf(const Sweep& sweep,
                                const FragmentIndex& index,
                                const AspectExpectation& expected,
                                const AspectVoteOptions& votes,
                                const StopRequested& stop) {
  std::vector<std::vector<Found>> of_aspect(index.aspects.size());
  ParallelFor(static_cast<int>(index.aspects.size()), votes.threads, [&](int a) {
    if (index.aspects[a].model != expected.model || IsStopRequested(stop)) return;
    of_aspect[a] = sweep.Places(a, expected);
  });
  std::vector<Found> found;
  for (const auto& list : of_aspect) found.insert(found.end(), list.begin(), list.end());
  std::stable_sort(found.begin(), found.end(), [](const Found& a, const Found& b) {
    return a.support > b.support;
  });
  if (static_cast<int>(found.size()) > kMostClimbed) found.resize(kMostClimbed);
  std::vector<AspectVote> out(found.size());
  ParallelFor(static_cast<int>(found.size()), votes.threads, [&](int i) {
    if (!IsStopRequested(stop)) out[i] = sweep.Climbed(found[i]);
  });
  std::erase_if(out, [](const AspectVote& v) { return v.rank <= 0.0f; });
  return ChooseDistinct(std::move(out), index, index.models[expected.model].symmetries, votes);
}

}  // namespace

std::vector<std::vector<AspectVote>> SweepForAspects(const AspectImage& image,
                                                     const FragmentIndex& index,
                                                     std::span<const AspectExpectation> expected,
                                                     const AspectVoteOptions& votes,
                                                     const StopRequested& stop) {
  std::vector<std::vector<AspectVote>> out(index.models.size());
  if (image.width == 0) return out;
  const Sweep sweep(image, index, votes);
  for (const AspectExpectation& e : expected) {
    if (IsStopRequested(stop)) break;
    out[e.model] = VotesOf(sweep, index, e, votes, stop);
  }
  return out;
}

}  // namespace horopter
