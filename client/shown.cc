#include "client/shown.h"

#include <cstddef>
#include <cstdio>

namespace horopter {
namespace {

// The character of U+0080 to U+009F, U+202A to U+202E or U+2066 to U+2069 that begins there and how
// many bytes it has; 0: another.
int MarkAt(std::string_view text, std::size_t i, std::size_t* bytes) {
  const auto at = [&](std::size_t k) {
    return i + k < text.size() ? static_cast<unsigned char>(text[i + k]) : 0;
  };
  if (at(0) == 0xC2 && at(1) >= 0x80 && at(1) <= 0x9F) {
    *bytes = 2;
    return at(1);
  }
  if (at(0) != 0xE2 || (at(1) & 0xC0) != 0x80 || (at(2) & 0xC0) != 0x80) return 0;
  const int code = 0x2000 + ((at(1) & 0x3F) << 6) + (at(2) & 0x3F);
  *bytes = 3;
  return (code >= 0x202A && code <= 0x202E) || (code >= 0x2066 && code <= 0x2069) ? code : 0;
}

}  // namespace

std::string Shown(std::string_view text) {
  std::string out;
  for (std::size_t i = 0; i < text.size(); ++i) {
    const auto c = static_cast<unsigned char>(text[i]);
    char code[16];
    std::size_t bytes = 1;
    if ((c < 0x20 && c != '\n' && c != '\t') || c == 0x7F) {
      std::snprintf(code, sizeof(code), "\\x%02x", c);
      out += code;
    } else if (const int mark = MarkAt(text, i, &bytes); mark != 0) {
      std::snprintf(code, sizeof(code), "\\u%04x", mark);
      out += code;
      i += bytes - 1;
    } else {
      out += text[i];
    }
  }
  return out;
}

}  // namespace horopter
