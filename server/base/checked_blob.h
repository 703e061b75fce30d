// Numbers in byte strings that are stored: a header with version, fingerprint and checksum, and a
// reader that survives whatever it is given.
//
// Byte layout of the header, little-endian, no padding: 4 bytes of magic, u16 version, u16 zero,
// u64 fingerprint of what the body was made from, u64 checksum of the body, which follows.
#pragma once

#include <bit>
#include <cstddef>
#include <cstdint>
#include <cstring>
#include <string>
#include <string_view>
#include <type_traits>

#include "absl/status/statusor.h"
#include "absl/strings/str_cat.h"

namespace horopter {

static_assert(std::endian::native == std::endian::little, "numbers are copied as they are");

inline constexpr std::size_t kBlobHeaderBytes = 24;

// 64-bit FNV-1a over 8-byte words, the last one of each Add filled with zeros.
class BlobHash {
 public:
  void Add(const void* bytes, std::size_t size) {
    const char* at = static_cast<const char*>(bytes);
    while (size > 0) {
      std::uint64_t word = 0;
      const std::size_t n = size < 8 ? size : 8;
      std::memcpy(&word, at, n);
      value_ = (value_ ^ word) * 0x100000001b3ull;
      value_ ^= value_ >> 29;  // high bits of a word must reach the low bits of the sum
      at += n;
      size -= n;
    }
  }
  template <typename T>
  void Add(const T& value) {
    static_assert(std::is_arithmetic_v<T>);
    Add(&value, sizeof(value));
  }
  std::uint64_t value() const { return value_; }

 private:
  std::uint64_t value_ = 0xcbf29ce484222325ull;
};

template <typename T>
void AppendNumber(std::string& out, T value) {
  static_assert(std::is_arithmetic_v<T>);
  out.append(reinterpret_cast<const char*>(&value), sizeof(value));
}

// Reads from the front of a blob; after the first failure everything is zero and ok() false.
class BlobReader {
 public:
  explicit BlobReader(std::string_view blob) : blob_(blob) {}

  template <typename T>
  T Take() {
    T value{};
    if (!ok_ || blob_.size() < sizeof(T)) {
      Fail();
      return value;
    }
    std::memcpy(&value, blob_.data(), sizeof(T));
    blob_.remove_prefix(sizeof(T));
    return value;
  }

  // Exactly `size` bytes; empty on failure.
  std::string_view TakeBytes(std::size_t size) {
    if (!ok_ || size > blob_.size()) {
      Fail();
      return {};
    }
    const std::string_view out = blob_.substr(0, size);
    blob_.remove_prefix(size);
    return out;
  }

  void Fail() {
    ok_ = false;
    blob_ = {};
  }
  bool ok() const { return ok_; }
  std::size_t left() const { return blob_.size(); }

 private:
  std::string_view blob_;
  bool ok_ = true;
};

// The body behind its header. magic: four bytes.
inline std::string WithBlobHeader(std::string_view magic,
                                  int version,
                                  std::uint64_t fingerprint,
                                  std::string_view body) {
  BlobHash checksum;
  checksum.Add(body.data(), body.size());
  std::string out(magic);
  AppendNumber(out, static_cast<std::uint16_t>(version));
  AppendNumber(out, std::uint16_t{0});
  AppendNumber(out, fingerprint);
  AppendNumber(out, checksum.value());
  out += body;
  return out;
}

// Checks all but the fingerprint, which it returns, and takes the header off. `what`: named in the
// errors: FAILED_PRECONDITION (another version), DATA_LOSS.
inline absl::StatusOr<std::uint64_t> TakeBlobHeader(std::string_view what,
                                                    std::string_view magic,
                                                    int version,
                                                    std::string_view* blob) {
  const auto named = [&](auto... text) { return absl::StrCat(std::string(what), ": ", text...); };
  if (blob->size() < kBlobHeaderBytes) return absl::DataLossError(named("shorter than the header"));
  BlobReader header(*blob);
  if (header.TakeBytes(4) != magic) return absl::DataLossError(named("wrong magic"));
  const auto found = header.Take<std::uint16_t>();
  header.Take<std::uint16_t>();
  const auto fingerprint = header.Take<std::uint64_t>();
  const auto checksum = header.Take<std::uint64_t>();
  if (found != version) {
    return absl::FailedPreconditionError(
        named("of version ", found, ", this program makes ", version));
  }
  blob->remove_prefix(kBlobHeaderBytes);
  BlobHash hash;
  hash.Add(blob->data(), blob->size());
  if (hash.value() != checksum) return absl::DataLossError(named("wrong checksum"));
  return fingerprint;
}

}  // namespace horopter
