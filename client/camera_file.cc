#include "client/camera_file.h"

#include <algorithm>
#include <cmath>
#include <exception>
#include <filesystem>
#include <fstream>

#include "absl/strings/str_cat.h"
#include "absl/strings/str_format.h"
#include "absl/strings/str_join.h"
#include "client/calibration_camera.h"
#include "client/calibration_document.h"
#include "server/base/status_macros.h"
#include "server/vision/geometry/intrinsics_check.h"

namespace horopter {
namespace {

constexpr size_t kMostBytes = 16 << 20;
// Of the cameras of a file the one that is named, or the only one.
absl::StatusOr<CameraNode> Chosen(const std::vector<CameraNode>& cameras, const std::string& name) {
  if (cameras.empty())
    return absl::InvalidArgumentError(
        absl::StrCat("camera_matrix (or K, or fx, fy, cx and cy) is missing; ", kCalibrationForms));
  std::vector<std::string> names;
  for (const CameraNode& camera : cameras) {
    if (!name.empty() && camera.name == name) return camera;
    names.push_back(camera.name);
  }
  if (name.empty() && cameras.size() == 1) return cameras[0];
  constexpr size_t kMostNames = 8;
  const bool more = names.size() > kMostNames;
  if (more) names.resize(kMostNames);
  return absl::InvalidArgumentError(
      absl::StrCat(name.empty() ? "holds several cameras" : absl::StrCat("holds no camera ", name),
                   " (",
                   absl::StrJoin(names, ", "),
                   more ? ", .." : "",
                   "); which one is asked for with FILE#",
                   names[0]));
}

// The camera of a part of the images: the offset comes first, then binning.
CameraFile Within(CameraFile camera, const ImageRegion& region) {
  const double bx = region.binning_x, by = region.binning_y;
  if (!camera.lens && bx != by)
    camera.lens = LensFile{camera.focal_px, camera.focal_px, false, {camera.k1}, {}};
  if (camera.lens) {
    camera.lens->fx /= bx;
    camera.lens->fy /= by;
  }
  camera.focal_px /= std::sqrt(bx * by);
  // Pixel centres are integers: the image's edge lies at -0.5.
  camera.cx = (camera.cx - region.x + 0.5) / bx - 0.5;
  camera.cy = (camera.cy - region.y + 0.5) / by - 0.5;
  camera.region.reset();
  return camera;
}

// Whether binning makes `size` of `whole` pixels; those left over may be dropped or kept.
bool IsBinned(int size, int whole, int binning) {
  return size == whole / binning || size == (whole + binning - 1) / binning;
}

absl::StatusOr<CameraFile> OfRegion(const CameraFile& camera, int width, int height) {
  const ImageRegion& told = *camera.region;
  const int all_x = camera.width, all_y = camera.height;
  const int w = told.width > 0 ? told.width : all_x - told.x;
  const int h = told.height > 0 ? told.height : all_y - told.y;
  // Without any size the file is taken at its word.
  if (w <= 0 || h <= 0) return Within(camera, told);
  const auto fits = [&](int of_x, int of_y, int bx, int by) {
    return of_x > 0 && of_y > 0 && IsBinned(width, of_x, bx) && IsBinned(height, of_y, by);
  };
  if (fits(w, h, told.binning_x, told.binning_y)) return Within(camera, told);
  std::vector<ImageRegion> others;
  if (fits(w, h, 1, 1)) others.push_back({told.x, told.y, w, h, 1, 1});
  if (fits(all_x, all_y, told.binning_x, told.binning_y))
    others.push_back({0, 0, all_x, all_y, told.binning_x, told.binning_y});
  if (fits(all_x, all_y, 1, 1)) others.push_back({0, 0, all_x, all_y, 1, 1});
  if (others.size() == 1) return Within(camera, others[0]);
  return absl::InvalidArgumentError(absl::StrFormat(
      "the image has %d x %d, which is %s: the file is of %d x %d with a roi of %d x %d at %d, %d "
      "and a binning of %d x %d",
      width,
      height,
      others.empty() ? "neither all, nor the region, nor either of them binned"
                     : "both the region and all of it binned",
      all_x,
      all_y,
      w,
      h,
      told.x,
      told.y,
      told.binning_x,
      told.binning_y));
}

absl::StatusOr<CameraFile> Scaled(const CameraFile& camera, int width, int height) {
  CameraFile scaled = camera;
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
  scaled.cx = (camera.cx + 0.5) * s - 0.5;
  scaled.cy = (camera.cy + 0.5) * s - 0.5;
  if (width != camera.width || height != camera.height) {
    scaled.warnings.push_back(
        absl::StrFormat("calibrated with images of %d x %d; that of %d x %d is supposed to be "
                        "scaled by %.4g and not cut",
                        camera.width,
                        camera.height,
                        width,
                        height,
                        s));
  }
  return scaled;
}

LensModel ModelOf(const CameraFile& camera) {
  LensModel lens;
  lens.fx = camera.lens ? camera.lens->fx : camera.focal_px;
  lens.fy = camera.lens ? camera.lens->fy : camera.focal_px;
  lens.cx = camera.cx;
  lens.cy = camera.cy;
  lens.coefficients[0] = camera.k1;
  if (!camera.lens) return lens;
  if (camera.lens->fisheye) lens.kind = LensModel::Kind::kEquidistant;
  lens.coefficients = camera.lens->coefficients;
  lens.denominator = camera.lens->denominator;
  return lens;
}

absl::StatusOr<std::string> CalibrationText(const std::string& path) {
  std::error_code error;
  if (std::filesystem::is_directory(path, error))
    return absl::NotFoundError(absl::StrCat(path, ": is a folder"));
  std::ifstream file(path, std::ios::binary);
  if (!file) return absl::NotFoundError(absl::StrCat(path, ": cannot be opened"));
  std::string text(kMostBytes + 1, '\0');
  file.read(text.data(), static_cast<std::streamsize>(text.size()));
  text.resize(static_cast<size_t>(file.gcount()));
  if (text.size() > kMostBytes)
    return absl::InvalidArgumentError(absl::StrCat(path, ": is too large for a calibration"));
  return text;
}

}  // namespace

absl::StatusOr<CameraFile> ParseCameraFile(const std::string& text, const std::string& name) {
  const auto parse = [&]() -> absl::StatusOr<CameraFile> {
    HOROPTER_ASSIGN_OR_RETURN(const YAML::Node root, ParseCalibration(text));
    HOROPTER_ASSIGN_OR_RETURN(const CameraNode camera, Chosen(CamerasIn(root), name));
    return CameraOf(camera);
  };
  try {
    return parse();
  } catch (const std::exception& e) {
    return absl::InvalidArgumentError(e.what());
  }
}

absl::StatusOr<CameraFile> ReadCameraFile(const std::string& path) {
  std::string name, file = path;
  std::error_code error;
  if (const size_t mark = path.rfind('#');
      mark != std::string::npos && !std::filesystem::exists(path, error)) {
    file = path.substr(0, mark);
    name = path.substr(mark + 1);
  }
  HOROPTER_ASSIGN_OR_RETURN(const std::string text, CalibrationText(file));
  const absl::StatusOr<CameraFile> camera = ParseCameraFile(text, name);
  if (camera.ok()) return camera;
  return absl::Status(camera.status().code(),
                      absl::StrCat(path, ": ", std::string(camera.status().message())));
}

absl::StatusOr<CameraFile> ForImages(const CameraFile& camera,
                                     int width,
                                     int height,
                                     bool cropped) {
  HOROPTER_ASSIGN_OR_RETURN(
      CameraFile out,
      camera.region ? OfRegion(camera, width, height) : Scaled(camera, width, height));
  out.width = width;
  out.height = height;
  if (const auto fault = FaultOfLens(ModelOf(out), width, height, cropped)) {
    return absl::InvalidArgumentError(absl::StrCat(
        fault->detail, fault->part == LensPart::kCenter ? " (--cropped says so)" : ""));
  }
  return out;
}

absl::StatusOr<CameraFile> ForDescribedImages(const CameraFile& camera) {
  if (camera.width <= 0 || camera.height <= 0)
    return absl::InvalidArgumentError("the size of the images is missing");
  if (!camera.region) return ForImages(camera, camera.width, camera.height);
  const ImageRegion& r = *camera.region;
  const int w = r.width > 0 ? r.width : camera.width - r.x;
  const int h = r.height > 0 ? r.height : camera.height - r.y;
  return ForImages(camera, w / r.binning_x, h / r.binning_y);
}

}  // namespace horopter
