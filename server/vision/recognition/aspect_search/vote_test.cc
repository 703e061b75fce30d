#include "server/vision/recognition/aspect_search/vote_test.h"

#include <algorithm>
#include <cmath>
#include <numeric>

#include "server/base/constants.h"

namespace horopter {
namespace {

constexpr double kMaxFragmentShare = 0.9;  // of the image's width
constexpr double kLongest = 1.5;           // of a part's diameter: contours turn back; chosen
constexpr float kSeenShare =
    0.03f;  // similarities this near, as a share of the size, are tested once

}  // namespace

std::vector<ContourFragment> VotingFragments(const AspectImage& image,
                                             const AspectVoteOptions& options) {
  FragmentOptions pieces;
  pieces.min_length = options.min_fragment_px;
  pieces.max_length = std::min(kMaxFragmentShare, kLongest * options.max_size_share) * image.width;
  pieces.length_factor = options.fragment_factor;
  pieces.start_share = options.start_share;
  pieces.min_step = options.min_step;
  std::vector<ContourFragment> fragments = CollectFragments(image.contours, pieces);
  DropRepeated(options.max_repeats, &fragments);
  return fragments;
}

IndexedTurn TurnOf(const ContourFragment& fragment) {
  const float mean =
      std::accumulate(fragment.key.begin(), fragment.key.end(), 0.0f) / kFragmentAngles;
  return IndexedTurn(fragment.chord_rad + mean);
}

Similarity Placed(float size,
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

std::optional<float> VoteTest::SupportOfFirst(const FirstVotePoints& first, const Similarity& s) {
  if (!(s.x >= 0 && s.y >= 0 && s.x < static_cast<float>(image_.width) &&
        s.y < static_cast<float>(image_.height)))
    return std::nullopt;
  const int tau8 = Tau8(s.size);
  const CoarseMap& map = maps_.For(tau8);
  const float six = map.Support(first, 0, kFirstPoints, s, tau8);
  if (six < options_.min_support_6) return std::nullopt;
  ++tests_16_;
  const float rest = map.Support(first, kFirstPoints, kSecondPoints, s, tau8);
  const float sixteen =
      (six * kFirstPoints + rest * (kSecondPoints - kFirstPoints)) / kSecondPoints;
  if (sixteen < options_.min_support_16) return std::nullopt;
  return sixteen;
}

std::optional<VoteTest::Accepted> VoteTest::Judge(std::uint32_t number,
                                                  const FirstVotePoints& first,
                                                  std::span<const VotePoint> points,
                                                  const Eigen::Vector2f& pivot,
                                                  float support,
                                                  Similarity s) {
  const float excess = ExcessChance(points.first(kFirstPoints), s);
  if (support - excess < options_.min_support_16 * (1.0f - excess)) return std::nullopt;
  if (!IsNew(number, s)) return std::nullopt;
  ++climbs_;
  Accepted out;
  out.at = Climb(first, pivot, support, s);
  const int n = static_cast<int>(points.size());
  out.support = Support(image_, points.data(), 0, n, out.at, Tau8(out.at.size));
  if (out.support < options_.min_support) return std::nullopt;
  const float chance = ExcessChance(points, out.at);
  out.gain = AboveChance(out.support, chance) - static_cast<float>(options_.rank_support);
  if (out.gain <= 0) return std::nullopt;
  return out;
}

int VoteTest::Tau8(float size) const {
  const float tau = std::max(static_cast<float>(options_.min_tau_px),
                             static_cast<float>(options_.tau_share) * size);
  return std::clamp(static_cast<int>(tau * AspectImage::kDistanceScale), 1, 254);
}

float VoteTest::ExcessChance(std::span<const VotePoint> points, const Similarity& s) const {
  return horopter::ExcessChance(image_,
                                points.data(),
                                static_cast<int>(points.size()),
                                s,
                                Tau8(s.size),
                                options_.free_chance);
}

bool VoteTest::IsNew(std::uint32_t number, const Similarity& s) {
  const auto step = [](float v, float width) {
    return static_cast<std::uint32_t>(static_cast<std::int32_t>(std::floor(v / width)));
  };
  const float place = kSeenShare * s.size;
  std::uint32_t hash = number;
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

Similarity VoteTest::Climb(const FirstVotePoints& points,
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

}  // namespace horopter
