#include "server/vision/recognition/object/prepared_blob.h"

#include <cstdint>
#include <utility>

#include "absl/strings/str_cat.h"
#include "server/base/checked_blob.h"
#include "server/base/status_macros.h"
#include "server/vision/recognition/aspects/fragment_blob.h"

namespace horopter {
namespace {

constexpr std::string_view kMagic = "HPRE";     // first bytes of the blob
constexpr std::string_view kKeyMagic = "HKEY";  // first bytes of the keys' blob

std::uint64_t Fingerprint(const ObjectModel& model, const PrepareOptions& options) {
  BlobHash hash;
  hash.Add(options.max_samples);
  hash.Add(static_cast<int>(options.aspects));
  hash.Add(model.diameter_m);
  hash.Add(model.vertices.data(), model.vertices.size() * sizeof(Eigen::Vector3d));
  for (const ModelEdge& e : model.edges) {
    hash.Add(static_cast<int>(e.kind));
    hash.Add(e.start_vertex);
    hash.Add(e.end_vertex);
    hash.Add(e.polyline.data(), e.polyline.size() * sizeof(e.polyline[0]));
  }
  const TriangleMesh& mesh = model.mesh;
  hash.Add(mesh.vertices.data(), mesh.vertices.size() * sizeof(mesh.vertices[0]));
  hash.Add(mesh.triangles.data(), mesh.triangles.size() * sizeof(mesh.triangles[0]));
  return hash.value();
}

Eigen::Vector3d TakeVector(BlobReader& reader) {
  Eigen::Vector3d v;
  for (double& x : v) x = reader.Take<double>();
  return v;
}

void AppendVector(std::string& out, const Eigen::Vector3d& v) {
  for (const double x : v) AppendNumber(out, x);
}

void AppendNearSymmetries(std::string& out, const PreparedObject& object) {
  AppendNumber(out, static_cast<std::uint8_t>(object.sphere));
  AppendNumber(out, static_cast<std::uint32_t>(object.near_symmetries.size()));
  for (const NearSymmetry& n : object.near_symmetries) {
    AppendVector(out, n.axis.axis);
    AppendVector(out, n.axis.point);
    AppendNumber(out, static_cast<std::int32_t>(n.axis.order));
    for (const double x : {n.mismatch.largest_m, n.mismatch.mean_m, n.mismatch.area_share}) {
      AppendNumber(out, x);
    }
    AppendVector(out, n.mismatch.place);
    AppendNumber(out, n.mismatch.size_m);
  }
}

bool TakeNearSymmetries(BlobReader& reader, PreparedObject& out) {
  constexpr std::size_t kBytes = 6 * 8 + 4 + 7 * 8;  // of one near symmetry in the blob
  out.sphere = reader.Take<std::uint8_t>() != 0;
  const auto count = reader.Take<std::uint32_t>();
  if (count > reader.left() / kBytes) return false;
  out.near_symmetries.resize(count);
  for (NearSymmetry& n : out.near_symmetries) {
    n.axis.axis = TakeVector(reader);
    n.axis.point = TakeVector(reader);
    n.axis.order = reader.Take<std::int32_t>();
    n.mismatch.largest_m = reader.Take<double>();
    n.mismatch.mean_m = reader.Take<double>();
    n.mismatch.area_share = reader.Take<double>();
    n.mismatch.place = TakeVector(reader);
    n.mismatch.size_m = reader.Take<double>();
  }
  return reader.ok();
}

void AppendBytes(std::string& out, std::string_view bytes) {
  AppendNumber(out, static_cast<std::uint32_t>(bytes.size()));
  out += bytes;
}

void AppendAspects(std::string& out, const PreparedObject& object) {
  if (object.aspects == nullptr) {
    AppendBytes(out, {});
    AppendBytes(out, {});
    return;
  }
  const ModelAspects& aspects = *object.aspects;
  AppendBytes(out, EncodeObjectAspects(aspects.object, object.model));
  AppendBytes(out, EncodeModelFragments(aspects.fragments, aspects.object.aspects));
}

absl::Status TakeAspects(BlobReader& reader, PreparedObject& out) {
  const std::string_view object = reader.TakeBytes(reader.Take<std::uint32_t>());
  const std::string_view fragments = reader.TakeBytes(reader.Take<std::uint32_t>());
  if (!reader.ok()) return absl::DataLossError("derived data: aspects of a wrong size");
  if (object.empty()) return absl::OkStatus();
  auto aspects = std::make_shared<ModelAspects>();
  HOROPTER_ASSIGN_OR_RETURN(aspects->object, DecodeObjectAspects(object, out.model));
  HOROPTER_ASSIGN_OR_RETURN(aspects->fragments,
                            DecodeModelFragments(fragments, aspects->object.aspects));
  out.aspects = std::move(aspects);
  return absl::OkStatus();
}

// Takes the header off data or keys of an object, which must be of its geometry.
absl::Status TakeHeaderOf(const ObjectModel& model,
                          std::uint64_t fingerprint,
                          std::string_view magic,
                          std::string_view& blob) {
  const absl::StatusOr<std::uint64_t> found =
      TakeBlobHeader("derived data", magic, kPreparedVersion, &blob);
  const auto named = [&](const absl::Status& status) {
    return absl::Status(status.code(),
                        absl::StrCat("object ", model.id, ": ", std::string(status.message())));
  };
  if (!found.ok()) return named(found.status());
  if (*found == fingerprint) return absl::OkStatus();
  return named(absl::FailedPreconditionError("derived data of another geometry or other options"));
}

}  // namespace

PreparedBytes EncodePrepared(const PreparedObject& object, const PrepareOptions& options) {
  std::string out;
  AppendNumber(out, static_cast<std::uint32_t>(object.stable_poses.size()));
  for (const StablePose& pose : object.stable_poses) {
    for (const double x : pose.up) AppendNumber(out, x);
    AppendNumber(out, pose.height_m);
    AppendNumber(out, pose.margin_m);
    AppendNumber(out, static_cast<std::uint8_t>(pose.rolls));
  }
  AppendNearSymmetries(out, object);
  AppendAspects(out, object);
  const std::uint64_t fingerprint = Fingerprint(object.model, options);
  return {WithBlobHeader(kMagic, kPreparedVersion, fingerprint, out),
          WithBlobHeader(kKeyMagic, kPreparedVersion, fingerprint, EncodeObjectKeys(object.keys))};
}

absl::StatusOr<ObjectKeys> DecodePreparedKeys(std::string_view keys, int vertex_count) {
  HOROPTER_RETURN_IF_ERROR(
      TakeBlobHeader("derived data", kKeyMagic, kPreparedVersion, &keys).status());
  return DecodeObjectKeys(keys, vertex_count);
}

absl::StatusOr<std::shared_ptr<const PreparedObject>> RestorePrepared(
    ObjectModel model, const PreparedBytes& bytes, const PrepareOptions& options) {
  std::string_view blob = bytes.data, keys = bytes.keys;
  const std::uint64_t fingerprint = Fingerprint(model, options);
  HOROPTER_RETURN_IF_ERROR(TakeHeaderOf(model, fingerprint, kMagic, blob));
  HOROPTER_RETURN_IF_ERROR(TakeHeaderOf(model, fingerprint, kKeyMagic, keys));
  HOROPTER_ASSIGN_OR_RETURN(const std::shared_ptr<PreparedObject> object,
                            BeginPrepared(std::move(model), options));
  BlobReader reader(blob);
  const auto poses = reader.Take<std::uint32_t>();
  if (poses > reader.left() / 41) return absl::DataLossError("derived data: too many poses");
  object->stable_poses.resize(poses);
  for (StablePose& pose : object->stable_poses) {
    pose.up = TakeVector(reader);
    pose.height_m = reader.Take<double>();
    pose.margin_m = reader.Take<double>();
    pose.rolls = reader.Take<std::uint8_t>() != 0;
  }
  if (!TakeNearSymmetries(reader, *object)) {
    return absl::DataLossError("derived data: near symmetries of a wrong size");
  }
  HOROPTER_RETURN_IF_ERROR(TakeAspects(reader, *object));
  if (reader.left() > 0) return absl::DataLossError("derived data: bytes behind its end");
  HOROPTER_ASSIGN_OR_RETURN(
      object->keys, DecodeObjectKeys(keys, static_cast<int>(object->model.vertices.size())));
  return std::shared_ptr<const PreparedObject>(object);
}

}  // namespace horopter
