#include "server/vision/recognition/aspects/aspect_blob.h"

#include <algorithm>
#include <cmath>
#include <utility>

#include "absl/strings/str_cat.h"
#include "server/base/checked_blob.h"
#include "server/base/status_macros.h"

// Behind the header: mesh: diameter f64, origin 3 f32, step f32, smooth angle f64, u32 vertices,
// u32 triangles, vertices in steps of the grid 3 u16 each, triangles 3 u16 each (u32 if there are
// more than 65536 vertices); aspects: distance f64, render_px f64, u32 aspects, rotation 9 f32 by
// rows and u32 points each, then the points, 3 u16 each, to the end.
namespace horopter {
namespace {

using Eigen::Vector3f;
using Eigen::Vector3i;

constexpr std::string_view kAspectMagic = "HASP";  // first bytes of the stored format

std::uint64_t AspectFingerprint(const ObjectModel& model, const ObjectAspectOptions& options) {
  BlobHash hash;
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

bool HasLargeIndices(std::size_t vertices) {
  return vertices > 65536;
}

void AppendMesh(const RenderMesh& mesh, double smooth_angle_rad, std::string& out) {
  AppendNumber(out, mesh.diameter_m);
  for (const float x : mesh.origin) AppendNumber(out, x);
  AppendNumber(out, mesh.step_m);
  AppendNumber(out, smooth_angle_rad);
  AppendNumber(out, static_cast<std::uint32_t>(mesh.vertices.size()));
  AppendNumber(out, static_cast<std::uint32_t>(mesh.triangles.size()));
  for (const Vector3f& p : mesh.vertices) {
    for (int k = 0; k < 3; ++k) {
      const double steps = (static_cast<double>(p[k]) - mesh.origin[k]) / mesh.step_m;
      AppendNumber(out, static_cast<std::uint16_t>(std::lround(steps)));
    }
  }
  const bool large = HasLargeIndices(mesh.vertices.size());
  for (const Vector3i& t : mesh.triangles) {
    for (const int v : t) {
      if (large) {
        AppendNumber(out, static_cast<std::uint32_t>(v));
      } else {
        AppendNumber(out, static_cast<std::uint16_t>(v));
      }
    }
  }
}

bool TakeMesh(BlobReader& reader, RenderMesh* mesh) {
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
  AppendNumber(out, set.distance_m);
  AppendNumber(out, set.render_px);
  AppendNumber(out, static_cast<std::uint32_t>(set.aspects.size()));
  for (const Aspect& a : set.aspects) {
    for (int row = 0; row < 3; ++row) {
      for (int column = 0; column < 3; ++column)
        AppendNumber(out, a.camera_from_object(row, column));
    }
    AppendNumber(out, a.point_count);
  }
  for (const PackedAspectPoint& p : set.points) {
    for (const std::uint16_t word : p) AppendNumber(out, word);
  }
}

bool TakeAspects(BlobReader& reader, const RenderMesh& mesh, AspectSet* set) {
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
  return WithBlobHeader(kAspectMagic, kAspectVersion, AspectFingerprint(model, options), body);
}

absl::StatusOr<ObjectAspects> DecodeObjectAspects(std::string_view blob,
                                                  const ObjectModel& model,
                                                  const ObjectAspectOptions& options) {
  HOROPTER_ASSIGN_OR_RETURN(const std::uint64_t fingerprint,
                            TakeBlobHeader("aspects", kAspectMagic, kAspectVersion, &blob));
  if (fingerprint != AspectFingerprint(model, options)) {
    return absl::FailedPreconditionError(
        absl::StrCat("object ", model.id, ": aspects of another geometry or other options"));
  }
  ObjectAspects out;
  BlobReader reader(blob);
  if (!TakeMesh(reader, &out.mesh)) return absl::DataLossError("aspects: damaged mesh");
  if (!TakeAspects(reader, out.mesh, &out.aspects)) {
    return absl::DataLossError("aspects: damaged views");
  }
  return out;
}

}  // namespace horopter
