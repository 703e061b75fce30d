// SHA-256 (FIPS 180-4), the fingerprint of a stored CAD file.
#pragma once

#include <string>
#include <string_view>

namespace horopter {

// 64 lower-case hex digits.
std::string Sha256Hex(std::string_view bytes);

}  // namespace horopter
