#include "server/vision/recognition/aspects/aspect_blob.h"

#include <algorithm>
#include <bit>
#include <cmath>
#include <cstring>
#include <type_traits>
#include <utility>

#include "absl/strings/str_cat.h"
#include "server/base/status_macros.h"

// Behind the header: mesh: diameter f64, origin 3 f32, step f32, smooth angle f64, u32 vertices,
// u32 triangles, vertices in steps of the grid 3 u16 each, triangles 3 u16 each (u32 if there are
// more than 65536 vertices); aspects: distance f64, render_px f64, u32 aspects, rotation 9 f32 by
// rows and u32 points each, then the points, 3 u16 each, to the end.
namespace horopter {
namespace {

static_assert(std::endian::native == std::endian::little, "numbers are copied as they are");

using Eigen::Vector3f;
using Eigen::Vector3i;

constexpr std::string_view kMagic = "HASP";
constexpr std::size_t kHeaderBytes = 24;

// 64-bit FNV-1a over 8-byte words, the last one filled with zeros.
class Hash {
 public:
  void Add(const void* bytes, std::size_t size) {
    const char* at = static_cast<const char*>(bytes);
    while (size > 0) {
      std::uint64_t word = 0;
      const std::size_t n = std::min<std::size_t>(size, 8);
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

std::uint64_t Fingerprint(const ObjectModel& model, const ObjectAspectOptions& options) {
  Hash hash;
  hash.Add(options.mesh.tolerance);
  hash.Add(options.mesh.max_triangles);
  hash.Add(options.mesh.coarse_tolerance);
  hash.Add(options.mesh.smooth_angle_rad);
  hash.Add(options.aspects.directions);
  hash.Add(options.aspects.distance_diameters);
  hash.Add(options.aspects.render_px);
  hash.Add(options.aspects.max_points);
  hash.Add(options.aspects.spread_points);
  hash.Add(model.diameter_m);
  for (const Rigid3& s : model.symmetries) {
    hash.Add(s.R.data(), 9 * sizeof(double));
    hash.Add(s.t.data(), 3 * sizeof(double));
  }
  const TriangleMesh& mesh = model.mesh;
  hash.Add(mesh.vertices.data(), mesh.vertices.size() * sizeof(mesh.vertices[0]));
  hash.Add(mesh.triangles.data(), mesh.triangles.size() * sizeof(mesh.triangles[0]));
  return hash.value();
}

template <typename T>
void Append(std::string& out, T value) {
  static_assert(std::is_arithmetic_v<T>);
  out.append(reinterpret_cast<const char*>(&value), sizeof(value));
}

// Reads from the front of a blob; after the first failure everything is zero and ok() false.
class ByteReader {
 public:
  explicit ByteReader(std::string_view blob) : blob_(blob) {}

  template <typename T>
  T Take() {
    T value{};
    if (blob_.size() < sizeof(T)) {
      ok_ = false;
      blob_ = {};
      return value;
    }
    std::memcpy(&value, blob_.data(), sizeof(T));
    blob_.remove_prefix(sizeof(T));
    return value;
  }
  bool ok() const { return ok_; }
  std::size_t left() const { return blob_.size(); }

 private:
  std::string_view blob_;
  bool ok_ = true;
};

bool HasLargeIndices(std::size_t vertices) {
  return vertices > 65536;
}

void AppendMesh(const RenderMesh& mesh, double smooth_angle_rad, std::string& out) {
  Append(out, mesh.diameter_m);
  for (const float x : mesh.origin) Append(out, x);
  Append(out, mesh.step_m);
  Append(out, smooth_angle_rad);
  Append(out, static_cast<std::uint32_t>(mesh.vertices.size()));
  Append(out, static_cast<std::uint32_t>(mesh.triangles.size()));
  for (const Vector3f& p : mesh.vertices) {
    for (int k = 0; k < 3; ++k) {
      const double steps = (static_cast<double>(p[k]) - mesh.origin[k]) / mesh.step_m;
      Append(out, static_cast<std::uint16_t>(std::lround(steps)));
    }
  }
  const bool large = HasLargeIndices(mesh.vertices.size());
  for (const Vector3i& t : mesh.triangles) {
    for (const int v : t) {
      if (large) {
        Append(out, static_cast<std::uint32_t>(v));
      } else {
        Append(out, static_cast<std::uint16_t>(v));
      }
    }
  }
}

bool TakeMesh(ByteReader& reader, RenderMesh* mesh) {
  mesh->diameter_m = reader.Take<double>();
  for (float& x : mesh->origin) x = reader.Take<float>();
  mesh->step_m = reader.Take<float>();
  const double smooth_angle_rad = reader.Take<double>();
  const auto vertices = reader.Take<std::uint32_t>();
  const auto triangles = reader.Take<std::uint32_t>();
  if (!reader.ok() || vertices == 0 || vertices > reader.left() / 6 || !(mesh->diameter_m > 0.0)) {
    return false;
  }
  mesh->vertices.resize(vertices);
  for (Vector3f& p : mesh->vertices) {
    Vector3f steps;
    for (float& x : steps) x = static_cast<float>(reader.Take<std::uint16_t>());
    p = GridPoint(*mesh, steps);
  }
  const bool large = HasLargeIndices(vertices);
  if (triangles > reader.left() / (large ? 12 : 6)) return false;
  mesh->triangles.resize(triangles);
  for (Vector3i& t : mesh->triangles) {
    for (int& v : t) {
      const std::uint32_t index =
          large ? reader.Take<std::uint32_t>() : reader.Take<std::uint16_t>();
      if (index >= vertices) return false;
      v = static_cast<int>(index);
    }
  }
  ConnectRenderMesh(smooth_angle_rad, mesh);
  return reader.ok();
}

void AppendAspects(const AspectSet& set, std::string& out) {
  Append(out, set.distance_m);
  Append(out, set.render_px);
  Append(out, static_cast<std::uint32_t>(set.aspects.size()));
  for (const Aspect& a : set.aspects) {
    for (int row = 0; row < 3; ++row) {
      for (int column = 0; column < 3; ++column) Append(out, a.camera_from_object(row, column));
    }
    Append(out, a.point_count);
  }
  for (const PackedAspectPoint& p : set.points) {
    for (const std::uint16_t word : p) Append(out, word);
  }
}

bool TakeAspects(ByteReader& reader, const RenderMesh& mesh, AspectSet* set) {
  set->diameter_m = mesh.diameter_m;
  set->center = mesh.center;
  set->distance_m = reader.Take<double>();
  set->render_px = reader.Take<double>();
  const auto count = reader.Take<std::uint32_t>();
  if (!reader.ok() || count > reader.left() / 40) return false;
  set->aspects.resize(count);
  std::uint64_t points = 0;
  for (Aspect& a : set->aspects) {
    for (int row = 0; row < 3; ++row) {
      for (int column = 0; column < 3; ++column) {
        a.camera_from_object(row, column) = reader.Take<float>();
      }
    }
    a.first_point = static_cast<std::uint32_t>(points);
    a.point_count = reader.Take<std::uint32_t>();
    points += a.point_count;
  }
  if (!reader.ok() || points * 6 != reader.left()) return false;
  set->points.resize(points);
  for (PackedAspectPoint& p : set->points) {
    for (std::uint16_t& word : p) word = reader.Take<std::uint16_t>();
  }
  return reader.ok();
}

}  // namespace

absl::StatusOr<ObjectAspects> MakeObjectAspects(const ObjectModel& model,
                                                const ObjectAspectOptions& options) {
  ObjectAspects out;
  HOROPTER_ASSIGN_OR_RETURN(out.mesh, MakeRenderMesh(model.mesh, model.diameter_m, options.mesh));
  out.aspects = MakeAspects(out.mesh, model.symmetries, options.aspects);
  return out;
}

std::string EncodeObjectAspects(const ObjectAspects& object,
                                const ObjectModel& model,
                                const ObjectAspectOptions& options) {
  std::string body;
  AppendMesh(object.mesh, options.mesh.smooth_angle_rad, body);
  AppendAspects(object.aspects, body);
  Hash checksum;
  checksum.Add(body.data(), body.size());
  std::string out(kMagic);
  Append(out, static_cast<std::uint16_t>(kAspectVersion));
  Append(out, std::uint16_t{0});
  Append(out, Fingerprint(model, options));
  Append(out, checksum.value());
  return out + body;
}

absl::StatusOr<ObjectAspects> DecodeObjectAspects(std::string_view blob,
                                                  const ObjectModel& model,
                                                  const ObjectAspectOptions& options) {
  if (blob.size() < kHeaderBytes) return absl::DataLossError("aspects: shorter than their header");
  if (blob.substr(0, 4) != kMagic) return absl::DataLossError("aspects: wrong magic");
  ByteReader header(blob.substr(4));
  const auto version = header.Take<std::uint16_t>();
  header.Take<std::uint16_t>();
  const auto fingerprint = header.Take<std::uint64_t>();
  const auto checksum = header.Take<std::uint64_t>();
  if (version != kAspectVersion) {
    return absl::FailedPreconditionError(
        absl::StrCat("aspects of version ", version, ", this program makes ", kAspectVersion));
  }
  blob.remove_prefix(kHeaderBytes);
  Hash hash;
  hash.Add(blob.data(), blob.size());
  if (hash.value() != checksum) return absl::DataLossError("aspects: wrong checksum");
  if (fingerprint != Fingerprint(model, options)) {
    return absl::FailedPreconditionError(
        absl::StrCat("object ", model.id, ": aspects of another geometry or other options"));
  }
  ObjectAspects out;
  ByteReader reader(blob);
  if (!TakeMesh(reader, &out.mesh)) return absl::DataLossError("aspects: damaged mesh");
  if (!TakeAspects(reader, out.mesh, &out.aspects)) {
    return absl::DataLossError("aspects: damaged views");
  }
  return out;
}

}  // namespace horopter
