// Keys of fragments that differ little from one: a coarse comparison of sixteen at once, and the
// nearest of those that it lets pass.
#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <span>
#include <vector>

#include "server/vision/recognition/aspects/contour_fragments.h"

namespace horopter {

// Sum of squared differences of two keys, in steps of 1 / kKeyScale rad.
inline int SquaredSteps(const PackedFragmentKey& a, const PackedFragmentKey& b) {
  int sum = 0;
  for (int i = 0; i < kFragmentAngles; ++i) sum += (a[i] - b[i]) * (a[i] - b[i]);
  return sum;
}

// Keys in coarse steps, an angle at a time.
class CoarseKeys {
 public:
  static constexpr std::uint32_t kLanes = 16;  // that are compared at once

  CoarseKeys() = default;
  explicit CoarseKeys(std::span<const PackedFragmentKey> keys);

  // A key as the others are held, to compare them with.
  using Key = std::array<std::int16_t, kFragmentAngles>;
  static Key Coarse(const PackedFragmentKey& key);
  // Largest squared difference, in coarse steps, of keys that differ by a radius (radians).
  static int LimitOf(float radius_rad);
  // Largest difference in radians of what a limit lets pass.
  static float RadiusOf(int limit);

  struct Near {
    std::uint32_t number;
    std::uint16_t squared;  // difference, coarse steps
  };
  // Angles that differ by more coarse steps differ by so many: the sum of eight squares is 16 bit.
  static constexpr int kFar = 90;
  // Writes the keys in [begin, end) that differ by at most `limit`, below kFar squared. Returns how
  // many; `near` has room for kLanes more than end - begin.
  std::size_t Find(
      const Key& key, std::uint32_t begin, std::uint32_t end, int limit, Near* near) const;

  std::size_t bytes() const;

 private:
  std::array<std::vector<std::int16_t>, kFragmentAngles> steps_;  // padded
};

// The nearest of the keys that are offered: as soon as there are enough of them within some
// distance, none beyond it is asked for. What is taken does not depend on the order.
class NearestKeys {
 public:
  // limit: a squared difference; at most `most` are taken.
  NearestKeys(int limit, std::size_t most)
      : limit_(limit), most_(most), step_(limit / kRings + 1) {}

  int limit() const { return limit_; }  // farther ones need not be offered

  void Offer(std::uint32_t number, int squared) {
    if (squared > limit_) return;
    kept_.push_back({squared, number});
    ++in_ring_[squared / step_];
    ++within_;
    // Rings beyond those that hold enough are closed.
    while (outer_ > 0 && within_ - in_ring_[outer_] >= most_) {
      within_ -= in_ring_[outer_];
      limit_ = outer_ * step_ - 1;
      --outer_;
    }
  }

  // Appends the nearest, of those equally near the lowest, by their numbers.
  void Take(std::vector<std::uint32_t>* out);

 private:
  static constexpr int kRings = 64;
  struct Kept {
    int squared;
    std::uint32_t number;
    friend auto operator<=>(const Kept&, const Kept&) = default;
  };

  int limit_;
  std::size_t most_, within_ = 0;  // kept within the limit
  int step_, outer_ = kRings - 1;  // squared steps of a ring, and the last ring that is open
  std::array<std::size_t, kRings> in_ring_{};
  std::vector<Kept> kept_;
};

}  // namespace horopter
