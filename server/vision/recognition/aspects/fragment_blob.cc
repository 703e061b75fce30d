#include "server/vision/recognition/aspects/fragment_blob.h"

#include <bit>
#include <cstring>
#include <type_traits>

namespace horopter {
namespace {

static_assert(std::endian::native == std::endian::little, "numbers are copied as they are");
static_assert(sizeof(AspectFragment) == 26, "fragments are written as they lie in memory");
static_assert(std::is_trivially_copyable_v<AspectFragment>);

constexpr std::string_view kMagic = "HFRG";
constexpr std::size_t kHeaderBytes = 24;

// 64-bit FNV-1a.
std::uint64_t Hash(const void* bytes, std::size_t size, std::uint64_t value) {
  const auto* at = static_cast<const unsigned char*>(bytes);
  for (std::size_t i = 0; i < size; ++i) value = (value ^ at[i]) * 0x100000001b3ull;
  return value;
}

constexpr std::uint64_t kHashStart = 0xcbf29ce484222325ull;

std::uint64_t Fingerprint(const AspectSet& set, const AspectFragmentOptions& o) {
  std::uint64_t h = kHashStart;
  for (const double v : {set.diameter_m,
                         set.distance_m,
                         set.render_px,
                         o.min_length_diameters,
                         o.max_length_diameters,
                         o.length_factor,
                         o.max_gap_diameters}) {
    h = Hash(&v, sizeof(v), h);
  }
  h = Hash(&o.per_aspect, sizeof(o.per_aspect), h);
  for (const Aspect& a : set.aspects) {
    h = Hash(a.camera_from_object.data(), 9 * sizeof(float), h);
  }
  for (const PackedAspectPoint& p : set.points) {
    h = Hash(p.data(), sizeof(p), h);
  }
  return h;
}

template <typename T>
void Append(std::string& out, T value) {
  out.append(reinterpret_cast<const char*>(&value), sizeof(value));
}

template <typename T>
T Read(std::string_view blob, std::size_t at) {
  T value;
  std::memcpy(&value, blob.data() + at, sizeof(T));
  return value;
}

}  // namespace

std::string EncodePartFragments(const PartFragments& fragments,
                                const AspectSet& set,
                                const AspectFragmentOptions& options) {
  std::string body;
  Append(body, static_cast<std::uint32_t>(fragments.edge_length.size()));
  body.append(reinterpret_cast<const char*>(fragments.edge_length.data()),
              fragments.edge_length.size() * sizeof(float));
  Append(body, static_cast<std::uint32_t>(fragments.fragments.size()));
  body.append(reinterpret_cast<const char*>(fragments.fragments.data()),
              fragments.fragments.size() * sizeof(AspectFragment));
  std::string out(kMagic);
  Append(out, static_cast<std::uint16_t>(kFragmentVersion));
  Append(out, std::uint16_t{0});
  Append(out, Fingerprint(set, options));
  Append(out, Hash(body.data(), body.size(), kHashStart));
  return out + body;
}

absl::StatusOr<PartFragments> DecodePartFragments(std::string_view blob,
                                                  const AspectSet& set,
                                                  const AspectFragmentOptions& options) {
  if (blob.size() < kHeaderBytes || blob.substr(0, 4) != kMagic) {
    return absl::DataLossError("fragments: not a blob of fragments");
  }
  if (Read<std::uint16_t>(blob, 4) != kFragmentVersion) {
    return absl::FailedPreconditionError("fragments: of another version");
  }
  if (Read<std::uint64_t>(blob, 8) != Fingerprint(set, options)) {
    return absl::FailedPreconditionError("fragments: of other aspects or options");
  }
  const std::string_view body = blob.substr(kHeaderBytes);
  if (Read<std::uint64_t>(blob, 16) != Hash(body.data(), body.size(), kHashStart)) {
    return absl::DataLossError("fragments: checksum");
  }
  PartFragments out;
  const auto aspects = body.size() >= 8 ? Read<std::uint32_t>(body, 0) : 0u;
  const std::size_t lengths = std::size_t{4} * aspects;
  if (aspects != set.aspects.size() || body.size() < 8 + lengths) {
    return absl::DataLossError("fragments: truncated");
  }
  out.edge_length.resize(aspects);
  std::memcpy(out.edge_length.data(), body.data() + 4, lengths);
  const auto count = Read<std::uint32_t>(body, 4 + lengths);
  if (body.size() != 8 + lengths + std::size_t{count} * sizeof(AspectFragment)) {
    return absl::DataLossError("fragments: truncated");
  }
  out.fragments.resize(count);
  std::memcpy(out.fragments.data(), body.data() + 8 + lengths, count * sizeof(AspectFragment));
  for (const AspectFragment& f : out.fragments) {
    if (f.aspect >= aspects) return absl::DataLossError("fragments: aspect out of range");
  }
  return out;
}

}  // namespace horopter
