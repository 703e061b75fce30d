#include "server/vision/recognition/aspects/fragment_blob.h"

#include <cstring>
#include <type_traits>

#include "server/base/checked_blob.h"
#include "server/base/status_macros.h"

namespace horopter {
namespace {

static_assert(sizeof(AspectFragment) == 26, "fragments are written as they lie in memory");
static_assert(std::is_trivially_copyable_v<AspectFragment>);

constexpr std::string_view kFragmentMagic = "HFRG";  // first bytes of the stored format

std::uint64_t FragmentFingerprint(const AspectSet& set) {
  BlobHash hash;
  for (const double v : {set.diameter_m, set.distance_m, set.render_px}) hash.Add(v);
  for (const Aspect& a : set.aspects) {
    hash.Add(a.camera_from_object.data(), 9 * sizeof(float));
  }
  hash.Add(set.points.data(), set.points.size() * sizeof(PackedAspectPoint));
  return hash.value();
}

}  // namespace

std::string EncodeModelFragments(const ModelFragments& fragments, const AspectSet& set) {
  std::string body;
  AppendNumber(body, static_cast<std::uint32_t>(fragments.edge_length.size()));
  body.append(reinterpret_cast<const char*>(fragments.edge_length.data()),
              fragments.edge_length.size() * sizeof(float));
  AppendNumber(body, static_cast<std::uint32_t>(fragments.fragments.size()));
  body.append(reinterpret_cast<const char*>(fragments.fragments.data()),
              fragments.fragments.size() * sizeof(AspectFragment));
  AppendNumber(body, static_cast<std::uint32_t>(fragments.pairs.size()));
  body.append(reinterpret_cast<const char*>(fragments.pairs.data()),
              fragments.pairs.size() * sizeof(AspectSegmentPair));
  return WithBlobHeader(kFragmentMagic, kFragmentVersion, FragmentFingerprint(set), body);
}

absl::StatusOr<ModelFragments> DecodeModelFragments(std::string_view blob, const AspectSet& set) {
  HOROPTER_ASSIGN_OR_RETURN(const std::uint64_t fingerprint,
                            TakeBlobHeader("fragments", kFragmentMagic, kFragmentVersion, &blob));
  if (fingerprint != FragmentFingerprint(set))
    return absl::FailedPreconditionError("fragments: of other aspects");
  BlobReader reader(blob);
  ModelFragments out;
  const auto aspects = reader.Take<std::uint32_t>();
  if (!reader.ok() || aspects != set.aspects.size())
    return absl::DataLossError("fragments: of another number of aspects");
  out.edge_length.resize(aspects);
  const std::string_view lengths = reader.TakeBytes(aspects * sizeof(float));
  if (!lengths.empty()) std::memcpy(out.edge_length.data(), lengths.data(), lengths.size());
  const auto count = reader.Take<std::uint32_t>();
  if (!reader.ok() || reader.left() < std::size_t{count} * sizeof(AspectFragment))
    return absl::DataLossError("fragments: truncated");
  out.fragments.resize(count);
  const std::string_view fragments = reader.TakeBytes(std::size_t{count} * sizeof(AspectFragment));
  if (!fragments.empty()) std::memcpy(out.fragments.data(), fragments.data(), fragments.size());
  for (const AspectFragment& f : out.fragments) {
    if (f.aspect >= aspects) return absl::DataLossError("fragments: aspect out of range");
  }
  const auto pairs = reader.Take<std::uint32_t>();
  if (!reader.ok() || reader.left() != std::size_t{pairs} * sizeof(AspectSegmentPair))
    return absl::DataLossError("fragments: truncated");
  out.pairs.resize(pairs);
  const std::string_view bytes = reader.TakeBytes(reader.left());
  if (!bytes.empty()) std::memcpy(out.pairs.data(), bytes.data(), bytes.size());
  for (const AspectSegmentPair& p : out.pairs) {
    if (p.aspect >= aspects) return absl::DataLossError("fragments: aspect out of range");
  }
  return out;
}

}  // namespace horopter
