// The images as they are searched.
#pragma once

#include <Eigen/Core>
#include <optional>
#include <span>
#include <vector>

#include "server/vision/matching/ground_motion.h"
#include "server/vision/recognition/aspects/aspect_image.h"

namespace horopter {

// What is searched of the images: without the edges of patterns and textures, and of a textured
// ground whose motion is known (empty: of none).
std::vector<AspectImage> MakeAspectImages(std::span<const cv::Mat> images,
                                          AspectImageOptions options,
                                          std::span<const std::optional<Eigen::Matrix3d>> ground,
                                          int threads);

// What explanations compare poses with: all edges but those of fine texture.
std::vector<AspectImage> MakeJudgedImages(std::span<const cv::Mat> images,
                                          AspectImageOptions options,
                                          int threads);

// What is known of the ground's motion: what was asked for it, else what matching found (null:
// nothing).
PlaneInViews GroundOf(std::span<const std::optional<Eigen::Matrix3d>> asked,
                      const MatchingResult* matching);

}  // namespace horopter
