// Distances to the nearest marked pixel as far as a byte holds them.
#pragma once

#include <cstdint>
#include <span>

namespace horopter {

// In eighths of a pixel, rounded, by the chamfer of 0.955 px along and 1.3693 px across pixels
// (Borgefors, Distance transformations in digital images, 1986); 255 from 31.875 px on and where
// nothing is marked. marked (0: not), distance: width x height, row by row.
void FillCappedDistance(std::span<const std::uint8_t> marked,
                        int width,
                        int height,
                        std::span<std::uint8_t> distance);

}  // namespace horopter
