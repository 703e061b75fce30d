// The images as the aspects' routes look at them.
#pragma once

#include <Eigen/Core>
#include <optional>
#include <span>
#include <vector>

#include "server/vision/features/features.h"
#include "server/vision/recognition/aspects/aspect_image.h"

namespace horopter {

// What is searched of the images: without the edges of patterns and textures, and of a textured
// ground whose motion is known (empty: of none).
std::vector<AspectImage> MakeAspectImages(std::span<const cv::Mat> images,
                                          AspectImageOptions options,
                                          std::span<const std::optional<Eigen::Matrix3d>> ground,
                                          int threads);

// What answers of other routes are judged by: all edges but those of fine texture.
std::vector<AspectImage> MakeJudgedImages(std::span<const cv::Mat> images,
                                          AspectImageOptions options,
                                          int threads);

// Share of the pixels that are edges, of the middle one of the views.
double EdgeShare(std::span<const ImageFeatures> features);

}  // namespace horopter
