// Texts of files and file systems, which may be in any encoding, for the wire, which is UTF-8.
#pragma once

#include <string>
#include <string_view>

namespace horopter {

// As RFC 3629 has it: no surrogates, nothing above U+10FFFF, nothing longer than needed.
bool IsUtf8(std::string_view text);

// The text itself where it is UTF-8, else what it is as Windows-1252, the superset of Latin-1 that
// old programs write; bytes that have no meaning there become U+FFFD.
std::string ToUtf8(std::string_view text);

}  // namespace horopter
