#include "db/blob.h"

#include <bit>
#include <cstdint>
#include <cstring>

#include "absl/strings/str_cat.h"
#include "server/base/status_macros.h"

namespace horopter {
namespace {

static_assert(std::endian::native == std::endian::little, "blobs are copied as they are in memory");
static_assert(sizeof(Eigen::Vector3d) == 24 && sizeof(Eigen::Vector3i) == 12 && sizeof(Rgba) == 4);
static_assert(sizeof(PrintPlace) == 28);

constexpr std::string_view kPolylineMagic = "HPOL";
constexpr std::string_view kMeshMagic = "HMSH";
constexpr std::string_view kPrintMagic = "HPRI";
constexpr uint16_t kVersion = 1;
constexpr uint16_t kColoredMesh = 2;

template <typename T>
void Append(std::string& out, T value) {
  out.append(reinterpret_cast<const char*>(&value), sizeof(value));
}

template <typename V>
void AppendVectors(std::string& out, const std::vector<V>& values) {
  if (values.empty()) return;
  out.append(reinterpret_cast<const char*>(values.data()), values.size() * sizeof(V));
}

void AppendHeader(std::string& out, std::string_view magic, uint16_t version = kVersion) {
  out.append(magic);
  Append(out, version);
  Append(out, uint16_t{0});
}

absl::Status DataLoss(std::string_view magic, std::string_view what) {
  return absl::DataLossError(
      absl::StrCat("stored ", std::string(magic), " blob: ", std::string(what)));
}

struct Header {
  uint16_t version = 0;
  std::vector<uint32_t> sizes;
};

// Takes magic, version (1..newest) and `count` 32-bit sizes off the front of the blob.
absl::StatusOr<Header> TakeHeader(std::string_view& blob,
                                  std::string_view magic,
                                  int count,
                                  uint16_t newest = kVersion) {
  const size_t size = 8 + 4 * static_cast<size_t>(count);
  if (blob.size() < size) return DataLoss(magic, "shorter than its header");
  if (blob.substr(0, 4) != magic) return DataLoss(magic, "wrong magic");
  Header header;
  std::memcpy(&header.version, blob.data() + 4, sizeof(header.version));
  if (header.version < 1 || header.version > newest) {
    return DataLoss(magic, "unknown version " + std::to_string(header.version));
  }
  header.sizes.resize(count);
  std::memcpy(header.sizes.data(), blob.data() + 8, header.sizes.size() * 4);
  blob.remove_prefix(size);
  return header;
}

// The caller has checked that the blob is long enough.
template <typename V>
std::vector<V> TakeVectors(std::string_view& blob, uint32_t count) {
  std::vector<V> values(count);
  const size_t size = count * sizeof(V);
  if (size > 0) std::memcpy(static_cast<void*>(values.data()), blob.data(), size);
  blob.remove_prefix(size);
  return values;
}

}  // namespace

std::string EncodePolyline(const std::vector<Eigen::Vector3d>& points) {
  std::string out;
  AppendHeader(out, kPolylineMagic);
  Append(out, static_cast<uint32_t>(points.size()));
  AppendVectors(out, points);
  return out;
}

std::string EncodeMesh(const TriangleMesh& mesh) {
  std::string out;
  const bool colored = !mesh.colors.empty();
  AppendHeader(out, kMeshMagic, colored ? kColoredMesh : kVersion);
  Append(out, static_cast<uint32_t>(mesh.vertices.size()));
  Append(out, static_cast<uint32_t>(mesh.triangles.size()));
  AppendVectors(out, mesh.vertices);
  AppendVectors(out, mesh.triangles);
  AppendVectors(out, mesh.colors);
  return out;
}

std::string EncodePrint(const SurfacePrint& print) {
  std::string out;
  AppendHeader(out, kPrintMagic);
  Append(out, static_cast<uint32_t>(print.places.size()));
  Append(out, static_cast<uint32_t>(print.views));
  AppendVectors(out, print.places);
  return out;
}

absl::StatusOr<std::vector<Eigen::Vector3d>> DecodePolyline(std::string_view blob) {
  HOROPTER_ASSIGN_OR_RETURN(const Header header, TakeHeader(blob, kPolylineMagic, 1));
  const uint32_t count = header.sizes[0];
  if (blob.size() != uint64_t{count} * 24) return DataLoss(kPolylineMagic, "wrong size");
  return TakeVectors<Eigen::Vector3d>(blob, count);
}

absl::StatusOr<TriangleMesh> DecodeMesh(std::string_view blob) {
  HOROPTER_ASSIGN_OR_RETURN(const Header header, TakeHeader(blob, kMeshMagic, 2, kColoredMesh));
  const std::vector<uint32_t>& sizes = header.sizes;
  const bool colored = header.version == kColoredMesh;
  if (blob.size() != uint64_t{sizes[0]} * 24 + uint64_t{sizes[1]} * (colored ? 16 : 12)) {
    return DataLoss(kMeshMagic, "wrong size");
  }
  TriangleMesh mesh;
  mesh.vertices = TakeVectors<Eigen::Vector3d>(blob, sizes[0]);
  mesh.triangles = TakeVectors<Eigen::Vector3i>(blob, sizes[1]);
  if (colored) mesh.colors = TakeVectors<Rgba>(blob, sizes[1]);
  return mesh;
}

absl::StatusOr<SurfacePrint> DecodePrint(std::string_view blob) {
  HOROPTER_ASSIGN_OR_RETURN(const Header header, TakeHeader(blob, kPrintMagic, 2));
  const uint32_t count = header.sizes[0];
  if (blob.size() != uint64_t{count} * sizeof(PrintPlace))
    return DataLoss(kPrintMagic, "wrong size");
  SurfacePrint print;
  print.views = static_cast<int>(header.sizes[1]);
  print.places = TakeVectors<PrintPlace>(blob, count);
  return print;
}

}  // namespace horopter
