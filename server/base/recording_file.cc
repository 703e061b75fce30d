#include "server/base/recording_file.h"

#include <cstdint>

namespace horopter {
namespace {

constexpr std::string_view kMagic = "HOROREC1";
constexpr size_t kNumber = 8;

void AppendNumber(uint64_t value, std::string* out) {
  for (size_t i = 0; i < kNumber; ++i) out->push_back(static_cast<char>(value >> (8 * i)));
}

uint64_t NumberAt(std::string_view bytes, size_t at) {
  uint64_t value = 0;
  for (size_t i = 0; i < kNumber; ++i) {
    value |= static_cast<uint64_t>(static_cast<unsigned char>(bytes[at + i])) << (8 * i);
  }
  return value;
}

uint64_t Fnv1a(std::string_view bytes) {
  uint64_t hash = 0xcbf29ce484222325u;
  for (const char c : bytes) {
    hash = (hash ^ static_cast<unsigned char>(c)) * 0x100000001b3u;
  }
  return hash;
}

}  // namespace

std::string EncodeRecording(const RecordingFile& recording) {
  std::string out(kMagic);
  out.reserve(recording.about.size() + recording.request.size() + recording.response.size() + 64);
  for (const std::string* part : {&recording.about, &recording.request, &recording.response}) {
    AppendNumber(part->size(), &out);
    out += *part;
  }
  AppendNumber(Fnv1a(out), &out);
  return out;
}

absl::StatusOr<RecordingFile> DecodeRecording(std::string_view bytes) {
  if (bytes.substr(0, kMagic.size()) != kMagic) {
    const bool other = bytes.substr(0, kMagic.size() - 1) == kMagic.substr(0, kMagic.size() - 1);
    return absl::InvalidArgumentError(other ? "a recording of another version" : "no recording");
  }
  const absl::Status damaged = absl::DataLossError("the recording is cut off or damaged");
  if (bytes.size() < kMagic.size() + 4 * kNumber) return damaged;
  const size_t end = bytes.size() - kNumber;
  if (NumberAt(bytes, end) != Fnv1a(bytes.substr(0, end))) return damaged;
  RecordingFile recording;
  size_t at = kMagic.size();
  for (std::string* part : {&recording.about, &recording.request, &recording.response}) {
    if (end - at < kNumber) return damaged;
    const uint64_t size = NumberAt(bytes, at);
    at += kNumber;
    if (size > end - at) return damaged;
    *part = bytes.substr(at, size);
    at += size;
  }
  if (at != end) return damaged;
  return recording;
}

}  // namespace horopter
