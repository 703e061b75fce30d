#include "server/vision/recognition/aspects/aspect_votes.h"

#include <Eigen/Geometry>
#include <algorithm>
#include <array>
#include <cmath>
#include <numeric>

#include "server/base/parallel_for.h"

namespace horopter {
namespace {

constexpr float kPi = 3.14159265358979f;
constexpr int kFirstPoints = 6, kSecondPoints = kFirstVotePoints;
// From this tolerance on a cell of 4 x 4 pixels says as much as one of 2 x 2.
constexpr int kQuarterTau8 = 5 * static_cast<int>(AspectImage::kDistanceScale);
constexpr int kShares = 16;  // of the image's fragments, so that threads do not matter
constexpr float kSeenShare =
    0.03f;  // similarities this near, as a share of the size, are tested once
constexpr std::uint32_t kSeenSlots = 1u << 15;
constexpr float kSameSize = 1.1f;  // votes this alike in size, place and turn are one
constexpr float kSamePlace = 0.06f;
constexpr float kSameTurnRad = 0.2f;
constexpr float kPlaceRadius = 0.25f;  // of the size: centres nearer than this are in one place

// Bin of the sum of two directions, in bins plus a half.
struct BinTable {
  std::array<std::uint8_t, 2 * kAspectBins + 2> bin;
  BinTable() {
    for (std::size_t i = 0; i < bin.size(); ++i) bin[i] = i % kAspectBins;
  }
};
const BinTable kBins;

struct Similarity {
  float a = 0.0f, b = 0.0f;  // size (cos, sin)
  float x = 0.0f, y = 0.0f;
  float size = 0.0f, turn = 0.0f;
};

Similarity MakeSimilarity(float size, float turn) {
  Similarity s;
  s.size = size;
  s.turn = turn;
  s.a = size * std::cos(turn);
  s.b = size * std::sin(turn);
  return s;
}

float TurnBins(float turn) {
  float t = turn * (1.0f / kPi);
  t -= std::floor(t);
  return t * kAspectBins + 0.5f;
}

// Mean support of points [from, to) under a similarity: 1 on an edge, 0 from tau on.
float Support(const AspectImage& image,
              const VotePoint* points,
              int from,
              int to,
              const Similarity& s,
              int tau8) {
  const float turn_bins = TurnBins(s.turn);
  int sum = 0;
  for (int i = from; i < to; ++i) {
    const VotePoint& p = points[i];
    const float x = s.a * p.x - s.b * p.y + s.x;
    const float y = s.b * p.x + s.a * p.y + s.y;
    const int bin = kBins.bin[static_cast<int>(p.bin + turn_bins)];
    const int d = image.DistanceAt(x, y, bin);
    sum += std::max(0, tau8 - d);
  }
  return static_cast<float>(sum) / static_cast<float>(tau8 * (to - from));
}

// An oriented distance map in cells of some pixels, with a border of far cells so that places are
// clamped, not tested.
struct CoarseMap {
  int cell_px = 0, width = 0, height = 0;  // the border included
  std::vector<std::uint8_t> distance;      // [bin][y][x], 1/8 px

  CoarseMap(const AspectImage& image, int cell) : cell_px(cell) {
    const int step = cell / 2;  // cells of the half map
    const int w = (image.half_width + step - 1) / step, h = (image.half_height + step - 1) / step;
    width = w + 2;
    height = h + 2;
    distance.assign(static_cast<std::size_t>(kAspectBins) * width * height, 255);
    for (int bin = 0; bin < kAspectBins; ++bin) {
      const std::uint8_t* half = image.half_distance.data() + static_cast<std::size_t>(bin) *
                                                                  image.half_width *
                                                                  image.half_height;
      for (int y = 0; y < h; ++y) {
        for (int x = 0; x < w; ++x) {
          int sum = 0, count = 0;
          for (int v = y * step; v < std::min((y + 1) * step, image.half_height); ++v) {
            for (int u = x * step; u < std::min((x + 1) * step, image.half_width); ++u, ++count)
              sum += half[static_cast<std::size_t>(v) * image.half_width + u];
          }
          distance[(static_cast<std::size_t>(bin) * height + y + 1) * width + x + 1] =
              static_cast<std::uint8_t>(sum / count);
        }
      }
    }
  }

