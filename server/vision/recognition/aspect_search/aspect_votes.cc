#include "server/vision/recognition/aspect_search/aspect_votes.h"

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <numbers>
#include <optional>

#include "server/base/constants.h"
#include "server/base/parallel_for.h"
#include "server/base/stop_scope.h"
#include "server/vision/recognition/aspect_search/vote_test.h"
#include "server/vision/recognition/aspects/contour_ellipses.h"
#include "server/vision/recognition/aspects/segment_pairs.h"

namespace horopter {
namespace {

constexpr int kShares = 16;           // of the image's fragments, so that threads do not matter
constexpr float kRoundRatio = 0.96f;  // of an ellipse's axes: beyond it has no direction
constexpr int kRoundTurns = 12;       // that are tried of such a one

class Share {
 public:
  Share(const AspectImage& image,
        const CoarseMaps& maps,
        const FragmentIndex& index,
        const AspectVoteOptions& options,
        std::span<const std::uint8_t> wanted)
      : test_(image, maps, options),
        index_(index),
        options_(options),
        most_ratio_(static_cast<float>(std::exp(options.pair_log_ratio))),
        wanted_(wanted) {
    pools_.resize(index.model_count);
    floors_.assign(index.model_count, 0.0f);
  }

  void Vote(const ContourFragment& fragment) {
    ++counts_.fragments;
    for (const ContourFragment& way : {fragment, Reversed(fragment)}) {
      found_.clear();
      index_.FindNearest(
          way.key,
          static_cast<float>(options_.key_rms_rad) * std::sqrt(float{kFragmentAngles}),
          static_cast<std::size_t>(std::max(0, options_.max_matches)),
          wanted_,
          &found_);
      counts_.matches += static_cast<std::int64_t>(found_.size());
      const IndexedTurn turn = TurnOf(way);
      for (const std::uint32_t f : found_) Test(way, turn, index_.fragments[f]);
    }
  }

  void Vote(const SegmentPair& pair) {
    ++counts_.pairs;
    const auto [first, last] =
        index_.FindPairs(pair.opening_rad, static_cast<float>(options_.pair_opening_rad));
    agreeing_.clear();
    others_.clear();
    const float wanted = pair.length_b / pair.length_a;
    for (std::size_t i = first; i < last; ++i) {
      const IndexedPair& p = index_.pairs[i];
      if (!wanted_.empty() && !wanted_[index_.aspects[p.aspect].model]) continue;
      const float ratio = wanted * p.length_a / p.length_b;
      (ratio < most_ratio_ && ratio * most_ratio_ > 1.0f ? agreeing_ : others_)
          .push_back(static_cast<std::uint32_t>(i));
    }
    counts_.pair_matches += static_cast<std::int64_t>(agreeing_.size());
    const auto left = static_cast<std::size_t>(std::max(0, options_.max_pair_matches));
    TestSome(pair, agreeing_, left);
    if (agreeing_.size() < left) TestSome(pair, others_, left - agreeing_.size());
  }

  void Vote(const EllipseArc& ellipse) {
    ++counts_.ellipses;
    const auto ratio = static_cast<float>(ellipse.semi_minor_px / ellipse.semi_major_px);
    const auto [first, last] =
        index_.FindEllipses(ratio, static_cast<float>(options_.ellipse_ratio));
    const std::size_t stride =
        1 + (last - first) / static_cast<std::size_t>(std::max(1, options_.max_ellipse_matches));
    const Eigen::Vector2f center = ellipse.center.cast<float>();
    // The major axis has no sense, and that of a circle no direction.
    const int turns = ratio > kRoundRatio ? kRoundTurns : 2;
    for (std::size_t i = first + counts_.ellipses % stride; i < last; i += stride) {
      const IndexedEllipse& e = index_.ellipses[i];
      if (!wanted_.empty() && !wanted_[index_.aspects[e.aspect].model]) continue;
      const float size = static_cast<float>(ellipse.semi_major_px) / e.semi_major;
      if (!test_.IsSoughtSize(size)) continue;
      ++counts_.ellipse_matches;
      for (int k = 0; k < turns; ++k) {
        const float turn = static_cast<float>(ellipse.angle_rad) - e.direction_rad +
                           2.0f * kPiF * static_cast<float>(k) / static_cast<float>(turns);
        Test(e.aspect, size, turn, {e.x, e.y}, center);
      }
    }
  }

