#include "server/service/exif.h"

#include <algorithm>
#include <cstddef>

#include "server/service/heif_brands.h"

namespace horopter {
namespace {

// Segments or chunks of a file that are looked at, and entries of a directory.
constexpr int kMaxSections = 1000;
constexpr unsigned kMaxEntries = 500;
constexpr std::string_view kExifHeader("Exif\0\0", 6);

// Bytes of either order. Outside the file everything is 0.
struct Reader {
  std::string_view bytes;
  bool little = false;

  uint64_t Number(uint64_t at, int size) const {
    if (at > bytes.size() || bytes.size() - at < static_cast<size_t>(size)) return 0;
    uint64_t value = 0;
    for (int i = 0; i < size; ++i) {
      const int k = little ? size - 1 - i : i;
      value = value << 8 | static_cast<unsigned char>(bytes[at + static_cast<size_t>(k)]);
    }
    return value;
  }
};

enum Tag : unsigned {
  kImageWidth = 0x0100,
  kImageHeight = 0x0101,
  kOrientation = 0x0112,
  kExifDirectory = 0x8769,
  kFocalLength = 0x920a,
  kPixelXDimension = 0xa002,
  kPixelYDimension = 0xa003,
  kFocalPlaneXResolution = 0xa20e,
  kFocalPlaneResolutionUnit = 0xa210,
  kDigitalZoomRatio = 0xa404,
  kFocalLengthIn35mmFilm = 0xa405,
};

// The first value of an entry: of SHORT, LONG and RATIONAL.
std::optional<double> ValueAt(const Reader& tiff, uint64_t entry) {
  const uint64_t type = tiff.Number(entry + 2, 2), count = tiff.Number(entry + 4, 4);
  if (count < 1) return std::nullopt;
  if (type == 3) return static_cast<double>(tiff.Number(entry + 8, 2));
  if (type == 4) return static_cast<double>(tiff.Number(entry + 8, 4));
  if (type != 5) return std::nullopt;
  const uint64_t at = tiff.Number(entry + 8, 4);
  const uint64_t over = tiff.Number(at, 4), under = tiff.Number(at + 4, 4);
  if (under == 0) return std::nullopt;
  return static_cast<double>(over) / static_cast<double>(under);
}

void Between(std::optional<double> value, double least, double most, std::optional<double>* out) {
  if (value && *value >= least && *value <= most && !*out) *out = value;
}

// What the directories say in all.
struct Directories {
  Exif exif;
  std::optional<double> plane_resolution, plane_unit, pixel_width, pixel_height, image_width,
      image_height, orientation;
};

// Returns where the directory of Exif's own tags is; 0: not named.
uint64_t ReadDirectory(const Reader& tiff, uint64_t at, Directories* out) {
  uint64_t exif_directory = 0;
  const uint64_t entries = std::min<uint64_t>(tiff.Number(at, 2), kMaxEntries);
  constexpr double kMostSidePixels = 1e6;  // a side
  for (uint64_t i = 0; i < entries; ++i) {
    const uint64_t entry = at + 2 + 12 * i;
    const std::optional<double> value = ValueAt(tiff, entry);
    switch (tiff.Number(entry, 2)) {
      case kImageWidth:
        Between(value, 1, kMostSidePixels, &out->image_width);
        break;
      case kImageHeight:
        Between(value, 1, kMostSidePixels, &out->image_height);
        break;
      case kOrientation:
        Between(value, 1, 8, &out->orientation);
        break;
      case kExifDirectory:
        if (value && exif_directory == 0) exif_directory = static_cast<uint64_t>(*value);
        break;
      case kPixelXDimension:
        Between(value, 1, kMostSidePixels, &out->pixel_width);
        break;
      case kPixelYDimension:
        Between(value, 1, kMostSidePixels, &out->pixel_height);
        break;
      case kFocalLength:
        Between(value, 0.1, 10'000, &out->exif.focal_mm);
        break;
      case kFocalLengthIn35mmFilm:
        Between(value, 1, 10'000, &out->exif.focal_35mm);
        break;
      case kFocalPlaneXResolution:
        Between(value, 1e-3, 1e7, &out->plane_resolution);
        break;
      case kFocalPlaneResolutionUnit:
        Between(value, 1, 5, &out->plane_unit);
        break;
      case kDigitalZoomRatio:
        Between(value, 1, 1'000, &out->exif.digital_zoom);
        break;
      default:
        break;
    }
  }
  return exif_directory;
}

double MillimetresOf(double unit) {
  switch (static_cast<int>(unit)) {
    case 3:
      return 10.0;
    case 4:
      return 1.0;
    case 5:
      return 1e-3;
    default:
      return 25.4;
  }
}

Exif ReadTiff(std::string_view bytes) {
  Reader tiff{bytes};
  if (bytes.size() < 8) return {};
  if (bytes.substr(0, 2) == "II") {
    tiff.little = true;
  } else if (bytes.substr(0, 2) != "MM") {
    return {};
  }
  if (tiff.Number(2, 2) != 42) return {};
  Directories read;
  const uint64_t first = tiff.Number(4, 4);
  const uint64_t own = ReadDirectory(tiff, first, &read);
  if (own != 0 && own != first) ReadDirectory(tiff, own, &read);
  Exif exif = read.exif;
  exif.orientation = static_cast<int>(read.orientation.value_or(1));
  const bool by_exif = read.pixel_width && read.pixel_height;
  const auto& width = by_exif ? read.pixel_width : read.image_width;
  const auto& height = by_exif ? read.pixel_height : read.image_height;
  if (width && height) {
    exif.width_px = static_cast<int64_t>(*width);
    exif.height_px = static_cast<int64_t>(*height);
  }
  if (read.plane_resolution)
    exif.pixels_per_mm = *read.plane_resolution / MillimetresOf(read.plane_unit.value_or(2));
  return exif;
}

std::string_view FromJpeg(const Reader& file) {
  uint64_t at = 2;
  for (int i = 0; i < kMaxSections; ++i) {
    while (file.Number(at, 2) == 0xffff) ++at;  // fill bytes
    const uint64_t marker = file.Number(at, 2), length = file.Number(at + 2, 2);
    constexpr uint64_t kStartOfScan = 0xffda, kApp1 = 0xffe1;
    if (marker < 0xffc0 || marker == kStartOfScan || length < 2) return {};
    if (marker == kApp1 && file.bytes.substr(at + 4, kExifHeader.size()) == kExifHeader) {
      const uint64_t begin = at + 4 + kExifHeader.size(), end = at + 2 + length;
      return begin < end ? file.bytes.substr(begin, end - begin) : std::string_view();
    }
    at += 2 + length;
    if (at >= file.bytes.size()) return {};
  }
  return {};
}

// Chunks with name and length: PNG's (length first, a checksum behind) and RIFF's (name first,
// padded to even).
std::string_view FromChunks(const Reader& file, uint64_t at, std::string_view name, bool png) {
  for (int i = 0; i < kMaxSections && at + 8 <= file.bytes.size(); ++i) {
    const uint64_t length = file.Number(at + (png ? 0 : 4), 4);
    if (file.bytes.substr(at + (png ? 4 : 0), 4) == name) {
      std::string_view chunk = file.bytes.substr(at + 8, length);
      if (chunk.substr(0, kExifHeader.size()) == kExifHeader)
        chunk.remove_prefix(kExifHeader.size());
      return chunk;
    }
    at += 8 + length + (png ? 4 : length % 2);
  }
  return {};
}

// Of a HEIC file the block is one of its items, which all lie in one heap: found by its header,
// which the standard puts before it. What looks like one elsewhere is read as little as any other.
std::string_view FromHeic(std::string_view file) {
  for (size_t at = file.find(kExifHeader); at != file.npos; at = file.find(kExifHeader, at + 1)) {
    const std::string_view block = file.substr(at + kExifHeader.size());
    // The table of items, too, holds the word.
    if (block.substr(0, 2) == "II" || block.substr(0, 2) == "MM") return block;
  }
  return {};
}

}  // namespace

Exif ReadExif(std::string_view file) {
  constexpr std::string_view kPng = "\x89PNG\r\n\x1a\n";
  if (file.substr(0, 2) == "\xff\xd8") return ReadTiff(FromJpeg({file}));
  if (file.substr(0, kPng.size()) == kPng)
    return ReadTiff(FromChunks({file}, kPng.size(), "eXIf", true));
  if (file.substr(0, 4) == "RIFF" && file.size() >= 12)
    return ReadTiff(FromChunks({file, true}, 12, "EXIF", false));
  if (HeifKindOf(file) == HeifKind::kHeic) {
    Exif exif = ReadTiff(FromHeic(file));
    exif.orientation = 1;  // the image was turned when it was decoded
    return exif;
  }
  return ReadTiff(file);
}

}  // namespace horopter
