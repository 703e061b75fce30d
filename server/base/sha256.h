// SHA-256 (FIPS 180-4): fingerprints of CAD files, objects, backups and tokens.
#pragma once

#include <array>
#include <cstdint>
#include <string>
#include <string_view>

namespace horopter {

// Of bytes that come in pieces.
class Sha256 {
 public:
  void Add(std::string_view bytes);
  // 64 lower-case hex digits, of all that was added.
  std::string Hex() const;

 private:
  std::array<uint32_t, 8> state_ = {0x6a09e667,
                                    0xbb67ae85,
                                    0x3c6ef372,
                                    0xa54ff53a,
                                    0x510e527f,
                                    0x9b05688c,
                                    0x1f83d9ab,
                                    0x5be0cd19};
  std::array<unsigned char, 64> rest_ = {};  // of the block that is not whole
  uint64_t size_ = 0;
};

std::string Sha256Hex(std::string_view bytes);

}  // namespace horopter
