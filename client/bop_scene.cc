// Scenes of a dataset in BOP layout: images of one or several sensors, their cameras and truth.
#include <Eigen/Geometry>
#include <algorithm>
#include <array>
#include <cctype>
#include <filesystem>
#include <fstream>
#include <map>
#include <optional>
#include <set>
#include <tuple>

#include "absl/strings/ascii.h"
#include "absl/strings/str_cat.h"
#include "absl/strings/str_format.h"
#include "client/bop_dataset.h"
#include "client/bop_json.h"
#include "server/base/status_macros.h"
#include "server/vision/geometry/intrinsics_check.h"

namespace horopter {
namespace {

namespace fs = std::filesystem;
using Json = nlohmann::json;
using bop::ExistingFile;
using bop::Guarded;
using bop::IdOf;
using bop::Matrix3;
using bop::ReadJson;
using bop::RigidFromMm;

// What is read of one sensor of a scene, by image id.
using Images = std::map<int, BopImage>;

// Of a camera matrix; all of it 0 is a camera that nobody knows.
std::optional<std::string> FaultOf(const Eigen::Matrix3d& K) {
  if (K.isZero(0.0)) return std::nullopt;
  std::array<double, 9> rows;
  Eigen::Map<Eigen::Matrix<double, 3, 3, Eigen::RowMajor>>(rows.data()) = K;
  return FaultOfCameraMatrix(rows);
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

// "cam1" of "rgb_cam1", "gray1" of "gray1", "" of "rgb"; nothing for a folder without images, such
// as depth or masks.
std::optional<std::string> SensorOf(const std::string& folder) {
  for (const std::string kind : {"rgb", "gray", "grey"}) {
    if (folder.rfind(kind, 0) != 0) continue;
    const std::string rest = folder.substr(kind.size());
    if (rest.empty()) return "";
    if (rest[0] == '_' && rest.size() > 1) return rest.substr(1);
    if (std::isdigit(static_cast<unsigned char>(rest[0])) != 0) return folder;
  }
  return std::nullopt;
}

// The first of an id stays.
void AddFile(const fs::path& path, BopImage* image) {
  if (image->path.empty()) image->path = path.string();
}

// Image files by sensor and id; rgb before gray.
std::map<std::string, Images> ImageFiles(const std::string& scene) {
  static const std::set<std::string> kExtensions{
      ".png", ".jpg", ".jpeg", ".tif", ".tiff", ".pgm", ".ppm", ".bmp", ".webp", ".heic"};
  std::map<std::string, Images> files;
  std::vector<fs::path> folders = bop::SortedEntries(scene);
  std::reverse(folders.begin(), folders.end());
  for (const fs::path& folder : folders) {
    const auto sensor = SensorOf(folder.filename().string());
    if (!sensor) continue;
    for (const fs::path& path : bop::SortedEntries(folder)) {
      if (!kExtensions.contains(absl::AsciiStrToLower(path.extension().string()))) continue;
      if (const auto id = IdOf(path, "")) AddFile(path, &files[*sensor][*id]);
    }
  }
  return files;
}

// "scene_gt_cam1.json" of a sensor, or of the scene where it has but one; empty: none.
std::string SceneFile(const std::string& scene,
                      const std::string& kind,
                      const std::string& sensor) {
  const std::string stem = absl::StrCat(scene, "/", kind);
  if (sensor.empty()) {
    return ExistingFile({stem + ".json", stem + "_rgb.json", stem + "_gray.json"});
  }
  return ExistingFile({absl::StrCat(stem, "_", sensor, ".json"), stem + ".json"});
}

absl::Status ReadCameras(const std::string& path, Images& images) {
  HOROPTER_ASSIGN_OR_RETURN(const Json cameras, ReadJson(path));
  return Guarded(path, [&] {
    for (const auto& [key, value] : cameras.items()) {
      BopImage& image = images[std::stoi(key)];
      image.K = Matrix3(value.at("cam_K"), "cam_K");
      if (const auto fault = FaultOf(image.K)) throw std::runtime_error("cam_K " + *fault);
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

absl::Status ReadPoses(const std::string& path, Images& images) {
  HOROPTER_ASSIGN_OR_RETURN(const Json gt, ReadJson(path));
  return Guarded(path, [&] {
    for (const auto& [key, list] : gt.items()) {
      BopImage& image = images[std::stoi(key)];
      for (const Json& value : list) {
        image.instances.push_back(
            {value.at("obj_id").get<int>(),
             RigidFromMm(value.at("cam_R_m2c"), value.at("cam_t_m2c"), "cam_R_m2c, cam_t_m2c")});
      }
    }
    return absl::OkStatus();
  });
}

// Empty where the entry has none, or one of no size, as of what is hidden.
Eigen::AlignedBox2d VisibleBox(const Json& entry) {
  const auto box = entry.find("bbox_visib");
  if (box == entry.end()) return {};
  const std::vector<double> n = bop::Numbers(*box, 4, "bbox_visib");
  if (!(n[2] > 0.0 && n[3] > 0.0)) return {};
  return {Eigen::Vector2d(n[0], n[1]), Eigen::Vector2d(n[0] + n[2], n[1] + n[3])};
}

// Images that the file leaves out count as all visible, as those of a scene without the file do.
absl::Status ReadVisibility(const std::string& path, Images& images) {
  HOROPTER_ASSIGN_OR_RETURN(const Json info, ReadJson(path));
  return Guarded(path, [&]() -> absl::Status {
    for (auto& [id, image] : images) {
      const std::string key = std::to_string(id);
      if (image.instances.empty() || !info.contains(key)) continue;
      const Json& list = info.at(key);
      if (list.size() != image.instances.size()) {
        return absl::InvalidArgumentError(absl::StrCat(path,
                                                       ": image ",
                                                       id,
                                                       " has ",
                                                       list.size(),
                                                       " entries, scene_gt.json ",
                                                       image.instances.size()));
      }
      for (size_t j = 0; j < list.size(); ++j) {
        // Not a number is 0 of 0 pixels: outside of the image.
        const Json& share = list[j].at("visib_fract");
        image.instances[j].visib_fract = share.is_null() ? 0.0 : share.get<double>();
        image.instances[j].visible_box = VisibleBox(list[j]);
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

// The folder of the number, whatever its digits; six are BOP's own.
std::string SceneFolder(const fs::path& split, int scene_id) {
  const fs::path usual = split / absl::StrFormat("%06d", scene_id);
  std::error_code error;
  if (fs::is_directory(usual, error)) return usual.string();
  for (const fs::path& path : bop::SortedEntries(split)) {
    if (IdOf(path, "") == scene_id && fs::is_directory(path, error)) return path.string();
  }
  return "";
}

// Cameras and truth of one sensor, and the sizes of its images.
absl::Status Complete(const BopScene& scene,
                      const std::string& sensor,
                      const BopSceneOptions& options,
                      Images& images) {
  if (options.cameras) {
    const std::string cameras = SceneFile(scene.folder, "scene_camera", sensor);
    if (!cameras.empty()) HOROPTER_RETURN_IF_ERROR(ReadCameras(cameras, images));
  }
  if (options.truth && scene.has_ground_truth) {
    const std::string poses = SceneFile(scene.folder, "scene_gt", sensor);
    if (!poses.empty()) HOROPTER_RETURN_IF_ERROR(ReadPoses(poses, images));
    const std::string info = SceneFile(scene.folder, "scene_gt_info", sensor);
    if (!info.empty()) HOROPTER_RETURN_IF_ERROR(ReadVisibility(info, images));
  }
  for (auto& [id, image] : images) {
    image.im_id = id;
    image.sensor = sensor;
    if (!image.path.empty())
      std::tie(image.camera.width, image.camera.height) = ImageSizeOf(image.path);
  }
  return absl::OkStatus();
}

}  // namespace

absl::StatusOr<std::vector<int>> ListBopScenes(const std::string& folder,
                                               const std::string& split) {
  const fs::path root = fs::path(folder) / split;
  std::error_code error;
  if (!fs::is_directory(root, error)) {
    return absl::NotFoundError(absl::StrCat(root.string(), ": no such folder"));
  }
  std::set<int> ids;
  for (const fs::path& path : bop::SortedEntries(root)) {
    if (!fs::is_directory(path, error)) continue;
    if (const auto id = IdOf(path, "")) ids.insert(*id);
  }
  if (ids.empty()) return absl::NotFoundError(absl::StrCat(root.string(), ": has no scenes"));
  return std::vector<int>(ids.begin(), ids.end());
}

bool HasBopImages(const std::string& scene_folder) {
  const std::vector<fs::path> paths = bop::SortedEntries(scene_folder);
  return std::any_of(paths.begin(), paths.end(), [](const fs::path& path) {
    std::error_code error;
    return SensorOf(path.filename().string()) && fs::is_directory(path, error);
  });
}

absl::StatusOr<BopScene> ReadBopScene(const std::string& folder,
                                      const std::string& split,
                                      int scene_id,
                                      const BopSceneOptions& options) {
  BopScene scene;
  scene.scene_id = scene_id;
  const fs::path root = fs::path(folder) / split;
  scene.folder = SceneFolder(root, scene_id);
  if (scene.folder.empty()) {
    return absl::NotFoundError(
        absl::StrCat((root / absl::StrFormat("%06d", scene_id)).string(), ": no such scene"));
  }
  std::map<std::string, Images> sensors = ImageFiles(scene.folder);
  if (sensors.empty()) {
    // Truth and cameras of images that are elsewhere.
    if (SceneFile(scene.folder, "scene_camera", "").empty())
      return absl::NotFoundError(absl::StrCat(scene.folder, ": no images in rgb/ or gray/"));
    sensors[""];
  }
  scene.has_ground_truth = !SceneFile(scene.folder, "scene_gt", sensors.begin()->first).empty();
  for (auto& [sensor, images] : sensors) {
    HOROPTER_RETURN_IF_ERROR(Complete(scene, sensor, options, images));
    for (auto& [id, image] : images) scene.images.push_back(std::move(image));
    if (!options.all_sensors) break;
  }
  HOROPTER_ASSIGN_OR_RETURN(scene.tier, TierOf(scene.folder));
  return scene;
}

}  // namespace horopter
