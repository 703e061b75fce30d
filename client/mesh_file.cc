#include "client/mesh_file.h"

#include <filesystem>
#include <fstream>
#include <system_error>

#include "absl/strings/ascii.h"
#include "absl/strings/str_cat.h"
#include "client/glb_file.h"
#include "client/obj_file.h"
#include "client/ply_file.h"
#include "client/stl_file.h"
#include "client/threemf_file.h"
#include "server/base/status_macros.h"

namespace horopter {
namespace {

constexpr std::uintmax_t kMaxBytes = std::uintmax_t{2} << 30;

absl::StatusOr<MeshFile> Parse(const std::filesystem::path& path, const std::string& bytes) {
  const std::string extension = absl::AsciiStrToLower(path.extension().string());
  if (extension == ".ply") return ParsePly(bytes);
  if (extension == ".stl") return ParseStl(bytes);
  if (extension == ".glb") return ParseGlb(bytes);
  if (extension == ".3mf") return ParseThreeMf(bytes);
  return ParseObj(bytes, [&](const std::string& name) {
    const auto text = ReadBytes((path.parent_path() / name).string());
    return text.ok() ? *text : std::string();
  });
}

}  // namespace

absl::StatusOr<std::string> ReadBytes(const std::string& path) {
  std::error_code error;
  std::ifstream file(path, std::ios::binary);
  if (!file || !std::filesystem::is_regular_file(path, error)) {
    return absl::NotFoundError(absl::StrCat(path, ": cannot be opened"));
  }
  const std::uintmax_t size = std::filesystem::file_size(path, error);
  if (error || size > kMaxBytes) {
    return absl::ResourceExhaustedError(absl::StrCat(path, ": larger than 2 GB"));
  }
  std::string bytes(size, '\0');
  file.read(bytes.data(), static_cast<std::streamsize>(size));
  bytes.resize(static_cast<size_t>(file.gcount()));
  return bytes;
}

absl::StatusOr<MeshFile> ReadMeshFile(const std::string& path) {
  HOROPTER_ASSIGN_OR_RETURN(const std::string bytes, ReadBytes(path));
  absl::StatusOr<MeshFile> file = Parse(path, bytes);
  if (file.ok()) return file;
  return absl::Status(file.status().code(),
                      absl::StrCat(path, ": ", std::string(file.status().message())));
}

absl::Status CheckCorners(const TriangleMesh& mesh) {
  for (const Eigen::Vector3i& t : mesh.triangles) {
    for (const int k : t) {
      if (mesh.vertices[static_cast<size_t>(k)].allFinite()) continue;
      return absl::InvalidArgumentError(
          absl::StrCat("vertex ", k, " of a face has a coordinate that is not finite"));
    }
  }
  return absl::OkStatus();
}

}  // namespace horopter
