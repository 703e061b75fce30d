// A scene's images as the pipeline hands them to the stages, and its truth in their pixels.
#pragma once

#include <opencv2/core/mat.hpp>
#include <vector>

#include "absl/status/statusor.h"
#include "client/bop_dataset.h"

namespace horopter {

// Those of PipelineOptions, which brings all of recognition with it; a test compares them.
inline constexpr int kLeastSidePx = 1280, kSmallSidePx = 448;

struct ReducedScene {
  BopScene scene;
  std::vector<cv::Mat> images;
};

// Errors: INVALID_ARGUMENT naming the file that is not an image.
absl::StatusOr<ReducedScene> ReadReduced(const BopScene& scene);

}  // namespace horopter
