#include "server/vision/recognition/aspects/near_keys.h"

#include <algorithm>
#include <bit>
#include <cmath>
#include <cstring>

#include "server/base/lanes.h"
#include "server/base/target_clones.h"

namespace horopter {
namespace {

constexpr int kCoarseStep = 8;  // steps of a key: 1 / 64 rad

std::int16_t CoarseOf(std::int16_t step) {
  return static_cast<std::int16_t>((step + kCoarseStep / 2) >>
                                   std::countr_zero(unsigned{kCoarseStep}));
}

// Twice the usual lanes: 16 bits are enough for a sum.
constexpr int kKeys = CoarseKeys::kLanes;
using Shorts = std::int16_t __attribute__((vector_size(2 * kKeys)));
using Sums = std::uint16_t __attribute__((vector_size(2 * kKeys)));
using Bytes = std::int8_t __attribute__((vector_size(kKeys)));

HOROPTER_TARGET_CLONES
std::size_t FindCoarse(const std::array<const std::int16_t*, kFragmentAngles>& keys,
                       const CoarseKeys::Key& center,
                       std::uint32_t begin,
                       std::uint32_t end,
                       std::uint16_t limit,
                       CoarseKeys::Near* near) {
  constexpr int kHalf = kKeys / 2;
  std::size_t count = 0;
  for (std::uint32_t f = begin; f < end; f += kKeys) {
    Sums sum = {};
    for (int k = 0; k < kFragmentAngles; ++k) {
      Shorts d;
      LoadLanes(keys[k] + f, &d);
      d -= center[k];
      d = d < 0 ? -d : d;
      d = d < CoarseKeys::kFar ? d : Shorts{} + CoarseKeys::kFar;
      sum += reinterpret_cast<Sums>(d * d);
    }
    const Bytes hits = __builtin_convertvector(sum <= limit, Bytes);
    std::uint64_t halves[2];
    std::memcpy(halves, &hits, sizeof(halves));
    for (int half = 0; half < 2; ++half) {
      for (std::uint64_t m = halves[half]; m != 0;) {
        const int lane = half * kHalf + std::countr_zero(m) / 8;
        m &= ~(std::uint64_t{0xff} << 8 * (lane % kHalf));
        near[count] = {f + static_cast<std::uint32_t>(lane), sum[lane]};
        count += near[count].number < end ? 1 : 0;
      }
    }
  }
  return count;
}

}  // namespace

CoarseKeys::CoarseKeys(std::span<const PackedFragmentKey> keys) {
  for (int k = 0; k < kFragmentAngles; ++k) {
    steps_[k].assign(keys.size() + kLanes, 0);
    for (std::size_t i = 0; i < keys.size(); ++i) steps_[k][i] = CoarseOf(keys[i][k]);
  }
}

CoarseKeys::Key CoarseKeys::Coarse(const PackedFragmentKey& key) {
  Key out;
  std::transform(key.begin(), key.end(), out.begin(), CoarseOf);
  return out;
}

int CoarseKeys::LimitOf(float radius_rad) {
  const float steps = radius_rad * kKeyScale / kCoarseStep;
  return static_cast<int>(std::min(steps * steps, static_cast<float>(kFar * kFar - 1)));
}

float CoarseKeys::RadiusOf(int limit) {
  // Both keys are rounded: every angle may differ by one step more than it seems to.
  const float slack = std::sqrt(float{kFragmentAngles});
  return (std::sqrt(static_cast<float>(limit + 1)) + slack) * kCoarseStep / kKeyScale;
}

std::size_t CoarseKeys::Find(
    const Key& key, std::uint32_t begin, std::uint32_t end, int limit, Near* near) const {
  std::array<const std::int16_t*, kFragmentAngles> keys;
  for (int k = 0; k < kFragmentAngles; ++k) keys[k] = steps_[k].data();
  return FindCoarse(keys, key, begin, end, static_cast<std::uint16_t>(limit), near);
}

std::size_t CoarseKeys::bytes() const {
  std::size_t sum = 0;
  for (const auto& steps : steps_) sum += steps.capacity() * sizeof(steps[0]);
  return sum;
}

void NearestKeys::Take(std::vector<std::uint32_t>* out) {
  std::erase_if(kept_, [&](const Kept& k) { return k.squared > limit_; });
  if (kept_.size() > most_) {
    std::nth_element(
        kept_.begin(), kept_.begin() + static_cast<std::ptrdiff_t>(most_), kept_.end());
    kept_.resize(most_);
  }
  const auto first = static_cast<std::ptrdiff_t>(out->size());
  for (const Kept& k : kept_) out->push_back(k.number);
  std::sort(out->begin() + first, out->end());
}

}  // namespace horopter