  std::vector<std::vector<AspectVote>>& pools() { return pools_; }
  AspectVotes counts() const {
    AspectVotes out = counts_;
    out.tests_16 = test_.tests_16();
    out.climbs = test_.climbs();
    return out;
  }

 private:
  // At most `most`, spread over all.
  void TestSome(const SegmentPair& pair,
                const std::vector<std::uint32_t>& found,
                std::size_t most) {
    if (most == 0) return;
    const IndexedTurn turn(pair.direction_rad + 0.5f * pair.opening_rad);
    const std::size_t stride = 1 + found.size() / most;
    for (std::size_t i = counts_.pairs % stride; i < found.size(); i += stride)
      Test(pair, turn, index_.pairs[found[i]]);
  }

  // Scale and turn by least squares over directions and spreads, place by the centres.
  void Test(const ContourFragment& image_side,
            const IndexedTurn& image_turn,
            const IndexedFragment& model_side) {
    const float size = image_side.spread / model_side.spread;
    if (!test_.IsSoughtSize(size)) return;
    Test(model_side.aspect,
         Placed(size, image_turn, model_side.turn, {model_side.x, model_side.y}, image_side.center),
         image_side.pivot);
  }

  // Size by both arms where they agree, else by the one whose image is longer: the other is cut
  // off.
  void Test(const SegmentPair& image_side,
            const IndexedTurn& image_turn,
            const IndexedPair& model_side) {
    const float by_a = image_side.length_a / model_side.length_a;
    const float by_b = image_side.length_b / model_side.length_b;
    const float ratio = by_a > by_b ? by_a / by_b : by_b / by_a;
    const float size = ratio < most_ratio_ ? std::sqrt(by_a * by_b) : std::max(by_a, by_b);
    if (!test_.IsSoughtSize(size)) return;
    Test(model_side.aspect,
         Placed(size, image_turn, model_side.turn, {model_side.x, model_side.y}, image_side.corner),
         image_side.corner);
  }

  // What brings a point of the aspect, in diameters, to a place of the image.
  void Test(std::int32_t aspect,
            float size,
            float turn,
            const Eigen::Vector2f& from,
            const Eigen::Vector2f& to) {
    Test(aspect, Placed(size, IndexedTurn(turn), {}, from, to), to);
  }

  void Test(std::int32_t number, const Similarity& s, const Eigen::Vector2f& pivot) {
    const FirstVotePoints& first = index_.first_points[number];
    const std::optional<float> support = test_.SupportOfFirst(first, s);
    if (!support) return;
    const IndexedAspect& aspect = index_.aspects[number];
    const std::span points(index_.points.data() + aspect.first_point, aspect.points);
    const auto accepted =
        test_.Judge(static_cast<std::uint32_t>(number), first, points, pivot, *support, s);
    if (!accepted) return;
    ++counts_.accepted;
    const Similarity& at = accepted->at;
    const float rank = aspect.edge_length * at.size * accepted->gain;
    Keep(aspect.model, {rank, accepted->support, number, at.size, at.turn, at.x, at.y});
  }

  void Keep(int model, const AspectVote& vote) {
    std::vector<AspectVote>& pool = pools_[model];
    if (vote.rank < floors_[model]) return;
    pool.push_back(vote);
    const std::size_t keep = static_cast<std::size_t>(options_.pool);
    if (pool.size() < 2 * keep) return;
    std::nth_element(pool.begin(),
                     pool.begin() + static_cast<std::ptrdiff_t>(keep) - 1,
                     pool.end(),
                     [](const AspectVote& p, const AspectVote& q) { return p.rank > q.rank; });
    floors_[model] = pool[keep - 1].rank;
    pool.resize(keep);
  }

