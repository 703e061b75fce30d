#include "server/vision/recognition/aspect_search/aspect_votes.h"

#include <Eigen/Geometry>
#include <algorithm>
#include <array>
#include <cmath>
#include <numbers>
#include <numeric>

#include "server/base/constants.h"
#include "server/base/parallel_for.h"
#include "server/vision/recognition/aspect_search/vote_support.h"
#include "server/vision/recognition/aspects/contour_ellipses.h"
#include "server/vision/recognition/aspects/segment_pairs.h"

namespace horopter {
namespace {

constexpr double kMaxFragmentShare = 0.9;                          // of the image's width
constexpr int kFirstPoints = 6, kSecondPoints = kFirstVotePoints;  // looked at in two steps
constexpr double kLongest = 1.5;  // of a part's diameter: contours turn back; chosen
constexpr int kShares = 16;       // of the image's fragments, so that threads do not matter
constexpr float kSeenShare =
    0.03f;  // similarities this near, as a share of the size, are tested once
constexpr std::uint32_t kSeenSlots = 1u << 15;  // of hashes; for memory
constexpr float kRoundRatio = 0.96f;            // of an ellipse's axes: beyond it has no direction
constexpr int kRoundTurns = 12;                 // that are tried of such a one

class Share {
 public:
  Share(const AspectImage& image,
        const CoarseMaps& maps,
        const FragmentIndex& index,
        const AspectVoteOptions& options,
        std::span<const std::uint8_t> wanted)
      : image_(image),
        maps_(maps),
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
      const float mean = std::accumulate(way.key.begin(), way.key.end(), 0.0f) / kFragmentAngles;
      const IndexedTurn turn(way.chord_rad + mean);
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
      if (!IsSoughtSize(size)) continue;
      ++counts_.ellipse_matches;
      for (int k = 0; k < turns; ++k) {
        const float turn = static_cast<float>(ellipse.angle_rad) - e.direction_rad +
                           2.0f * kPiF * static_cast<float>(k) / static_cast<float>(turns);
        Test(e.aspect, size, turn, {e.x, e.y}, center);
      }
    }
  }

