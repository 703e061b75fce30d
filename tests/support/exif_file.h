// Files with Exif of one's own making: what is around it need not be an image.
#pragma once

#include <cstdint>
#include <string>
#include <vector>

namespace horopter {

// One value of type 3 (SHORT), 4 (LONG) or 5 (RATIONAL, value / under), in Exif's own directory or
// the first one.
struct ExifEntry {
  unsigned tag = 0;
  unsigned type = 3;
  uint64_t value = 0;
  uint64_t under = 1;
  bool own_directory = true;
};

inline std::string NumberBytes(uint64_t value, int size, bool little) {
  std::string out;
  for (int i = 0; i < size; ++i) {
    out += static_cast<char>(value >> (8 * (little ? i : size - 1 - i)) & 0xff);
  }
  return out;
}

// The TIFF structure: a first directory with the pointer to Exif's own.
inline std::string ExifBlock(const std::vector<ExifEntry>& entries, bool little) {
  size_t first_count = 1, own_count = 0;
  for (const ExifEntry& e : entries) ++(e.own_directory ? own_count : first_count);
  const size_t first = 8, own = first + 2 + 12 * first_count + 4,
               values = own + 2 + 12 * own_count + 4;
  std::string rationals;
  const auto entry = [&](const ExifEntry& e) {
    std::string bytes =
        NumberBytes(e.tag, 2, little) + NumberBytes(e.type, 2, little) + NumberBytes(1, 4, little);
    if (e.type == 3) return bytes + NumberBytes(e.value, 2, little) + std::string(2, '\0');
    if (e.type == 4) return bytes + NumberBytes(e.value, 4, little);
    bytes += NumberBytes(values + rationals.size(), 4, little);
    rationals += NumberBytes(e.value, 4, little) + NumberBytes(e.under, 4, little);
    return bytes;
  };
  const auto directory = [&](bool of_own, size_t count) {
    std::string bytes = NumberBytes(count, 2, little);
    for (const ExifEntry& e : entries) {
      if (e.own_directory == of_own) bytes += entry(e);
    }
    if (!of_own) bytes += entry({0x8769, 4, own, 1, false});
    return bytes + std::string(4, '\0');
  };
  std::string block =
      (little ? "II" : "MM") + NumberBytes(42, 2, little) + NumberBytes(first, 4, little);
  block += directory(false, first_count);
  block += directory(true, own_count);
  return block + rationals;
}

// The Exif segment of a JPEG file.
inline std::string ExifSegment(const std::string& block) {
  const std::string content = std::string("Exif\0\0", 6) + block;
  return "\xff\xe1" + NumberBytes(content.size() + 2, 2, false) + content;
}

// A JFIF segment, then Exif, then the start of a scan.
inline std::string JpegWith(const std::string& block) {
  return "\xff\xd8\xff\xe0" + NumberBytes(16, 2, false) + std::string(14, 'x') +
         ExifSegment(block) + "\xff\xda" + std::string(20, 'x');
}

inline std::string PngWith(const std::string& block) {
  const auto chunk = [](const std::string& name, const std::string& data) {
    return NumberBytes(data.size(), 4, false) + name + data + "sum.";
  };
  return "\x89PNG\r\n\x1a\n" + chunk("IHDR", std::string(13, 'x')) + chunk("eXIf", block) +
         chunk("IEND", "");
}

inline std::string WebpWith(const std::string& block) {
  const auto chunk = [](const std::string& name, const std::string& data) {
    return name + NumberBytes(data.size(), 4, true) + data + std::string(data.size() % 2, '\0');
  };
  const std::string chunks = "WEBP" + chunk("VP8X", std::string(10, 'x')) +
                             chunk("VP8 ", std::string(7, 'x')) + chunk("EXIF", block);
  return "RIFF" + NumberBytes(chunks.size(), 4, true) + chunks;
}

}  // namespace horopter
