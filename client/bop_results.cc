#include "client/bop_results.h"

#include <unistd.h>

#include <cmath>
#include <cstdlib>
#include <exception>
#include <filesystem>
#include <fstream>
#include <nlohmann/json.hpp>
#include <sstream>
#include <system_error>

#include "absl/strings/str_cat.h"
#include "absl/strings/str_format.h"
#include "client/units.h"
#include "server/base/status_macros.h"

namespace horopter {
namespace {

std::vector<std::string> SplitFields(const std::string& line, char separator) {
  std::vector<std::string> fields;
  std::istringstream stream(line);
  for (std::string field; std::getline(stream, field, separator);) fields.push_back(field);
  return fields;
}

// All blank-separated numbers of a field; empty when one is not a finite number.
std::vector<double> FieldNumbers(const std::string& field) {
  std::vector<double> numbers;
  std::istringstream stream(field);
  for (std::string word; stream >> word;) {
    char* end = nullptr;
    const double value = std::strtod(word.c_str(), &end);
    if (*end != '\0' || !std::isfinite(value)) return {};
    numbers.push_back(value);
  }
  return numbers;
}

absl::StatusOr<BopEstimate> ParseRow(const std::string& line, const std::string& where) {
  const std::vector<std::string> fields = SplitFields(line, ',');
  if (fields.size() != 7) {
    return absl::InvalidArgumentError(
        absl::StrCat(where, ": expected 7 columns, got ", fields.size()));
  }
  constexpr size_t kCounts[7] = {1, 1, 1, 1, 9, 3, 1};
  std::vector<double> n[7];
  for (int k = 0; k < 7; ++k) {
    n[k] = FieldNumbers(fields[k]);
    if (n[k].size() != kCounts[k]) {
      return absl::InvalidArgumentError(absl::StrCat(
          where, ": column ", k + 1, " should hold ", kCounts[k], " finite number(s)"));
    }
  }
  BopEstimate e;
  e.scene_id = static_cast<int>(n[0][0]);
  e.im_id = static_cast<int>(n[1][0]);
  e.obj_id = static_cast<int>(n[2][0]);
  e.score = n[3][0];
  e.camera_from_object.R =
      Eigen::Map<const Eigen::Matrix<double, 3, 3, Eigen::RowMajor>>(n[4].data());
  e.camera_from_object.t = Eigen::Map<const Eigen::Vector3d>(n[5].data()) / kMmPerMetre;
  e.time_s = n[6][0];
  return e;
}

absl::Status ReadResultCameras(const std::string& path, BopResults* results) {
  try {
    std::ifstream file(path);
    const nlohmann::json json = nlohmann::json::parse(file);
    for (const auto& [scene, images] : json.items()) {
      for (const auto& [im, camera] : images.items()) {
        const auto k = camera.at("cam_K").get<std::vector<double>>();
        if (k.size() != 9) {
          return absl::InvalidArgumentError(
              absl::StrCat(path, ": scene ", scene, ", image ", im, ": cam_K needs 9 numbers"));
        }
        results->cameras[std::stoi(scene)][std::stoi(im)] =
            Eigen::Map<const Eigen::Matrix<double, 3, 3, Eigen::RowMajor>>(k.data());
        if (camera.contains("cam_dist")) {
          results->distortions[std::stoi(scene)][std::stoi(im)] =
              camera["cam_dist"].get<std::vector<double>>();
        }
      }
    }
  } catch (const std::exception& e) {
    return absl::InvalidArgumentError(absl::StrCat(path, ": ", e.what()));
  }
  return absl::OkStatus();
}

}  // namespace

std::string CamerasPathOf(const std::string& csv_path) {
  return std::filesystem::path(csv_path).replace_extension(".cameras.json").string();
}

absl::Status CheckCanBeWritten(const std::string& path) {
  std::error_code error;
  const std::filesystem::path folder = std::filesystem::path(path).parent_path();
  if (!folder.empty() && !std::filesystem::is_directory(folder, error)) {
    return absl::NotFoundError(absl::StrCat(path, ": there is no folder ", folder.string()));
  }
  if (path.empty() || std::filesystem::is_directory(path, error)) {
    return absl::PermissionDeniedError(absl::StrCat(path, ": is a folder, not a file"));
  }
  const std::string temporary = absl::StrCat(path, ".tmp", ::getpid());
  const bool written = std::ofstream(temporary, std::ios::binary | std::ios::app).is_open();
  std::filesystem::remove(temporary, error);
  return written ? absl::OkStatus()
                 : absl::PermissionDeniedError(absl::StrCat(path, ": cannot be written"));
}

absl::Status WriteFileAtomically(const std::string& path, const std::string& content) {
  const std::string temporary = absl::StrCat(path, ".tmp", ::getpid());
  std::error_code error;
  {
    std::ofstream file(temporary, std::ios::binary | std::ios::trunc);
    file << content;
    file.close();
    if (!file) {
      std::filesystem::remove(temporary, error);
      return absl::PermissionDeniedError(absl::StrCat(path, ": cannot be written"));
    }
  }
  std::filesystem::rename(temporary, path, error);
  if (error) {
    const std::string reason = error.message();
    std::filesystem::remove(temporary, error);
    return absl::PermissionDeniedError(absl::StrCat(path, ": cannot be written: ", reason));
  }
  return absl::OkStatus();
}

absl::Status WriteBopResults(const BopResults& results, const std::string& csv_path) {
  std::string csv = "scene_id,im_id,obj_id,score,R,t,time\n";
  for (const BopEstimate& e : results.estimates) {
    absl::StrAppendFormat(&csv, "%d,%d,%d,%.6f,", e.scene_id, e.im_id, e.obj_id, e.score);
    for (int i = 0; i < 9; ++i) {
      absl::StrAppendFormat(&csv, "%s%.9f", i > 0 ? " " : "", e.camera_from_object.R(i / 3, i % 3));
    }
    const Eigen::Vector3d t = kMmPerMetre * e.camera_from_object.t;
    absl::StrAppendFormat(&csv, ",%.6f %.6f %.6f,%.4f\n", t.x(), t.y(), t.z(), e.time_s);
  }
  nlohmann::json cameras = nlohmann::json::object();
  for (const auto& [scene, images] : results.cameras) {
    for (const auto& [im, K] : images) {
      std::vector<double> k;
      for (int i = 0; i < 9; ++i) k.push_back(K(i / 3, i % 3));
      nlohmann::json& camera = cameras[std::to_string(scene)][std::to_string(im)];
      camera["cam_K"] = k;
      const auto of_scene = results.distortions.find(scene);
      if (of_scene == results.distortions.end()) continue;
      const auto of_image = of_scene->second.find(im);
      if (of_image != of_scene->second.end()) camera["cam_dist"] = of_image->second;
    }
  }
  HOROPTER_RETURN_IF_ERROR(WriteFileAtomically(CamerasPathOf(csv_path), cameras.dump(1) + "\n"));
  return WriteFileAtomically(csv_path, csv);
}

absl::StatusOr<BopResults> ReadBopResults(const std::string& csv_path) {
  std::ifstream file(csv_path);
  if (!file) return absl::NotFoundError(absl::StrCat(csv_path, ": cannot be opened"));
  BopResults results;
  int number = 0;
  for (std::string line; std::getline(file, line);) {
    ++number;
    while (!line.empty() && (line.back() == '\r' || line.back() == ' ')) line.pop_back();
    if (line.empty() || line.rfind("scene_id", 0) == 0) continue;
    HOROPTER_ASSIGN_OR_RETURN(BopEstimate estimate,
                              ParseRow(line, absl::StrCat(csv_path, ":", number)));
    results.estimates.push_back(estimate);
  }
  const std::string cameras = CamerasPathOf(csv_path);
  std::error_code error;
  if (std::filesystem::exists(cameras, error)) {
    HOROPTER_RETURN_IF_ERROR(ReadResultCameras(cameras, &results));
  }
  return results;
}

}  // namespace horopter
