#include <cmath>
#include <string>

#include "client/camera_file.h"
#include "tests/fuzz/check.h"

// A camera of a calibration is finite, and what it is for images of a size is one of such images.
extern "C" int LLVMFuzzerTestOneInput(const unsigned char* data, size_t size) {
  using namespace horopter;
  const std::string text(reinterpret_cast<const char*>(data), size);
  for (const char* name : {"", "1", "cam0"}) {
    const auto file = ParseCameraFile(text, name);
    if (!file.ok()) {
      Require(file.status().code() == absl::StatusCode::kInvalidArgument);
      Require(!file.status().message().empty());
      continue;
    }
    Require(std::isfinite(file->focal_px) && file->focal_px > 0.0 && std::isfinite(file->cx) &&
            std::isfinite(file->cy) && std::isfinite(file->k1));
    (void)ForDescribedImages(*file);
    const auto camera = ForImages(*file, 640, 480);
    if (!camera.ok()) continue;
    Require(camera->width == 640 && camera->focal_px > 0.1 * 640 && camera->focal_px < 80.0 * 640);
    Require(camera->cx >= -0.5 && camera->cx <= 639.5);
  }
  return 0;
}