  // Mean support of points [from, to) under a similarity: as Support().
  float Support(
      const PackedVotePoint* points, int from, int to, const Similarity& s, int tau8) const {
    const float cells = 1.0f / static_cast<float>(cell_px);
    const float unit = cells / PackedVotePoint::kPlaceScale;
    const float a = s.a * unit, b = s.b * unit;
    const float x0 = (s.x + 0.5f) * cells + 1.0f, y0 = (s.y + 0.5f) * cells + 1.0f;
    const int turn = static_cast<int>(TurnBins(s.turn) * PackedVotePoint::kBinSteps);
    const float right = static_cast<float>(width - 1), bottom = static_cast<float>(height - 1);
    int sum = 0;
    for (int i = from; i < to; ++i) {
      const float px = points[i].x, py = points[i].y;
      const int x = static_cast<int>(std::clamp(a * px - b * py + x0, 0.0f, right));
      const int y = static_cast<int>(std::clamp(b * px + a * py + y0, 0.0f, bottom));
      const int bin = kBins.bin[(points[i].bin + turn) / PackedVotePoint::kBinSteps];
      sum += std::max(0, tau8 - distance[(static_cast<std::size_t>(bin) * height + y) * width + x]);
    }
    return static_cast<float>(sum) / static_cast<float>(tau8 * (to - from));
  }
};

// Of one image.
struct CoarseMaps {
  explicit CoarseMaps(const AspectImage& image) : half(image, 2), quarter(image, 4) {}
  const CoarseMap& For(int tau8) const { return tau8 >= kQuarterTau8 ? quarter : half; }
  CoarseMap half, quarter;
};

class Share {
 public:
  Share(const AspectImage& image,
        const CoarseMaps& maps,
        const FragmentIndex& index,
        const AspectVoteOptions& options)
      : image_(image), maps_(maps), index_(index), options_(options) {
    pools_.resize(index.parts.size());
    floors_.assign(index.parts.size(), 0.0f);
  }

  void Vote(const ContourFragment& fragment) {
    ++counts_.fragments;
    for (const ContourFragment& way : {fragment, Reversed(fragment)}) {
      found_.clear();
      index_.Find(way.key,
                  static_cast<float>(options_.key_rms_rad) * std::sqrt(float{kFragmentAngles}),
                  &found_);
      counts_.matches += static_cast<std::int64_t>(found_.size());
      const std::size_t stride =
          1 + found_.size() / static_cast<std::size_t>(std::max(1, options_.max_matches));
      for (std::size_t i = counts_.fragments % stride; i < found_.size(); i += stride) {
        const std::uint32_t f = found_[i];
        Test(way, index_.fragments[f], index_.keys[f]);
      }
    }
  }

  std::vector<std::vector<AspectVote>>& pools() { return pools_; }
  const AspectVotes& counts() const { return counts_; }

 private:
  // Scale and turn by least squares over directions and spreads, place by the centres.
  void Test(const ContourFragment& image_side,
            const IndexedFragment& model_side,
            const PackedFragmentKey& key) {
    const float size = image_side.spread / model_side.spread;
    const float width = static_cast<float>(image_.width);
    if (size < options_.min_size_share * width || size > options_.max_size_share * width) return;
    float turn = image_side.chord_rad - model_side.chord_rad;
    float off = 0.0f;
    for (int i = 0; i < kFragmentAngles; ++i) off += image_side.key[i] - key[i] / kKeyScale;
    turn += off / kFragmentAngles;
    Similarity s = MakeSimilarity(size, turn);
    s.x = image_side.center.x() - (s.a * model_side.x - s.b * model_side.y);
    s.y = image_side.center.y() - (s.b * model_side.x + s.a * model_side.y);
    if (!(s.x >= 0 && s.y >= 0 && s.x < width && s.y < static_cast<float>(image_.height))) return;
    const PackedVotePoint* first =
        index_.first_points.data() + static_cast<std::size_t>(model_side.aspect) * kSecondPoints;
    const int tau8 = Tau8(size);
    const CoarseMap& map = maps_.For(tau8);
    const float six = map.Support(first, 0, kFirstPoints, s, tau8);
    if (six < options_.min_support_6) return;
    ++counts_.tests_16;
    const float rest = map.Support(first, kFirstPoints, kSecondPoints, s, tau8);
    const float sixteen =
        (six * kFirstPoints + rest * (kSecondPoints - kFirstPoints)) / kSecondPoints;
    if (sixteen < options_.min_support_16) return;
    const IndexedAspect& aspect = index_.aspects[model_side.aspect];
    const VotePoint* points = index_.points.data() + aspect.first_point;
    const int n = aspect.points;
    const float excess = ExcessChance(points, kFirstPoints, s);
    if (sixteen - excess < options_.min_support_16 * (1.0f - excess)) return;
    if (!IsNew(model_side.aspect, s)) return;
    ++counts_.climbs;
    s = Climb(first, image_side.pivot, sixteen, s);
    const float support = Support(image_, points, 0, n, s, Tau8(s.size));
    if (support < options_.min_support) return;
    const float chance = ExcessChance(points, n, s);
    const float gain =
        (support - chance) / (1.0f - chance) - static_cast<float>(options_.rank_support);
    if (gain <= 0) return;
    ++counts_.accepted;
    const float rank = aspect.edge_length * s.size * gain;
    Keep(aspect.part, {rank, support, model_side.aspect, s.size, s.turn, s.x, s.y});
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
          step(s.turn - 2 * kPi * std::floor(s.turn / (2 * kPi)), 2 * kSeenShare),
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
    return std::max(0.0f, Chance(points, n, s) - static_cast<float>(options_.free_chance));
  }

