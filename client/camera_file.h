// Calibration files of other programs.
#pragma once

#include <array>
#include <optional>
#include <string>
#include <vector>

#include "absl/status/statusor.h"

namespace horopter {

// What of a lens the server undoes before it looks at the image (CameraHint in recognition.proto).
struct LensFile {
  double fx = 0.0, fy = 0.0;
  bool fisheye = false;
  std::array<double, 5> coefficients{};  // k1, k2, p1, p2, k3; of a fisheye k1 .. k4
  std::array<double, 3> denominator{};   // k4, k5, k6 of a rational lens
};

// The part of the sensor that the images show, in pixels of all of it, and how many of these are
// one of the image: the offset is taken off first. Sizes of 0: all that is left.
struct ImageRegion {
  int x = 0, y = 0;
  int width = 0, height = 0;
  int binning_x = 1, binning_y = 1;
};

// A camera as the server can take it: square pixels, no skew, one radial coefficient, or with the
// whole lens where that is not enough. Pixels: the centre of the top-left pixel is (0, 0), as ROS
// and OpenCV have it.
struct CameraFile {
  int width = 0, height = 0;  // of all of the sensor's images; 0: the file does not say
  double focal_px = 0.0;
  double cx = 0.0, cy = 0.0;
  double k1 = 0.0;
  std::optional<LensFile> lens;  // needed where what the others leave out moves a pixel by one
  std::optional<ImageRegion>
      region;  // of a camera_info with roi or binning; K is of all the sensor
  std::vector<std::string> warnings;  // what of the file is not used, and what is supposed
};

// Reads the forms that kCalibrationForms (calibration_document.h) names. Of a message, K and D are
// read, the raw image's; P is not. A lens is taken whole (Brown's, the rational one of eight
// coefficients, the equidistant one) where k1 and square pixels are not enough. Of a file with
// several cameras `path` names one: FILE#NAME.
// Errors: NOT_FOUND, INVALID_ARGUMENT naming file and field (not readable, a K that is none, a lens
// that is not taken, several cameras and none named).
absl::StatusOr<CameraFile> ReadCameraFile(const std::string& path);

// The same of a file's text; name: "", or that of one of several cameras.
absl::StatusOr<CameraFile> ParseCameraFile(const std::string& text, const std::string& name);

// The camera of images of this size: all of the sensor, its region, binned or both, by the size;
// without region and binning of another size and the same shape, which counts as scaled and is said
// in the warnings. cropped: the images are cut-outs, whose centre may be outside.
// Errors: INVALID_ARGUMENT (no such size; what is no camera of such images: intrinsics_check.h).
absl::StatusOr<CameraFile> ForImages(const CameraFile& camera,
                                     int width,
                                     int height,
                                     bool cropped = false);

// The camera of the images that the file describes. Errors: INVALID_ARGUMENT (the file gives no
// size, and those of ForImages).
absl::StatusOr<CameraFile> ForDescribedImages(const CameraFile& camera);

}  // namespace horopter
