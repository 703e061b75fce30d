#include "client/camera_file.h"

#include <yaml-cpp/yaml.h>

#include <algorithm>
#include <cmath>
#include <exception>
#include <fstream>
#include <optional>
#include <sstream>

#include "absl/strings/str_cat.h"
#include "absl/strings/str_format.h"

namespace horopter {
namespace {

absl::Status Bad(const std::string& path, const std::string& what) {
  return absl::InvalidArgumentError(absl::StrCat(path, ": ", what));
}

// A plain list, or a matrix with `data`.
std::optional<std::vector<double>> NodeNumbers(const YAML::Node& node) {
  if (!node.IsDefined() || node.IsNull()) return std::nullopt;
  const YAML::Node list = node.IsMap() ? node["data"] : node;
  if (!list.IsDefined() || !list.IsSequence()) return std::nullopt;
  std::vector<double> numbers;
  for (const YAML::Node& n : list) numbers.push_back(n.as<double>());
  return numbers;
}

std::optional<std::vector<double>> FirstOf(const YAML::Node& root,
                                           std::initializer_list<const char*> names) {
  for (const char* name : names) {
    if (auto numbers = NodeNumbers(root[name])) return numbers;
  }
  return std::nullopt;
}

int IntegerOf(const YAML::Node& root, std::initializer_list<const char*> names) {
  for (const char* name : names) {
    if (root[name].IsDefined() && root[name].IsScalar()) return root[name].as<int>();
  }
  return 0;
}

// Largest shift, over the corners, by what one coefficient leaves out: k2, k3 and p1, p2.
double IgnoredDistortionPx(const CameraFile& c, const std::vector<double>& d) {
  const auto at = [&](size_t i) { return i < d.size() ? d[i] : 0.0; };
  const double width = c.width > 0 ? c.width : 2.0 * c.cx;
  const double height = c.height > 0 ? c.height : 2.0 * c.cy;
  double worst = 0.0;
  for (const double u : {0.0, width - 1.0}) {
    for (const double v : {0.0, height - 1.0}) {
      const double x = (u - c.cx) / c.focal_px, y = (v - c.cy) / c.focal_px;
      const double r2 = x * x + y * y;
      const double radial = at(1) * r2 * r2 + at(4) * r2 * r2 * r2;
      const double dx = x * radial + 2.0 * at(2) * x * y + at(3) * (r2 + 2.0 * x * x);
      const double dy = y * radial + at(2) * (r2 + 2.0 * y * y) + 2.0 * at(3) * x * y;
      worst = std::max(worst, c.focal_px * std::hypot(dx, dy));
    }
  }
  return worst;
}

absl::StatusOr<CameraFile> FromYaml(const YAML::Node& root, const std::string& path) {
  if (!root.IsMap()) return Bad(path, "no camera_info and no OpenCV YAML file");
  const auto K = FirstOf(root, {"camera_matrix", "K", "k", "Camera_Matrix", "cameraMatrix", "M1"});
  if (!K || K->size() != 9) {
    return Bad(path, "camera_matrix (or K) with 9 numbers is missing");
  }
  const std::vector<double> D =
      FirstOf(root,
              {"distortion_coefficients", "D", "d", "Distortion_Coefficients", "distCoeffs", "D1"})
          .value_or(std::vector<double>{});
  for (const std::vector<double>* list : {&*K, &D}) {
    for (const double n : *list) {
      if (!std::isfinite(n)) return Bad(path, "a number is not finite");
    }
  }
  const std::string model =
      root["distortion_model"].IsDefined() ? root["distortion_model"].as<std::string>() : "";
  const bool fisheye = model == "equidistant" || model == "fisheye";
  if (fisheye && D.size() != 4) {
    return Bad(path, absl::StrCat("distortion_model ", model, " needs 4 coefficients"));
  }
  if (!model.empty() && model != "plumb_bob" && model != "rational_polynomial" && !fisheye) {
    return Bad(path, absl::StrCat("distortion_model ", model, ": rectify the images first"));
  }
  if (model == "rational_polynomial" || D.size() > 5) {
    for (size_t i = 5; i < D.size(); ++i) {
      if (D[i] != 0.0) {
        return Bad(path, "rational or thin-prism distortion: rectify the images first");
      }
    }
  }
  const double fx = (*K)[0], fy = (*K)[4];
  if (!(fx > 0.0 && fy > 0.0)) return Bad(path, "camera_matrix: focal lengths must be positive");
  CameraFile camera;
  camera.focal_px = std::sqrt(fx * fy);
  camera.cx = (*K)[2];
  camera.cy = (*K)[5];
  camera.k1 = D.empty() || fisheye ? 0.0 : D[0];
  camera.width = IntegerOf(root, {"image_width", "width", "image_Width", "imageWidth"});
  camera.height = IntegerOf(root, {"image_height", "height", "image_Height", "imageHeight"});
  constexpr double kSquare = 0.005;  // |log(fx / fy)| below which pixels count as square
  if (fisheye || std::abs(std::log(fx / fy)) > kSquare || IgnoredDistortionPx(camera, D) > 1.0) {
    camera.lens = LensFile{fx, fy, fisheye, {}};
    std::copy_n(D.begin(), std::min<size_t>(D.size(), 5), camera.lens->coefficients.begin());
  }
  if (std::abs((*K)[1]) > 1e-3 * fx) camera.warnings.push_back("the skew is not used");
  return camera;
}

}  // namespace

absl::StatusOr<CameraFile> ReadCameraFile(const std::string& path) {
  std::ifstream file(path);
  if (!file) return absl::NotFoundError(absl::StrCat(path, ": cannot be opened"));
  std::ostringstream text;
  for (std::string line; std::getline(file, line);) {
    // OpenCV writes "%YAML:1.0", which is no YAML directive, and `ros2 topic echo` a closing line.
    if (line.rfind("%YAML", 0) == 0 || line.rfind("---", 0) == 0) continue;
    text << line << '\n';
  }
  try {
    return FromYaml(YAML::Load(text.str()), path);
  } catch (const std::exception& e) {
    return Bad(path, e.what());
  }
}

absl::StatusOr<CameraFile> ScaledTo(const CameraFile& camera, int width, int height) {
  CameraFile scaled = camera;
  scaled.width = width;
  scaled.height = height;
  if (camera.width <= 0 || camera.height <= 0) return scaled;
  const double s = static_cast<double>(width) / camera.width;
  if (std::abs(static_cast<double>(height) / camera.height / s - 1.0) > 0.01) {
    return absl::InvalidArgumentError(
        absl::StrFormat("the camera was calibrated with images of %d x %d, the image has %d x %d",
                        camera.width,
                        camera.height,
                        width,
                        height));
  }
  scaled.focal_px *= s;
  if (scaled.lens) {
    scaled.lens->fx *= s;
    scaled.lens->fy *= s;
  }
  // Pixel centres are integers: the image's edge lies at -0.5.
  scaled.cx = (camera.cx + 0.5) * s - 0.5;
  scaled.cy = (camera.cy + 0.5) * s - 0.5;
  return scaled;
}

}  // namespace horopter
