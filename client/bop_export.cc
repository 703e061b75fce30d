#include "client/bop_export.h"

#include <filesystem>
#include <fstream>
#include <nlohmann/json.hpp>

#include "absl/strings/str_cat.h"
#include "client/isaac_grasp.h"
#include "client/units.h"
#include "server/base/status_macros.h"
#include "server/vision/geometry/grasp_kind.h"

namespace horopter {
namespace {

namespace fs = std::filesystem;
using Json = nlohmann::json;

absl::Status Write(const fs::path& path, const std::string& bytes) {
  std::error_code error;
  fs::create_directories(path.parent_path(), error);
  std::ofstream out(path, std::ios::binary);
  out.write(bytes.data(), static_cast<std::streamsize>(bytes.size()));
  out.close();
  if (!out)
    return absl::FailedPreconditionError(absl::StrCat(path.string(), ": cannot be written"));
  return absl::OkStatus();
}

// 4 x 4 row-major, translation in mm.
std::vector<double> Rigid4x4Mm(const Rigid3& t) {
  std::vector<double> values;
  for (int r = 0; r < 3; ++r) {
    for (int c = 0; c < 3; ++c) values.push_back(t.R(r, c));
    values.push_back(t.t(r) * kMmPerMetre);
  }
  values.insert(values.end(), {0.0, 0.0, 0.0, 1.0});
  return values;
}

// Binary little-endian with doubles: nothing is rounded. PLY colours vertices: with colours every
// triangle has vertices of its own, which welding joins again.
std::string AsPly(const TriangleMesh& shared) {
  TriangleMesh own;
  if (!shared.colors.empty()) {
    for (const Eigen::Vector3i& t : shared.triangles) {
      const int first = static_cast<int>(own.vertices.size());
      for (const int i : t) own.vertices.push_back(shared.vertices[i]);
      own.triangles.emplace_back(first, first + 1, first + 2);
    }
  }
  const bool colored = !shared.colors.empty();
  const TriangleMesh& mesh = colored ? own : shared;
  std::string out = absl::StrCat("ply\nformat binary_little_endian 1.0\nelement vertex ",
                                 mesh.vertices.size(),
                                 "\nproperty double x\nproperty double y\nproperty double z\n",
                                 colored ? "property uchar red\nproperty uchar green\nproperty "
                                           "uchar blue\nproperty uchar alpha\n"
                                         : "",
                                 "element face ",
                                 mesh.triangles.size(),
                                 "\nproperty list uchar int vertex_indices\nend_header\n");
  const auto append = [&](const auto& value) {
    out.append(reinterpret_cast<const char*>(&value), sizeof(value));
  };
  for (size_t i = 0; i < mesh.vertices.size(); ++i) {
    for (const double x : mesh.vertices[i]) append(x * kMmPerMetre);
    if (colored) append(shared.colors[i / 3]);
  }
  for (const Eigen::Vector3i& t : mesh.triangles) {
    append(static_cast<unsigned char>(3));
    for (const int i : t) append(static_cast<int32_t>(i));
  }
  return out;
}

}  // namespace

absl::Status WriteGrasps(const std::string& path, const std::vector<Grasp>& grasps) {
  Json list = Json::array();
  for (const Grasp& g : grasps) {
    list.push_back({{"name", g.name},
                    {"T_gripper_in_object", Rigid4x4Mm(g.object_from_gripper)},
                    {"quality", g.quality}});
    if (IsSuction(g)) {
      list.back()["suction_cup_radius_mm"] = CupRadius(g) * kMmPerMetre;
    } else {
      list.back()["jaw_opening_mm"] = g.jaw_opening_m * kMmPerMetre;
      list.back()["grip_width_mm"] = g.grip_width_m * kMmPerMetre;
    }
    if (g.object_from_pregrasp) {
      list.back()["T_pregrasp_in_object"] = Rigid4x4Mm(*g.object_from_pregrasp);
    }
  }
  return Write(path, Json{{"grasps", list}}.dump(1) + "\n");
}

absl::Status WriteBopObject(const std::string& folder, const BopExportEntry& entry) {
  const std::string stem = BopObjectName(entry.obj_id);
  HOROPTER_RETURN_IF_ERROR(Write(folder + "/models/" + stem + ".ply", AsPly(entry.model.mesh)));
  if (!entry.cad_content.empty() && !entry.cad_format.empty()) {
    HOROPTER_RETURN_IF_ERROR(
        Write(absl::StrCat(folder, "/cad/", stem, ".", entry.cad_format), entry.cad_content));
  }
  if (!entry.model.grasps.empty()) {
    const std::string grasps = folder + "/grasps/" + stem;
    HOROPTER_RETURN_IF_ERROR(WriteGrasps(grasps + ".json", entry.model.grasps));
    HOROPTER_RETURN_IF_ERROR(WriteIsaacGrasps(grasps + ".yaml", stem, entry.model.grasps));
  }
  return absl::OkStatus();
}

absl::Status WriteBopLists(const std::string& folder, const std::vector<BopExportEntry>& entries) {
  Json info = Json::object(), names = Json::object();
  for (const BopExportEntry& entry : entries) {
    Json object;
    object["diameter"] = entry.model.diameter_m * kMmPerMetre;
    const char* axes[] = {"x", "y", "z"};
    for (int d = 0; d < 3; ++d) {
      object[std::string("min_") + axes[d]] = entry.low(d) * kMmPerMetre;
      object[std::string("size_") + axes[d]] = (entry.high(d) - entry.low(d)) * kMmPerMetre;
    }
    for (const Rigid3& s : entry.model.symmetries) {
      object["symmetries_discrete"].push_back(Rigid4x4Mm(s));
    }
    info[std::to_string(entry.obj_id)] = std::move(object);
    names[std::to_string(entry.obj_id)] =
        entry.model.display_name.empty() ? entry.model.id : entry.model.display_name;
  }
  HOROPTER_RETURN_IF_ERROR(Write(folder + "/models/models_info.json", info.dump(1) + "\n"));
  return Write(folder + "/models/names.json", names.dump(1) + "\n");
}

}  // namespace horopter
