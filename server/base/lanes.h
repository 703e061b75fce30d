// Several values that are computed at once: vectors of the compiler, so that functions cloned for
// several instruction sets (target_clones.h) use the registers they have. Not for signatures: how
// such a vector is handed over depends on the instruction set.
#pragma once

#include <cstdint>
#include <cstring>

namespace horopter {

inline constexpr int kLanes = 8;
using FloatLanes = float __attribute__((vector_size(4 * kLanes)));
using IntLanes = std::int32_t __attribute__((vector_size(4 * kLanes)));
using ShortLanes = std::int16_t __attribute__((vector_size(2 * kLanes)));
using UnsignedShortLanes = std::uint16_t __attribute__((vector_size(2 * kLanes)));

// As many values as `lanes` holds, wherever they begin.
template <typename Value, typename Lanes>
inline void LoadLanes(const Value* from, Lanes* lanes) {
  std::memcpy(lanes, from, sizeof(*lanes));
}

}  // namespace horopter
