#include "client/gzip.h"

#include <zlib.h>

#include <memory>

namespace horopter {

bool IsGzip(std::string_view bytes) {
  return bytes.substr(0, 2) == "\x1F\x8B";
}

absl::StatusOr<std::string> Gunzip(std::string_view bytes) {
  constexpr size_t kLargest = size_t{1} << 30, kChunk = size_t{1} << 18;
  constexpr int kGzipWindow = 15 + 16;  // the largest window, with gzip's header
  z_stream stream = {};
  if (inflateInit2(&stream, kGzipWindow) != Z_OK) return absl::InternalError("zlib");
  const std::unique_ptr<z_stream, decltype(&inflateEnd)> guard(&stream, &inflateEnd);
  stream.next_in = reinterpret_cast<Bytef*>(const_cast<char*>(bytes.data()));
  stream.avail_in = static_cast<uInt>(bytes.size());
  std::string out;
  while (true) {
    const size_t before = out.size();
    out.resize(before + kChunk);
    stream.next_out = reinterpret_cast<Bytef*>(out.data() + before);
    stream.avail_out = static_cast<uInt>(kChunk);
    const int result = inflate(&stream, Z_NO_FLUSH);
    out.resize(before + kChunk - stream.avail_out);
    if (out.size() > kLargest) return absl::ResourceExhaustedError("larger than 1 GB unpacked");
    if (result == Z_STREAM_END) {
      const std::string_view rest(reinterpret_cast<const char*>(stream.next_in), stream.avail_in);
      if (!IsGzip(rest)) return out;  // zeros and the like may follow
      if (inflateReset(&stream) != Z_OK) return absl::InternalError("zlib");
    } else if (result != Z_OK) {
      return absl::InvalidArgumentError("the gzip data is damaged or cut short");
    }
  }
}

}  // namespace horopter
