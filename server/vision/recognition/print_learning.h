// What is printed on an object, from scenes in which it was answered.
#pragma once

#include <memory>
#include <optional>
#include <span>
#include <vector>

#include "absl/status/statusor.h"
#include "server/base/stop_token.h"
#include "server/vision/geometry/calibrated_camera.h"
#include "server/vision/geometry/object_model.h"

namespace cv {
class Mat;
}

namespace horopter {

// An answered scene.
struct AnsweredImages {
  struct Placed {
    std::shared_ptr<const ObjectModel> model;
    Rigid3 scene_from_object;
  };
  std::span<const cv::Mat> images;                     // 8 bit, grey or BGR; they outlive this
  std::vector<std::optional<CalibratedCamera>> views;  // one per image; nothing: not looked at
  std::vector<Placed> objects;
};

// Of the object of the model's id, wherever the scenes have it; the others hide it. Errors:
// FAILED_PRECONDITION (LearnPrint of interpretation/surface_print.h), CANCELLED.
absl::StatusOr<SurfacePrint> LearnPrintFrom(const ObjectModel& model,
                                            const std::vector<AnsweredImages>& scenes,
                                            int threads,
                                            const StopRequested& stop);

}  // namespace horopter
