#include "client/bop_dataset.h"

#include <Eigen/Geometry>
#include <Eigen/SVD>
#include <algorithm>
#include <cmath>
#include <filesystem>
#include <map>
#include <nlohmann/json.hpp>
#include <optional>
#include <stdexcept>

#include "absl/strings/ascii.h"
#include "absl/strings/str_cat.h"
#include "absl/strings/str_format.h"
#include "client/bop_json.h"
#include "client/isaac_grasp.h"
#include "server/base/status_macros.h"
#include "server/vision/geometry/grasp_kind.h"

namespace horopter {
namespace {

namespace fs = std::filesystem;
using Json = nlohmann::json;
using bop::ExistingFile;
using bop::Guarded;
using bop::IdOf;
using bop::Numbers;
using bop::ReadJson;

constexpr double kRigid = 1e-3;    // of a number of R R^T from the identity's
constexpr double kLastRow = 1e-6;  // of its numbers from 0 0 0 1

// Whether R is the nearest rotation, rounded to two or three digits behind the point: grasps are
// written by hand and by tools that round. One number that is off by a digit is no rounding.
bool IsRounded(const Eigen::Matrix3d& R, const Eigen::Matrix3d& nearest) {
  constexpr double kMost = 0.495;  // of the last digit
  for (const double unit : {0.01, 0.001}) {
    const Eigen::Matrix3d whole = R / unit;
    if ((whole - whole.array().round().matrix()).cwiseAbs().maxCoeff() > 1e-6) continue;
    return (R - nearest).cwiseAbs().maxCoeff() <= kMost * unit;
  }
  return false;
}

Rigid3 Rigid4x4FromMm(const Json& value, const std::string& what) {
  const std::vector<double> n = Numbers(value, 16, what);
  const Eigen::Matrix4d m =
      Eigen::Map<const Eigen::Matrix<double, 4, 4, Eigen::RowMajor>>(n.data());
  const Eigen::Vector4d last(0.0, 0.0, 0.0, 1.0);
  if ((m.row(3).transpose() - last).cwiseAbs().maxCoeff() > kLastRow) {
    const bool rows = (m.col(3) - last).cwiseAbs().maxCoeff() <= kLastRow;
    throw std::runtime_error(absl::StrCat(
        what, ": the last row is not 0 0 0 1", rows ? ": row vectors? transpose it" : ""));
  }
  const Eigen::Matrix3d R = m.topLeftCorner<3, 3>();
  const Eigen::JacobiSVD<Eigen::Matrix3d> svd(R, Eigen::ComputeFullU | Eigen::ComputeFullV);
  const Eigen::Matrix3d nearest = svd.matrixU() * svd.matrixV().transpose();
  if (R.determinant() < 0.0)
    throw std::runtime_error(absl::StrCat(what, " is not a rigid transform but a mirror image"));
  const double off = (R * R.transpose() - Eigen::Matrix3d::Identity()).cwiseAbs().maxCoeff();
  if (off > kRigid && !IsRounded(R, nearest)) {
    throw std::runtime_error(
        absl::StrCat(what, " is not a rigid transform: its rotation is off orthonormal by ", off));
  }
  return {nearest, kMetresPerMm * m.topRightCorner<3, 1>()};
}

// Discrete symmetries times discretised continuous ones, as BOP's evaluation does.
std::vector<Rigid3> Symmetries(const Json& info) {
  constexpr int kContinuousSteps = 36;
  std::vector<Rigid3> discrete{Rigid3{}}, continuous{Rigid3{}};
  if (info.contains("symmetries_discrete")) {
    for (const Json& s : info["symmetries_discrete"]) {
      discrete.push_back(Rigid4x4FromMm(s, "symmetries_discrete"));
    }
  }
  if (info.contains("symmetries_continuous") && !info["symmetries_continuous"].empty()) {
    continuous.clear();
    for (const Json& s : info["symmetries_continuous"]) {
      const auto a = Numbers(s.at("axis"), 3, "symmetries_continuous.axis");
      Eigen::Vector3d offset = Eigen::Vector3d::Zero();
      if (s.contains("offset")) {
        const auto o = Numbers(s["offset"], 3, "symmetries_continuous.offset");
        offset = kMetresPerMm * Eigen::Vector3d(o[0], o[1], o[2]);
      }
      const Eigen::Vector3d axis = Eigen::Vector3d(a[0], a[1], a[2]).normalized();
      if (!(axis.norm() > 0.5))
        throw std::runtime_error("symmetries_continuous.axis is no direction");
      for (int k = 0; k < kContinuousSteps; ++k) {
        const Eigen::Matrix3d R =
            Eigen::AngleAxisd(2.0 * M_PI * k / kContinuousSteps, axis).toRotationMatrix();
        continuous.push_back({R, offset - R * offset});
      }
    }
  }
  std::vector<Rigid3> all;
  for (const Rigid3& d : discrete) {
    for (const Rigid3& c : continuous) all.push_back(d * c);
  }
  all.erase(all.begin());  // both lists begin with the identity
  return all;
}

// The folders with models of a dataset, the best ones first.
std::vector<std::string> ModelFolders(const std::string& dataset) {
  std::vector<std::string> names = {"models", "models_cad", "models_reconst"};
  std::error_code error;
  for (const fs::path& path : bop::SortedEntries(dataset)) {
    const std::string name = path.filename().string();
    const bool resampled = name.ends_with("_eval");  // for errors, not for appearance
    if (name.starts_with("models_") && !resampled) names.push_back(name);
  }
  for (const fs::path& path : bop::SortedEntries(dataset)) {
    const std::string name = path.filename().string();
    if (name.starts_with("models_") && name.ends_with("_eval")) names.push_back(name);
  }
  std::vector<std::string> folders;
  for (const std::string& name : names) {
    const std::string folder = (fs::path(dataset) / name).string();
    const bool again = std::find(folders.begin(), folders.end(), folder) != folders.end();
    if (!again && fs::is_directory(folder, error)) folders.push_back(folder);
  }
  return folders;
}

// Files obj_NUMBER of a folder by number: the earlier extension wins, what is in `files` stays.
void FindFiles(const std::string& folder,
               const std::vector<std::string>& extensions,
               std::map<int, std::string>* files) {
  const std::vector<fs::path> paths = bop::SortedEntries(folder);
  for (const std::string& extension : extensions) {
    for (const fs::path& path : paths) {
      if (absl::AsciiStrToLower(path.extension().string()) != extension) continue;
      if (const auto id = IdOf(path, "obj_")) files->emplace(*id, path.string());
    }
  }
}

std::string PathOf(const std::map<int, std::string>& files, int id) {
  const auto it = files.find(id);
  return it == files.end() ? "" : it->second;
}

absl::Status ReadModelsInfo(const std::string& path, std::map<int, BopObject>& objects) {
  HOROPTER_ASSIGN_OR_RETURN(const Json info, ReadJson(path));
  return Guarded(path, [&] {
    for (const auto& [key, value] : info.items()) {
      BopObject& object = objects[std::stoi(key)];
      object.in_models_info = true;
      object.diameter_m = kMetresPerMm * value.at("diameter").get<double>();
      object.symmetries = Symmetries(value);
    }
    return absl::OkStatus();
  });
}

}  // namespace

const BopObject* BopDataset::Find(int obj_id) const {
  const auto it = std::find_if(
      objects.begin(), objects.end(), [&](const BopObject& o) { return o.obj_id == obj_id; });
  return it == objects.end() ? nullptr : &*it;
}

std::string BopObjectName(int obj_id) {
  return absl::StrFormat("obj_%06d", obj_id);
}

absl::StatusOr<BopDataset> ReadBopDataset(const std::string& folder) {
  std::error_code error;
  if (!fs::is_directory(folder, error)) {
    return absl::NotFoundError(absl::StrCat(folder, ": no such folder"));
  }
  const std::vector<std::string> models = ModelFolders(folder);
  std::map<int, std::string> cads, meshes, grasps;
  FindFiles(folder + "/cad", {".step", ".stp"}, &cads);
  for (const std::string& sub : models) FindFiles(sub, {".ply", ".obj", ".stl"}, &meshes);
  FindFiles(folder + "/grasps", {".json"}, &grasps);
  if (cads.empty() && meshes.empty()) {
    return absl::NotFoundError(
        absl::StrCat(folder, ": neither cad/obj_*.step nor models/obj_*.ply there"));
  }
  std::map<int, BopObject> objects;
  for (const auto* files : {&cads, &meshes}) {
    for (const auto& [id, path] : *files) objects[id];
  }
  for (const std::string& sub : models) {
    const std::string info = sub + "/models_info.json";
    if (ExistingFile({info}).empty()) continue;
    std::map<int, BopObject> known;
    HOROPTER_RETURN_IF_ERROR(ReadModelsInfo(info, known));
    for (auto& [id, object] : objects) {
      const auto it = known.find(id);
      if (it != known.end() && !object.in_models_info) object = it->second;
    }
  }
  Json names;
  const std::string names_path =
      ExistingFile({folder + "/models/names.json", folder + "/names.json"});
  if (!names_path.empty()) {
    HOROPTER_ASSIGN_OR_RETURN(names, ReadJson(names_path));
  }
  BopDataset dataset;
  dataset.folder = folder;
  for (auto& [id, object] : objects) {
    object.obj_id = id;
    object.cad_path = PathOf(cads, id);
    object.mesh_path = PathOf(meshes, id);
    object.grasps_path = PathOf(grasps, id);
    if (names.is_object() && names.contains(std::to_string(id)) &&
        names[std::to_string(id)].is_string()) {
      object.name = names[std::to_string(id)].get<std::string>();
    }
    dataset.objects.push_back(std::move(object));
  }
  return dataset;
}

absl::StatusOr<std::vector<Grasp>> ReadGrasps(const std::string& path) {
  const std::string extension = fs::path(path).extension().string();
  if (extension == ".yaml" || extension == ".yml") return ReadIsaacGrasps(path);
  HOROPTER_ASSIGN_OR_RETURN(const Json file, ReadJson(path));
  std::vector<Grasp> grasps;
  HOROPTER_RETURN_IF_ERROR(Guarded(path, [&] {
    for (const Json& value : file.at("grasps")) {
      Grasp grasp;
      grasp.name = value.at("name").get<std::string>();
      grasp.object_from_gripper =
          Rigid4x4FromMm(value.at("T_gripper_in_object"), grasp.name + ".T_gripper_in_object");
      grasp.jaw_opening_m = kMetresPerMm * value.value("jaw_opening_mm", 0.0);
      grasp.grip_width_m = kMetresPerMm * value.value("grip_width_mm", 0.0);
      if (value.contains("suction_cup_radius_mm")) {
        SetSuction(kMetresPerMm * value.at("suction_cup_radius_mm").get<double>(), &grasp);
      }
      grasp.quality = value.value("quality", 1.0);
      if (value.contains("T_pregrasp_in_object")) {
        grasp.object_from_pregrasp =
            Rigid4x4FromMm(value.at("T_pregrasp_in_object"), grasp.name + ".T_pregrasp_in_object");
      }
      grasps.push_back(std::move(grasp));
    }
    return absl::OkStatus();
  }));
  return grasps;
}

}  // namespace horopter
