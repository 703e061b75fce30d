#include "server/service/heif_brands.h"

#include <algorithm>
#include <cstddef>
#include <vector>

namespace horopter {
namespace {

// Of the first box at most; real files have a dozen.
constexpr size_t kMaxBoxBytes = 1024;

// The major brand first.
std::vector<std::string_view> BrandsOf(std::string_view bytes) {
  if (bytes.size() < 12 || bytes.substr(4, 4) != "ftyp") return {};
  size_t size = 0;
  for (int i = 0; i < 4; ++i) size = size << 8 | static_cast<unsigned char>(bytes[i]);
  size = std::min({size, bytes.size(), kMaxBoxBytes});
  std::vector<std::string_view> brands{bytes.substr(8, 4)};
  for (size_t at = 16; at + 4 <= size; at += 4) brands.push_back(bytes.substr(at, 4));
  return brands;
}

}  // namespace

HeifKind HeifKindOf(std::string_view bytes) {
  const std::vector<std::string_view> brands = BrandsOf(bytes);
  if (brands.empty()) return HeifKind::kNone;
  const auto has = [&](std::initializer_list<std::string_view> any) {
    return std::any_of(brands.begin(), brands.end(), [&](std::string_view brand) {
      return std::find(any.begin(), any.end(), brand) != any.end();
    });
  };
  // The major brand says what the file is for; files that are several things list them all.
  if (brands[0] == "crx ") return HeifKind::kCr3;
  if (brands[0] == "avif" || brands[0] == "avis") return HeifKind::kAvif;
  if (has({"heic", "heix", "heim", "heis"})) return HeifKind::kHeic;
  if (has({"avif", "avis"})) return HeifKind::kAvif;
  if (has({"hevc", "hevx", "hevm", "hevs"})) return HeifKind::kSequence;
  // No coding named among the brands: the usual one.
  if (brands[0] == "mif1" || brands[0] == "mif2") {
    return has({"jpeg", "j2ki", "avci", "vvic", "evbi"}) ? HeifKind::kOtherImage : HeifKind::kHeic;
  }
  if (has({"jpeg", "j2ki", "avci", "vvic", "evbi"})) return HeifKind::kOtherImage;
  return HeifKind::kVideo;
}

}  // namespace horopter
