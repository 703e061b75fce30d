// One image as recognition sees it: oriented edge maps and the segments that ask for an
// explanation.
#pragma once

#include <Eigen/Core>
#include <cstdint>
#include <vector>

#include "server/vision/features/features.h"
#include "server/vision/recognition/scoring/edge_maps.h"

namespace horopter {

// A point every kSegmentSampleStep working pixels along the image's segments (working pixels).
struct SegmentSample {
  Eigen::Vector2f point = Eigen::Vector2f::Zero();
  std::uint8_t bin = 0;
  std::int32_t segment = -1;
};

struct ViewEvidence {
  static constexpr float kSegmentSampleStep = 4.0f;  // working px

  int width = 0;  // of the image, pixels
  int height = 0;
  const ImageFeatures* features = nullptr;
  EdgeMaps maps;
  std::vector<SegmentSample> segment_samples;  // without segments in fine texture
};

// features must outlive the result.
ViewEvidence BuildViewEvidence(const ImageFeatures& features, int threads = 1);

}  // namespace horopter
