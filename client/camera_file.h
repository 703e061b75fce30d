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
};

// A camera as the server can take it: square pixels, no skew, one radial coefficient, or with the
// whole lens where that is not enough. Pixels: the centre of the top-left pixel is (0, 0), as ROS
// and OpenCV have it.
struct CameraFile {
  int width = 0, height = 0;  // of the images it was calibrated with; 0: the file does not say
  double focal_px = 0.0;
  double cx = 0.0, cy = 0.0;
  double k1 = 0.0;
  std::optional<LensFile> lens;  // needed where what the others leave out moves a corner by a pixel
  std::vector<std::string> warnings;  // what of the file is not used and how much it matters
};

// Reads ROS camera_info YAML (camera_calibration's file, or a message as `ros2 topic echo` prints
// it) and OpenCV FileStorage YAML (camera_matrix, distortion_coefficients). Of a message, K and D
// are read, the raw image's; P is not. A lens is taken whole (plumb_bob, equidistant) where k1 and
// square pixels are not enough.
// Errors: NOT_FOUND, INVALID_ARGUMENT naming file and field (not readable, a rational or thin-prism
// model).
absl::StatusOr<CameraFile> ReadCameraFile(const std::string& path);

// The same camera for images of another size and the same shape. Errors: INVALID_ARGUMENT (the
// shapes differ by more than 1 %, so it was cropped or is another camera).
absl::StatusOr<CameraFile> ScaledTo(const CameraFile& camera, int width, int height);

}  // namespace horopter