  // Mean support that these directions find around these places anyway.
  float Chance(const VotePoint* points, int n, const Similarity& s) const {
    const float turn_bins = TurnBins(s.turn);
    const int level =
        AspectImage::ChanceLevel(static_cast<float>(Tau8(s.size)) / AspectImage::kDistanceScale);
    int sum = 0;
    for (int i = 0; i < n; ++i) {
      const VotePoint& p = points[i];
      const float x = s.a * p.x - s.b * p.y + s.x;
      const float y = s.b * p.x + s.a * p.y + s.y;
      if (!(x >= 0 && y >= 0 && x < image_.width && y < image_.height)) continue;
      sum += image_.ChanceAt(x, y, kBins.bin[static_cast<int>(p.bin + turn_bins)], level);
    }
    return static_cast<float>(sum) / (255.0f * static_cast<float>(n));
  }

  // Better size and turn about a point that stays.
  Similarity Climb(const PackedVotePoint* points,
                   const Eigen::Vector2f& pivot,
                   float best,
                   Similarity s) const {
    constexpr float kSteps[][2] = {{1.08f, 0.0f},
                                   {0.926f, 0.0f},
                                   {1.0f, 0.07f},
                                   {1.0f, -0.07f},
                                   {1.04f, 0.0f},
                                   {0.962f, 0.0f},
                                   {1.0f, 0.035f},
                                   {1.0f, -0.035f}};
    for (const auto& step : kSteps) {
      Similarity other = MakeSimilarity(s.size * step[0], s.turn + step[1]);
      const float dx = s.x - pivot.x(), dy = s.y - pivot.y();
      const float c = step[0] * std::cos(step[1]), t = step[0] * std::sin(step[1]);
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

  void Keep(int part, const AspectVote& vote) {
    std::vector<AspectVote>& pool = pools_[part];
    if (vote.rank < floors_[part]) return;
    pool.push_back(vote);
    const std::size_t keep = static_cast<std::size_t>(options_.pool);
    if (pool.size() < 2 * keep) return;
    std::nth_element(pool.begin(),
                     pool.begin() + static_cast<std::ptrdiff_t>(keep) - 1,
                     pool.end(),
                     [](const AspectVote& p, const AspectVote& q) { return p.rank > q.rank; });
    floors_[part] = pool[keep - 1].rank;
    pool.resize(keep);
  }

  const AspectImage& image_;
  const CoarseMaps& maps_;
  const FragmentIndex& index_;
  const AspectVoteOptions& options_;
  std::vector<std::vector<AspectVote>> pools_;
  std::vector<float> floors_;
  std::vector<std::uint32_t> found_;
  std::vector<std::uint32_t> seen_ = std::vector<std::uint32_t>(kSeenSlots, 0);
  AspectVotes counts_;
};

// Direction of view in the object's frame and the axis that is up in the image: two aspects with
// their turns are alike when the rotation between them is small.
Eigen::Matrix3f RotationOf(const AspectVote& vote, const FragmentIndex& index) {
  const IndexedAspect& a = index.aspects[vote.aspect];
  const AspectSet& set = index.parts[a.part].object->aspects;
  return Eigen::AngleAxisf(vote.turn_rad, Eigen::Vector3f::UnitZ()) *
         set.aspects[a.aspect].camera_from_object;
}

struct Chosen {
  AspectVote vote;
  Eigen::Matrix3f rotation;
};

bool SamePose(const Chosen& a, const Chosen& b, std::span<const Rigid3> symmetries) {
  const float ratio = a.vote.size_px / b.vote.size_px;
  if (ratio > kSameSize || ratio < 1 / kSameSize) return false;
  const float dx = a.vote.x - b.vote.x, dy = a.vote.y - b.vote.y;
  const float reach = kSamePlace * b.vote.size_px;
  if (dx * dx + dy * dy > reach * reach) return false;
  // Trace of the rotation between them.
  const Eigen::Matrix3f between = b.rotation.transpose() * a.rotation;
  const float least = 1.0f + 2.0f * std::cos(kSameTurnRad);
  if (between.trace() > least) return true;
  return std::any_of(symmetries.begin(), symmetries.end(), [&](const Rigid3& s) {
    return between.cwiseProduct(s.R.cast<float>()).sum() > least;
  });
}

std::vector<AspectVote> ChooseDistinct(std::vector<AspectVote> pool,
                                       const FragmentIndex& index,
                                       std::span<const Rigid3> symmetries,
                                       const AspectVoteOptions& options) {
  std::sort(pool.begin(), pool.end(), [](const AspectVote& p, const AspectVote& q) {
    if (p.rank != q.rank) return p.rank > q.rank;
    if (p.aspect != q.aspect) return p.aspect < q.aspect;
    return p.x < q.x;
  });
  if (static_cast<int>(pool.size()) > options.pool) pool.resize(options.pool);
  std::vector<Chosen> chosen;
  for (const AspectVote& vote : pool) {
    if (static_cast<int>(chosen.size()) >= options.max_per_part) break;
    const Chosen candidate{vote, RotationOf(vote, index)};
    int here = 0;
    bool known = false;
    for (const Chosen& other : chosen) {
      const float dx = vote.x - other.vote.x, dy = vote.y - other.vote.y;
      const float reach = kPlaceRadius * std::min(vote.size_px, other.vote.size_px);
      here += dx * dx + dy * dy < reach * reach ? 1 : 0;
      known = known || SamePose(candidate, other, symmetries);
    }
    if (known || here >= options.max_per_place) continue;
    chosen.push_back(candidate);
  }
  std::vector<AspectVote> out;
  for (const Chosen& c : chosen) out.push_back(c.vote);
  return out;
}

}  // namespace

AspectVotes VoteForAspects(const AspectImage& image,
                           const FragmentIndex& index,
                           const AspectVoteOptions& options,
                           const StopRequested& stop) {
  AspectVotes out;
  out.of_part.resize(index.parts.size());
  if (image.width == 0 || index.fragments.empty()) return out;
  FragmentOptions pieces;
  pieces.min_length = options.min_fragment_px;
  pieces.max_length = options.max_fragment_share * image.width;
  pieces.length_factor = options.fragment_factor;
  pieces.start_share = options.start_share;
  pieces.min_step = options.min_step;
  std::vector<ContourFragment> fragments = CollectFragments(image.contours, pieces);
  DropRepeated(options.max_repeats, &fragments);
  // Each share keeps its own pool, so the result does not depend on the number of threads.
  const CoarseMaps maps(image);
  std::vector<Share> shares(kShares, Share(image, maps, index, options));
  ParallelFor(kShares, options.threads, [&](int i) {
    for (std::size_t f = i; f < fragments.size(); f += kShares) {
      if (f / kShares % 16 == 0 && IsStopRequested(stop)) return;
      shares[i].Vote(fragments[f]);
    }
  });
  for (Share& share : shares) {
    out.fragments += share.counts().fragments;
    out.matches += share.counts().matches;
    out.tests_16 += share.counts().tests_16;
    out.climbs += share.counts().climbs;
    out.accepted += share.counts().accepted;
  }
  ParallelFor(static_cast<int>(index.parts.size()), options.threads, [&](int part) {
    std::vector<AspectVote> pool;
    for (Share& share : shares) {
      pool.insert(pool.end(), share.pools()[part].begin(), share.pools()[part].end());
    }
    out.of_part[part] =
        ChooseDistinct(std::move(pool), index, index.parts[part].symmetries, options);
  });
  return out;
}

Rigid3 PoseOfVote(const AspectVote& vote, const FragmentIndex& index, const PinholeCamera& camera) {
  const IndexedAspect& a = index.aspects[vote.aspect];
  const AspectSet& set = index.parts[a.part].object->aspects;
  const Eigen::Vector3d ray(
      (vote.x - camera.cx) / camera.focal_px, (vote.y - camera.cy) / camera.focal_px, 1.0);
  const double depth = camera.focal_px * set.diameter_m / vote.size_px;
  const Eigen::Matrix3d onto_ray =
      Eigen::Quaterniond::FromTwoVectors(Eigen::Vector3d::UnitZ(), ray).toRotationMatrix();
  Rigid3 pose;
  pose.R = onto_ray *
           Eigen::AngleAxisd(vote.turn_rad, Eigen::Vector3d::UnitZ()).toRotationMatrix() *
           set.aspects[a.aspect].camera_from_object.cast<double>();
  pose.t = depth * ray - pose.R * set.center.cast<double>();
  return pose;
}

}  // namespace horopter
