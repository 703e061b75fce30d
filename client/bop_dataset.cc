#include "client/bop_dataset.h"

#include <Eigen/Geometry>
#include <Eigen/SVD>
#include <algorithm>
#include <cmath>
#include <exception>
#include <filesystem>
#include <fstream>
#include <map>
#include <nlohmann/json.hpp>
#include <optional>
#include <set>
#include <stdexcept>
#include <tuple>

#include "absl/strings/str_cat.h"
#include "absl/strings/str_format.h"
#include "client/isaac_grasp.h"
#include "server/base/status_macros.h"
#include "server/vision/geometry/grasp_kind.h"

namespace horopter {
namespace {

namespace fs = std::filesystem;
using Json = nlohmann::json;

constexpr double kMetresPerMm = 1e-3;

// Runs `body` and turns the JSON library's exceptions into a status that names the file.
template <typename Body>
absl::Status Guarded(const std::string& path, Body body) {
  try {
    return body();
  } catch (const std::exception& e) {
    return absl::InvalidArgumentError(absl::StrCat(path, ": ", e.what()));
  }
}

absl::StatusOr<Json> ReadJson(const std::string& path) {
  std::ifstream file(path);
  if (!file) return absl::NotFoundError(absl::StrCat(path, ": cannot be opened"));
  try {
    return Json::parse(file);
  } catch (const std::exception& e) {
    return absl::InvalidArgumentError(absl::StrCat(path, ": not JSON: ", e.what()));
  }
}

std::vector<double> Numbers(const Json& value, size_t count, const std::string& what) {
  auto numbers = value.get<std::vector<double>>();
  if (numbers.size() != count) {
    throw std::runtime_error(absl::StrCat(what, " has ", numbers.size(), " numbers, not ", count));
  }
  for (const double x : numbers) {
    if (!std::isfinite(x)) throw std::runtime_error(absl::StrCat(what, " is not finite"));
  }
  return numbers;
}

Eigen::Matrix3d Matrix3(const Json& value, const std::string& what) {
  const std::vector<double> n = Numbers(value, 9, what);
  return Eigen::Map<const Eigen::Matrix<double, 3, 3, Eigen::RowMajor>>(n.data());
}

Rigid3 RigidFromMm(const Json& R, const Json& t, const std::string& what) {
  const std::vector<double> n = Numbers(t, 3, what);
  return {Matrix3(R, what), kMetresPerMm * Eigen::Vector3d(n[0], n[1], n[2])};
}

// Of R R^T from the identity. Grasps are written by hand and by tools that round to few digits:
// what is a rotation to two degrees is taken for the nearest one.
constexpr double kRigid = 1e-3, kNearlyRigid = 0.05;

Rigid3 Rigid4x4FromMm(const Json& value, const std::string& what, double tolerance = kRigid) {
  const std::vector<double> n = Numbers(value, 16, what);
  const Eigen::Matrix4d m =
      Eigen::Map<const Eigen::Matrix<double, 4, 4, Eigen::RowMajor>>(n.data());
  const Eigen::Matrix3d R = m.topLeftCorner<3, 3>();
  if ((R * R.transpose() - Eigen::Matrix3d::Identity()).norm() > tolerance ||
      R.determinant() < 0.0) {
    throw std::runtime_error(absl::StrCat(what, " is not a rigid transform"));
  }
  const Eigen::JacobiSVD<Eigen::Matrix3d> svd(R, Eigen::ComputeFullU | Eigen::ComputeFullV);
  return {svd.matrixU() * svd.matrixV().transpose(), kMetresPerMm * m.topRightCorner<3, 1>()};
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

std::string ExistingFile(std::initializer_list<std::string> candidates) {
  std::error_code error;
  for (const std::string& path : candidates) {
    if (fs::is_regular_file(path, error)) return path;
  }
  return "";
}

// The number in "obj_000012.ply" or "000012.png", whatever the number of digits.
std::optional<int> IdOf(const fs::path& path, const std::string& prefix) {
  const std::string stem = path.stem().string();
  if (stem.rfind(prefix, 0) != 0) return std::nullopt;
  const std::string digits = stem.substr(prefix.size());
  if (digits.empty() || digits.size() > 9 ||
      digits.find_first_not_of("0123456789") != std::string::npos) {
    return std::nullopt;
  }
  return std::stoi(digits);
}

// Width and height from the header of a PNG or JPEG file; zeros for another format.
std::pair<int, int> ImageSizeOf(const std::string& path) {
  std::ifstream file(path, std::ios::binary);
  std::vector<unsigned char> b(65536);
  file.read(reinterpret_cast<char*>(b.data()), static_cast<std::streamsize>(b.size()));
  b.resize(static_cast<size_t>(file.gcount()));
  const auto be16 = [&](size_t i) { return b[i] << 8 | b[i + 1]; };
  const auto be32 = [&](size_t i) { return be16(i) << 16 | be16(i + 2); };
  if (b.size() >= 24 && b[0] == 0x89 && b[1] == 'P' && b[2] == 'N' && b[3] == 'G') {
    return {be32(16), be32(20)};
  }
  if (b.size() < 4 || b[0] != 0xFF || b[1] != 0xD8) return {0, 0};
  for (size_t i = 2; i + 9 < b.size();) {
    if (b[i] != 0xFF) {
      ++i;
      continue;
    }
    const int marker = b[i + 1];
    const bool frame =
        marker >= 0xC0 && marker <= 0xCF && marker != 0xC4 && marker != 0xC8 && marker != 0xCC;
    if (frame) return {be16(i + 7), be16(i + 5)};
    i += 2 + static_cast<size_t>(be16(i + 2));
  }
  return {0, 0};
}

// Image files of a scene by id; rgb/ before gray/.
std::map<int, std::string> ImageFiles(const std::string& scene) {
  static const std::set<std::string> kExtensions{
      ".png", ".jpg", ".jpeg", ".tif", ".tiff", ".pgm", ".PNG", ".JPG", ".JPEG"};
  std::map<int, std::string> files;
  for (const char* sub : {"rgb", "gray", "grey"}) {
    std::error_code error;
    for (fs::directory_iterator it(fs::path(scene) / sub, error), end; !error && it != end;
         it.increment(error)) {
      if (!kExtensions.contains(it->path().extension().string())) continue;
      if (const auto id = IdOf(it->path(), "")) files.emplace(*id, it->path().string());
    }
  }
  return files;
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

absl::Status ReadCameras(const std::string& path, std::map<int, BopImage>& images) {
  HOROPTER_ASSIGN_OR_RETURN(const Json cameras, ReadJson(path));
  return Guarded(path, [&] {
    for (const auto& [key, value] : cameras.items()) {
      BopImage& image = images[std::stoi(key)];
      image.K = Matrix3(value.at("cam_K"), "cam_K");
      image.camera.focal_px = image.K(0, 0);
      image.camera.cx = image.K(0, 2);
      image.camera.cy = image.K(1, 2);
      if (value.contains("cam_dist")) {
        image.distortion = value["cam_dist"].get<std::vector<double>>();
        if (!image.distortion.empty()) image.camera.k1 = image.distortion[0];
      }
      if (value.contains("cam_R_w2c")) {
        image.has_pose = true;
        image.camera_from_world =
            RigidFromMm(value["cam_R_w2c"], value.at("cam_t_w2c"), "cam_R_w2c, cam_t_w2c");
      }
    }
    return absl::OkStatus();
  });
}

absl::Status ReadGroundTruth(const std::string& folder, std::map<int, BopImage>& images) {
  const std::string gt_path = folder + "/scene_gt.json";
  HOROPTER_ASSIGN_OR_RETURN(const Json gt, ReadJson(gt_path));
  HOROPTER_RETURN_IF_ERROR(Guarded(gt_path, [&] {
    for (const auto& [key, list] : gt.items()) {
      BopImage& image = images[std::stoi(key)];
      for (const Json& value : list) {
        image.instances.push_back(
            {value.at("obj_id").get<int>(),
             RigidFromMm(value.at("cam_R_m2c"), value.at("cam_t_m2c"), "cam_R_m2c, cam_t_m2c")});
      }
    }
    return absl::OkStatus();
  }));
  const std::string info_path = folder + "/scene_gt_info.json";
  if (ExistingFile({info_path}).empty()) return absl::OkStatus();
  HOROPTER_ASSIGN_OR_RETURN(const Json info, ReadJson(info_path));
  return Guarded(info_path, [&]() -> absl::Status {
    for (auto& [id, image] : images) {
      if (image.instances.empty()) continue;
      const Json& list = info.at(std::to_string(id));
      if (list.size() != image.instances.size()) {
        return absl::InvalidArgumentError(absl::StrCat(info_path,
                                                       ": image ",
                                                       id,
                                                       " has ",
                                                       list.size(),
                                                       " entries, scene_gt.json ",
                                                       image.instances.size()));
      }
      for (size_t j = 0; j < list.size(); ++j) {
        image.instances[j].visib_fract = list[j].at("visib_fract").get<double>();
      }
    }
    return absl::OkStatus();
  });
}

absl::StatusOr<std::string> TierOf(const std::string& folder) {
  const std::string path = folder + "/scene_meta.json";
  if (ExistingFile({path}).empty()) return std::string("all");
  HOROPTER_ASSIGN_OR_RETURN(const Json meta, ReadJson(path));
  if (!meta.is_object() || !meta.contains("tier")) return std::string("all");
  return meta["tier"].is_string() ? meta["tier"].get<std::string>() : meta["tier"].dump();
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
  std::map<int, BopObject> objects;
  for (const char* sub : {"cad", "models"}) {
    for (fs::directory_iterator it(fs::path(folder) / sub, error), end; !error && it != end;
         it.increment(error)) {
      const std::string extension = it->path().extension().string();
      if (extension != ".step" && extension != ".stp" && extension != ".ply") continue;
      if (const auto id = IdOf(it->path(), "obj_")) objects[*id];
    }
  }
  if (objects.empty()) {
    return absl::NotFoundError(
        absl::StrCat(folder, ": neither cad/obj_*.step nor models/obj_*.ply there"));
  }
  const std::string info = folder + "/models/models_info.json";
  if (!ExistingFile({info}).empty()) {
    std::map<int, BopObject> known;
    HOROPTER_RETURN_IF_ERROR(ReadModelsInfo(info, known));
    for (auto& [id, object] : objects) {
      if (const auto it = known.find(id); it != known.end()) object = it->second;
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
    const std::string stem = BopObjectName(id);
    object.obj_id = id;
    object.cad_path =
        ExistingFile({folder + "/cad/" + stem + ".step", folder + "/cad/" + stem + ".stp"});
    object.mesh_path = ExistingFile({folder + "/models/" + stem + ".ply"});
    object.grasps_path = ExistingFile({folder + "/grasps/" + stem + ".json"});
    if (names.is_object() && names.contains(std::to_string(id)) &&
        names[std::to_string(id)].is_string()) {
      object.name = names[std::to_string(id)].get<std::string>();
    }
    dataset.objects.push_back(std::move(object));
  }
  return dataset;
}

absl::StatusOr<std::vector<int>> ListBopScenes(const std::string& folder,
                                               const std::string& split) {
  const fs::path root = fs::path(folder) / split;
  std::error_code error;
  if (!fs::is_directory(root, error)) {
    return absl::NotFoundError(absl::StrCat(root.string(), ": no such folder"));
  }
  std::vector<int> ids;
  for (fs::directory_iterator it(root, error), end; !error && it != end; it.increment(error)) {
    if (!it->is_directory(error)) continue;
    if (const auto id = IdOf(it->path(), "")) ids.push_back(*id);
  }
  std::sort(ids.begin(), ids.end());
  if (ids.empty()) return absl::NotFoundError(absl::StrCat(root.string(), ": has no scenes"));
  return ids;
}

absl::StatusOr<BopScene> ReadBopScene(const std::string& folder,
                                      const std::string& split,
                                      int scene_id) {
  BopScene scene;
  scene.scene_id = scene_id;
  scene.folder = (fs::path(folder) / split / absl::StrFormat("%06d", scene_id)).string();
  std::error_code error;
  if (!fs::is_directory(scene.folder, error)) {
    return absl::NotFoundError(absl::StrCat(scene.folder, ": no such scene"));
  }
  std::map<int, BopImage> images;
  for (const auto& [id, path] : ImageFiles(scene.folder)) images[id].path = path;
  const std::string cameras = ExistingFile({scene.folder + "/scene_camera.json"});
  if (!cameras.empty()) {
    HOROPTER_RETURN_IF_ERROR(ReadCameras(cameras, images));
  }
  if (images.empty()) {
    return absl::NotFoundError(absl::StrCat(scene.folder, ": no images in rgb/ or gray/"));
  }
  if (!ExistingFile({scene.folder + "/scene_gt.json"}).empty()) {
    scene.has_ground_truth = true;
    HOROPTER_RETURN_IF_ERROR(ReadGroundTruth(scene.folder, images));
  }
  HOROPTER_ASSIGN_OR_RETURN(scene.tier, TierOf(scene.folder));
  for (auto& [id, image] : images) {
    image.im_id = id;
    if (!image.path.empty()) {
      std::tie(image.camera.width, image.camera.height) = ImageSizeOf(image.path);
    }
    scene.images.push_back(std::move(image));
  }
  return scene;
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
      grasp.object_from_gripper = Rigid4x4FromMm(
          value.at("T_gripper_in_object"), grasp.name + ".T_gripper_in_object", kNearlyRigid);
      grasp.jaw_opening_m = kMetresPerMm * value.value("jaw_opening_mm", 0.0);
      grasp.grip_width_m = kMetresPerMm * value.value("grip_width_mm", 0.0);
      if (value.contains("suction_cup_radius_mm")) {
        SetSuction(kMetresPerMm * value.at("suction_cup_radius_mm").get<double>(), &grasp);
      }
      grasp.quality = value.value("quality", 1.0);
      if (value.contains("T_pregrasp_in_object")) {
        grasp.object_from_pregrasp = Rigid4x4FromMm(
            value.at("T_pregrasp_in_object"), grasp.name + ".T_pregrasp_in_object", kNearlyRigid);
      }
      grasps.push_back(std::move(grasp));
    }
    return absl::OkStatus();
  }));
  return grasps;
}

}  // namespace horopter
