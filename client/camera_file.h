// Calibration files of other programs.
#pragma once

#include <string>
#include <vector>

#include "absl/status/statusor.h"

namespace horopter {

// A camera as the server can take it: square pixels, no skew, one radial coefficient. Pixels: the
// centre of the top-left pixel is (0, 0), as ROS and OpenCV have it.
struct CameraFile {
  int width = 0, height = 0;  // of the images it was calibrated with; 0: the file does not say
  double focal_px = 0.0;
  double cx = 0.0, cy = 0.0;
  double k1 = 0.0;
  std::vector<std::string> warnings;  // what of the file is not used and how much it matters
};

// Reads ROS camera_info YAML (camera_calibration's file, or a message as `ros2 topic echo` prints
// it) and OpenCV FileStorage YAML (camera_matrix, distortion_coefficients). Of a message, K and D
// are read, the raw image's; P is not.
// Errors: NOT_FOUND, INVALID_ARGUMENT naming file and field (not readable, fisheye model, pixels
// that are not square by more than 2 %).
absl::StatusOr<CameraFile> ReadCameraFile(const std::string& path);

// The same camera for images of another size and the same shape. Errors: INVALID_ARGUMENT (the
// shapes differ by more than 1 %, so it was cropped or is another camera).
absl::StatusOr<CameraFile> ScaledTo(const CameraFile& camera, int width, int height);

}  // namespace horopter
