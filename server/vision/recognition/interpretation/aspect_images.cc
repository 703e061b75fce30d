#include "server/vision/recognition/interpretation/aspect_images.h"

#include <opencv2/core/mat.hpp>

namespace horopter {

std::vector<AspectImage> MakeAspectImages(std::span<const cv::Mat> images,
                                          AspectImageOptions options,
                                          std::span<const std::optional<Eigen::Matrix3d>> ground,
                                          int threads) {
  const std::vector<std::optional<Eigen::Matrix3d>> unknown(images.size());
  return MakeAspectImagesOnGround(
      images, ground.size() == images.size() ? ground : unknown, options, threads);
}

std::vector<AspectImage> MakeJudgedImages(std::span<const cv::Mat> images,
                                          AspectImageOptions options,
                                          int threads) {
  options.drop_pattern = false;
  return MakeAspectImagesOnGround(
      images, std::vector<std::optional<Eigen::Matrix3d>>(images.size()), options, threads);
}

PlaneInViews GroundOf(std::span<const std::optional<Eigen::Matrix3d>> asked,
                      const MatchingResult* matching) {
  if (!asked.empty()) return {asked.begin(), asked.end()};
  return matching != nullptr ? LargestPlane(*matching) : PlaneInViews();
}

}  // namespace horopter