  std::vector<std::vector<AspectVote>>& pools() { return pools_; }
  const AspectVotes& counts() const { return counts_; }

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
    if (!IsSoughtSize(size)) return;
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
    if (!IsSoughtSize(size)) return;
    Test(model_side.aspect,
         Placed(size, image_turn, model_side.turn, {model_side.x, model_side.y}, image_side.corner),
         image_side.corner);
  }

  // Of this size, turning the model's direction into the image's, and a point of the aspect, in
  // diameters, to its place.
  static Similarity Placed(float size,
                           const IndexedTurn& image,
                           const IndexedTurn& model,
                           const Eigen::Vector2f& from,
                           const Eigen::Vector2f& to) {
    Similarity s;
    s.size = size;
    s.turn = image.rad - model.rad;
    s.a = size * (image.cos * model.cos + image.sin * model.sin);
    s.b = size * (image.sin * model.cos - image.cos * model.sin);
    s.x = to.x() - (s.a * from.x() - s.b * from.y());
    s.y = to.y() - (s.b * from.x() + s.a * from.y());
    return s;
  }

  // What brings a point of the aspect, in diameters, to a place of the image.
  void Test(std::int32_t aspect,
            float size,
            float turn,
            const Eigen::Vector2f& from,
            const Eigen::Vector2f& to) {
    Test(aspect, Placed(size, IndexedTurn(turn), {}, from, to), to);
  }

  bool IsSoughtSize(float size) const {
    const float width = static_cast<float>(image_.width);
    return size >= options_.min_size_px && size <= options_.max_size_share * width;
  }

  void Test(std::int32_t number, Similarity s, const Eigen::Vector2f& pivot) {
    if (!(s.x >= 0 && s.y >= 0 && s.x < static_cast<float>(image_.width) &&
          s.y < static_cast<float>(image_.height)))
      return;
    const FirstVotePoints& first = index_.first_points[number];
    const int tau8 = Tau8(s.size);
    const CoarseMap& map = maps_.For(tau8);
    const float six = map.Support(first, 0, kFirstPoints, s, tau8);
    if (six < options_.min_support_6) return;
    ++counts_.tests_16;
    const float rest = map.Support(first, kFirstPoints, kSecondPoints, s, tau8);
    const float sixteen =
        (six * kFirstPoints + rest * (kSecondPoints - kFirstPoints)) / kSecondPoints;
    if (sixteen < options_.min_support_16) return;
    const IndexedAspect& aspect = index_.aspects[number];
    const VotePoint* points = index_.points.data() + aspect.first_point;
    const int n = aspect.points;
    const float excess = ExcessChance(points, kFirstPoints, s);
    if (sixteen - excess < options_.min_support_16 * (1.0f - excess)) return;
    if (!IsNew(number, s)) return;
    ++counts_.climbs;
    s = Climb(first, pivot, sixteen, s);
    const float support = Support(image_, points, 0, n, s, Tau8(s.size));
    if (support < options_.min_support) return;
    const float chance = ExcessChance(points, n, s);
    const float gain = AboveChance(support, chance) - static_cast<float>(options_.rank_support);
    if (gain <= 0) return;
    ++counts_.accepted;
    const float rank = aspect.edge_length * s.size * gain;
    Keep(aspect.model, {rank, support, number, s.size, s.turn, s.x, s.y});
  }

  int Tau8(float size) const {
    const float tau = std::max(static_cast<float>(options_.min_tau_px),
                               static_cast<float>(options_.tau_share) * size);
    return std::clamp(static_cast<int>(tau * AspectImage::kDistanceScale), 1, 254);
  }

  // Other lengths of a contour lead to the same similarity again. A table of the last ones of each
  // hash: what it forgets is only tested once more.
  bool IsNew(std::int32_t aspect, const Similarity& s) {
    const auto step = [](float v, float width) {
      return static_cast<std::uint32_t>(static_cast<std::int32_t>(std::floor(v / width)));
    };
    const float place = kSeenShare * s.size;
    std::uint32_t hash = static_cast<std::uint32_t>(aspect);
    for (const std::uint32_t v :
         {step(std::log(s.size), 2 * kSeenShare),
          step(s.turn - 2 * kPiF * std::floor(s.turn / (2 * kPiF)), 2 * kSeenShare),
          step(s.x, place),
          step(s.y, place)}) {
      hash = (hash ^ v) * 0x9E3779B1u;
      hash ^= hash >> 15;
    }
    std::uint32_t& seen = seen_[hash % kSeenSlots];
    if (seen == hash) return false;
    seen = hash;
    return true;
  }

  float ExcessChance(const VotePoint* points, int n, const Similarity& s) const {
    return horopter::ExcessChance(image_, points, n, s, Tau8(s.size), options_.free_chance);
  }

  // Better size and turn about a point that stays.
  Similarity Climb(const FirstVotePoints& points,
                   const Eigen::Vector2f& pivot,
                   float best,
                   Similarity s) const {
    struct Step {
      float size;  // factor
      IndexedTurn turn;
    };
    // Tried in this order.
    static const Step kSteps[] = {{1.08f, {}},
                                  {0.926f, {}},
                                  {1.0f, IndexedTurn(0.07f)},
                                  {1.0f, IndexedTurn(-0.07f)},
                                  {1.04f, {}},
                                  {0.962f, {}},
                                  {1.0f, IndexedTurn(0.035f)},
                                  {1.0f, IndexedTurn(-0.035f)}};
    for (const Step& step : kSteps) {
      const float c = step.size * step.turn.cos, t = step.size * step.turn.sin;
      const float dx = s.x - pivot.x(), dy = s.y - pivot.y();
      Similarity other;
      other.size = s.size * step.size;
      other.turn = s.turn + step.turn.rad;
      other.a = c * s.a - t * s.b;
      other.b = t * s.a + c * s.b;
      other.x = pivot.x() + c * dx - t * dy;
      other.y = pivot.y() + t * dx + c * dy;
      const int tau8 = Tau8(other.size);
      const float support = maps_.For(tau8).Support(points, 0, kSecondPoints, other, tau8);
      if (support > best) {
        best = support;
        s = other;
      }
    }
    return s;
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

  const AspectImage& image_;
  const CoarseMaps& maps_;
  const FragmentIndex& index_;
  const AspectVoteOptions& options_;
  float most_ratio_;  // of lengths that agree
  std::span<const std::uint8_t> wanted_;
  std::vector<std::vector<AspectVote>> pools_;
  std::vector<float> floors_;
  std::vector<std::uint32_t> found_, agreeing_, others_;
  std::vector<std::uint32_t> seen_ = std::vector<std::uint32_t>(kSeenSlots, 0);
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

std::vector<ContourFragment> FragmentsOf(const AspectImage& image,
                                         const AspectVoteOptions& options) {
  FragmentOptions pieces;
  pieces.min_length = options.min_fragment_px;
  pieces.max_length = std::min(kMaxFragmentShare, kLongest * options.max_size_share) * image.width;
  pieces.length_factor = options.fragment_factor;
  pieces.start_share = options.start_share;
  pieces.min_step = options.min_step;
  std::vector<ContourFragment> out = CollectFragments(image.contours, pieces);
  DropRepeated(options.max_repeats, &out);
  return out;
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
  const std::vector<ContourFragment> fragments = FragmentsOf(image, options);
  SegmentPairOptions corners;
  corners.min_length = options.min_arm_px;
  corners.max_pairs = options.max_pairs;
  corners.max_offset = options.max_arm_offset_px;
  std::vector<SegmentPair> pairs;
  if (!index.pairs.empty() && options.max_pair_matches > 0)
    pairs = CollectSegmentPairs(image.contours, corners);
  std::vector<EllipseArc> ellipses;
  if (!index.ellipses.empty() && options.max_ellipse_matches > 0) {
    ContourEllipseOptions round;
    round.most = Times(round.most, more);
    ellipses = FindContourEllipses(image.contours, round);
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
