// A PNG whose header claims another size; nothing else of it changes.
#pragma once

#include <cstdint>
#include <string>

namespace horopter {

// The checksum of the header (PNG, annex D) is made right.
inline std::string WithPngSize(std::string png, uint32_t width, uint32_t height) {
  const auto put = [&](size_t at, uint32_t value) {
    for (int i = 0; i < 4; ++i) png[at + i] = static_cast<char>(value >> (24 - 8 * i));
  };
  put(16, width);
  put(20, height);
  uint32_t crc = 0xffffffffu;
  for (size_t i = 12; i < 29; ++i) {
    crc ^= static_cast<unsigned char>(png[i]);
    for (int bit = 0; bit < 8; ++bit) crc = crc >> 1 ^ (crc & 1 ? 0xedb88320u : 0u);
  }
  put(29, ~crc);
  return png;
}

}  // namespace horopter
