// A recognizer that says what it was given.
#pragma once

#include <opencv2/core.hpp>
#include <opencv2/imgcodecs.hpp>
#include <optional>
#include <string>
#include <vector>

#include "server/service/recognition_service.h"
#include "tests/support/fake_objects.h"

namespace horopter {

inline std::string Png(int rows, int cols, int type = CV_8UC3) {
  cv::Mat image(rows, cols, type, cv::Scalar::all(0));
  cv::RNG rng(1);
  rng.fill(image, cv::RNG::UNIFORM, 0, 255);
  std::vector<unsigned char> bytes;
  cv::imencode(".png", image, bytes);
  return {bytes.begin(), bytes.end()};
}

// What the recognizer was given, and an answer that says so.
struct Seen {
  int calls = 0;
  std::vector<cv::Mat> images;
  std::vector<CameraHint> hints;
  std::vector<std::optional<CameraPoseHint>> camera_poses;
  std::vector<std::string> candidates;
  std::optional<ReferenceObject> reference;
  std::optional<GripperTools> gripper;
  double unknown_share = 0.0;
  std::vector<std::string> catalog_ids;
};

inline Recognizer Recording(Seen& seen) {
  return [&seen](const SceneRequest& request, const CatalogSnapshot& catalog, const CallLimits&) {
    ++seen.calls;
    seen.images = request.images;
    seen.hints = request.hints;
    seen.camera_poses = request.camera_poses;
    seen.candidates = request.candidates;
    seen.reference = request.reference;
    seen.gripper = request.gripper;
    seen.unknown_share = request.unknown_share;
    seen.catalog_ids.clear();
    for (const auto& object : catalog.objects) seen.catalog_ids.push_back(ModelOfFake(*object).id);
    PipelineResult result;
    AddReason(catalog.objects.empty() ? ReasonKind::kEmptyCatalog : ReasonKind::kNothingFound,
              "",
              &result.answer);
    result.answer.cameras.resize(request.images.size());
    result.answer.stages = {{"features", 0.5, {}}};
    return absl::StatusOr<PipelineResult>(std::move(result));
  };
}

}  // namespace horopter