  VoteTest test_;
  const FragmentIndex& index_;
  const AspectVoteOptions& options_;
  float most_ratio_;  // of lengths that agree
  std::span<const std::uint8_t> wanted_;
  std::vector<std::vector<AspectVote>> pools_;
  std::vector<float> floors_;
  std::vector<std::uint32_t> found_, agreeing_, others_;
  AspectVotes counts_;
};

int Times(int limit, double more) {
  return static_cast<int>(limit * more + 0.5);
}

AspectVoteOptions WithMore(AspectVoteOptions options, double more) {
  options.pool = Times(options.pool, more);
  options.max_per_object = Times(options.max_per_object, more);
  options.max_pairs = Times(options.max_pairs, more);
  return options;
}

void AddCounts(const AspectVotes& more, AspectVotes* sum) {
  for (const auto count : {&AspectVotes::fragments,
                           &AspectVotes::matches,
                           &AspectVotes::pairs,
                           &AspectVotes::pair_matches,
                           &AspectVotes::ellipses,
                           &AspectVotes::ellipse_matches,
                           &AspectVotes::tests_16,
                           &AspectVotes::climbs,
                           &AspectVotes::accepted})
    sum->*count += more.*count;
}

}  // namespace

AspectVotes VoteForAspects(const AspectImage& image,
                           const FragmentIndex& index,
                           const AspectVoteOptions& of_small,
                           const StopRequested& stop,
                           std::span<const std::uint8_t> wanted) {
  AspectVotes out;
  out.of_model.resize(index.model_count);
  if (image.width == 0 || index.fragments.empty()) return out;
  const double more = std::max(1.0, image.width * image.height / kLimitsPx);
  const AspectVoteOptions options = WithMore(of_small, more);
  const std::vector<ContourFragment> fragments = VotingFragments(image, options);
  LeaveIfStopped();
  SegmentPairOptions corners;
  corners.min_length = options.min_arm_px;
  corners.max_pairs = options.max_pairs;
  corners.max_offset = options.max_arm_offset_px;
  std::vector<SegmentPair> pairs;
  if (!index.pairs.empty() && options.max_pair_matches > 0)
    pairs = CollectSegmentPairs(image.contours, corners);
  LeaveIfStopped();
  std::vector<EllipseArc> ellipses;
  if (!index.ellipses.empty() && options.max_ellipse_matches > 0) {
    ContourEllipseOptions round;
    round.most = Times(round.most, more);
    ellipses = FindContourEllipses(image.contours, round);
    LeaveIfStopped();
  }
  // Each share keeps its own pool, so the result does not depend on the number of threads.
  const CoarseMaps maps(image);
  std::vector<Share> shares(kShares, Share(image, maps, index, options, wanted));
  ParallelFor(kShares, options.threads, [&](int i) {
    for (std::size_t f = i; f < fragments.size(); f += kShares) {
      if (f / kShares % 16 == 0 && IsStopRequested(stop)) return;
      shares[i].Vote(fragments[f]);
    }
    for (std::size_t p = i; p < pairs.size() && !IsStopRequested(stop); p += kShares)
      shares[i].Vote(pairs[p]);
    for (std::size_t e = i; e < ellipses.size() && !IsStopRequested(stop); e += kShares)
      shares[i].Vote(ellipses[e]);
  });
  for (const Share& share : shares) AddCounts(share.counts(), &out);
  ParallelFor(index.model_count, options.threads, [&](int model) {
    std::vector<AspectVote> pool;
    for (Share& share : shares) {
      pool.insert(pool.end(), share.pools()[model].begin(), share.pools()[model].end());
    }
    const std::span<const Rigid3> symmetries =
        index.models.empty() ? std::span<const Rigid3>() : index.models[model].symmetries;
    out.of_model[model] = ChooseDistinct(std::move(pool), index, symmetries, options);
  });
  return out;
}

}  // namespace horopter
