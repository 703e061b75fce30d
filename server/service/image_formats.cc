#include "server/service/image_formats.h"

#include <algorithm>
#include <array>
#include <cctype>
#include <cstdint>
#include <cstring>

#include "server/service/heif_brands.h"

namespace horopter {
namespace {

using namespace std::string_view_literals;

struct Signature {
  size_t at;
  std::string_view bytes;
  const char* name;
};

constexpr Signature kSignatures[] = {
    {0, "GIF8"sv, "a GIF image"},
    {0, "\0\0\0\x0cjP  \r\n\x87\n"sv, "a JPEG 2000 image"},
    {0, "\xff\x4f\xff\x51"sv, "a JPEG 2000 image"},
    {0, "\0\0\0\x0cJXL \r\n\x87\n"sv, "a JPEG XL image"},
    {0, "\xff\x0a"sv, "a JPEG XL image"},
    {0, "II\xbc"sv, "a JPEG XR image"},
    {0, "II+\0"sv, "a BigTIFF image"},
    {0, "MM\0+"sv, "a BigTIFF image"},
    {0, "IIU\0"sv, "a camera's raw image (RW2)"},
    {0, "IIRO"sv, "a camera's raw image (ORF)"},
    {0, "IIRS"sv, "a camera's raw image (ORF)"},
    {0, "MMOR"sv, "a camera's raw image (ORF)"},
    {0, "FUJIFILMCCD-RAW"sv, "a camera's raw image (RAF)"},
    {0, "\0MRM"sv, "a camera's raw image (MRW)"},
    {0, "FOVb"sv, "a camera's raw image (X3F)"},
    {8, "CR\2\0"sv, "a camera's raw image (CR2)"},
    {0, "8BPS"sv, "a Photoshop image"},
    {0, "v/1\1"sv, "an OpenEXR image"},
    {0, "#?RADIANCE"sv, "a Radiance HDR image"},
    {0, "qoif"sv, "a QOI image"},
    {0, "DDS "sv, "a DDS image"},
    {0, "SIMPLE  ="sv, "a FITS image"},
    {0, "gimp xcf"sv, "a GIMP image"},
    {0, "\0\0\1\0"sv, "an icon"},
    {0, "P1"sv, "a PNM image of ASCII or one bit"},
    {0, "P2"sv, "a PNM image of ASCII or one bit"},
    {0, "P3"sv, "a PNM image of ASCII or one bit"},
    {0, "P4"sv, "a PNM image of ASCII or one bit"},
    {0, "P7"sv, "a PAM image"},
    {0, "PF"sv, "a PFM image, in floating point"},
    {0, "Pf"sv, "a PFM image, in floating point"},
    {0, "\x93NUMPY"sv, "an array of numpy"},
    {0, "\x89HDF"sv, "an HDF5 file"},
    {0, "%PDF"sv, "a PDF document"},
    {0, "PK\3\4"sv, "a ZIP archive"},
    {0, "\x1f\x8b"sv, "a file compressed by gzip"},
    {0, "\x1a\x45\xdf\xa3"sv, "a Matroska or WebM video"},
    {8, "AVI "sv, "an AVI video"},
    // A file that was changed as if it were text no longer begins as a PNG does.
    {0, "\x89PNG\n"sv, "a PNG image that was transferred as text, which damages it"},
    {0, "\x89PNG\r\r"sv, "a PNG image that was transferred as text, which damages it"},
    {0, "\xef\xbf\xbdPNG"sv, "a PNG image that was transferred as text, which damages it"},
    {0,
     "\xef\xbf\xbd\xef\xbf\xbd\xef\xbf\xbd"sv,
     "an image that was transferred as text, which damages it"},
    {0, "data:image/"sv, "a data URL: send the bytes it stands for"},
    {0, "/9j/"sv, "a JPEG image in base64: send the bytes it stands for"},
    {0, "iVBORw0KGgo"sv, "a PNG image in base64: send the bytes it stands for"},
};

bool BeginsWith(std::string_view bytes, size_t at, std::string_view what) {
  return bytes.size() >= at + what.size() && bytes.substr(at, what.size()) == what;
}

// SVG, HTML: text whose first mark says so, in any case, behind white space or a byte order mark.
const char* NameOfMarkup(std::string_view bytes) {
  if (BeginsWith(bytes, 0, "\xef\xbb\xbf")) bytes.remove_prefix(3);
  std::string text(bytes.substr(0, 256));
  std::transform(text.begin(), text.end(), text.begin(), [](unsigned char c) {
    return static_cast<char>(std::tolower(c));
  });
  const size_t begin = text.find_first_not_of(" \t\r\n");
  if (begin == std::string::npos || text[begin] != '<') return nullptr;
  if (text.find("<svg") != std::string::npos) return "an SVG drawing";
  if (BeginsWith(text, begin, "<!doctype html") || BeginsWith(text, begin, "<html"))
    return "a web page";
  return BeginsWith(text, begin, "<?xml") ? "an XML file" : nullptr;
}

// A raw image of a camera that looks like a TIFF: its first directory has a DNG version or the
// tags of a colour filter array.
bool IsDng(std::string_view bytes) {
  const bool little = BeginsWith(bytes, 0, "II*\0"sv);
  if (!little && !BeginsWith(bytes, 0, "MM\0*"sv)) return false;
  const auto number = [&](uint64_t at, int size) -> uint64_t {
    if (at + static_cast<uint64_t>(size) > bytes.size()) return 0;
    uint64_t value = 0;
    for (int i = 0; i < size; ++i) {
      const int k = little ? size - 1 - i : i;
      value = value << 8 | static_cast<unsigned char>(bytes[at + static_cast<uint64_t>(k)]);
    }
    return value;
  };
  constexpr uint64_t kDngVersion = 50706, kCfaPattern = 33422;
  const uint64_t directory = number(4, 4), entries = number(directory, 2);
  for (uint64_t i = 0; i < entries; ++i) {
    const uint64_t tag = number(directory + 2 + 12 * i, 2);
    if (tag == kDngVersion || tag == kCfaPattern) return true;
  }
  return false;
}

}  // namespace

std::string NameOfOtherFormat(std::string_view bytes) {
  for (const Signature& s : kSignatures) {
    if (BeginsWith(bytes, s.at, s.bytes)) return s.name;
  }
  switch (HeifKindOf(bytes)) {
    case HeifKind::kNone:
    case HeifKind::kHeic:
      break;
    case HeifKind::kAvif:
      return "an AVIF image";
    case HeifKind::kSequence:
      return "a HEIC image sequence";
    case HeifKind::kCr3:
      return "a camera's raw image (CR3)";
    case HeifKind::kOtherImage:
      return "a HEIF image that is coded neither as HEIC nor as AVIF";
    case HeifKind::kVideo:
      return "a video (MP4, MOV)";
  }
  if (IsDng(bytes)) return "a camera's raw image (DNG)";
  const char* markup = NameOfMarkup(bytes);
  return markup == nullptr ? "" : markup;
}

}  // namespace horopter
