#include "client/zip_file.h"

#include <zlib.h>

#include <algorithm>
#include <cstdint>
#include <memory>
#include <vector>

#include "absl/strings/ascii.h"
#include "absl/strings/match.h"
#include "absl/strings/str_cat.h"
#include "server/base/status_macros.h"

namespace horopter {
namespace {

constexpr size_t kLargestUnpacked = size_t{1} << 30;

std::uint64_t LittleEndian(std::string_view bytes, size_t at, size_t size) {
  std::uint64_t number = 0;
  for (size_t k = size; k-- > 0;) number = number << 8 | static_cast<unsigned char>(bytes[at + k]);
  return number;
}

absl::Status BadZip(const std::string& why) {
  return absl::InvalidArgumentError(why);
}

// `size` bytes that are packed by deflate.
absl::StatusOr<std::string> Inflate(std::string_view packed, size_t size) {
  z_stream stream = {};
  if (inflateInit2(&stream, -MAX_WBITS) != Z_OK) return absl::InternalError("zlib");
  const std::unique_ptr<z_stream, decltype(&inflateEnd)> guard(&stream, &inflateEnd);
  // What is claimed is not believed before it comes: deflate packs to a thousandth at best.
  constexpr size_t kBestRatio = 1040;
  if (size / kBestRatio > packed.size()) return BadZip("a file in it is damaged");
  std::string out(size, '\0');
  stream.next_in = reinterpret_cast<Bytef*>(const_cast<char*>(packed.data()));
  stream.avail_in = static_cast<uInt>(packed.size());
  stream.next_out = reinterpret_cast<Bytef*>(out.data());
  stream.avail_out = static_cast<uInt>(size);
  if (inflate(&stream, Z_FINISH) != Z_STREAM_END || stream.avail_out != 0) {
    return BadZip("a file in it is damaged");
  }
  return out;
}

struct Entry {
  std::string name;
  std::uint64_t flags = 0, method = 0, crc = 0, packed = 0, size = 0, local = 0;
};

absl::StatusOr<std::string> Content(std::string_view bytes, const Entry& entry) {
  constexpr size_t kLocalHeader = 30;
  if ((entry.flags & 1u) != 0) return BadZip("encrypted");
  if (entry.local + kLocalHeader > bytes.size()) return BadZip("cut short");
  const size_t start = entry.local + kLocalHeader + LittleEndian(bytes, entry.local + 26, 2) +
                       LittleEndian(bytes, entry.local + 28, 2);
  if (start > bytes.size() || entry.packed > bytes.size() - start) return BadZip("cut short");
  const std::string_view packed = bytes.substr(start, entry.packed);
  std::string content;
  if (entry.method == 0) {
    content = std::string(packed);
  } else if (entry.method == Z_DEFLATED) {
    HOROPTER_ASSIGN_OR_RETURN(content, Inflate(packed, entry.size));
  } else {
    return BadZip("packed in another way than deflate");
  }
  const auto crc = crc32_z(0, reinterpret_cast<const Bytef*>(content.data()), content.size());
  if (crc != entry.crc) return BadZip("a file in it is damaged");
  return content;
}

}  // namespace

absl::StatusOr<std::map<std::string, std::string>> Unzip(std::string_view bytes,
                                                         const std::vector<std::string>& endings) {
  constexpr size_t kEnd = 22, kLongestComment = 65535, kCentral = 46;
  if (bytes.size() < kEnd) return BadZip("no archive");
  const size_t from = bytes.size() - std::min(bytes.size(), kEnd + kLongestComment);
  const size_t found = bytes.substr(from).rfind("PK\x05\x06");
  if (found == std::string_view::npos || from + found + kEnd > bytes.size()) {
    return BadZip("no archive, or cut short");
  }
  const size_t end = from + found;
  std::uint64_t count = LittleEndian(bytes, end + 10, 2);
  size_t at = LittleEndian(bytes, end + 16, 4);
  std::map<std::string, std::string> files;
  size_t total = 0;
  for (; count > 0; --count) {
    if (at > bytes.size() || bytes.size() - at < kCentral || bytes.substr(at, 4) != "PK\x01\x02") {
      return BadZip("its table of contents is damaged");
    }
    Entry entry{"",
                LittleEndian(bytes, at + 8, 2),
                LittleEndian(bytes, at + 10, 2),
                LittleEndian(bytes, at + 16, 4),
                LittleEndian(bytes, at + 20, 4),
                LittleEndian(bytes, at + 24, 4),
                LittleEndian(bytes, at + 42, 4)};
    const size_t name = LittleEndian(bytes, at + 28, 2);
    if (bytes.size() - at - kCentral < name) return BadZip("its table of contents is damaged");
    entry.name = std::string(bytes.substr(at + kCentral, name));
    at += kCentral + name + LittleEndian(bytes, at + 30, 2) + LittleEndian(bytes, at + 32, 2);
    const std::string lower = absl::AsciiStrToLower(entry.name);
    if (std::none_of(endings.begin(), endings.end(), [&](const std::string& ending) {
          return absl::EndsWith(lower, ending);
        })) {
      continue;
    }
    total += entry.size;
    if (total > kLargestUnpacked) return absl::ResourceExhaustedError("larger than 1 GB unpacked");
    HOROPTER_ASSIGN_OR_RETURN(files[entry.name], Content(bytes, entry));
  }
  return files;
}

}  // namespace horopter
