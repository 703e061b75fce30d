#include "server/vision/recognition/interpretation/aspect_images.h"

#include <algorithm>
#include <cstddef>
#include <opencv2/core/mat.hpp>

#include "server/vision/recognition/aspects/quantile.h"

namespace horopter {

std::vector<AspectImage> MakeAspectImages(std::span<const cv::Mat> images,
                                          AspectImageOptions options,
                                          std::span<const std::optional<Eigen::Matrix3d>> ground,
                                          int threads) {
  options.drop_pattern = true;
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

double EdgeShare(std::span<const ImageFeatures> features) {
  std::vector<double> shares;
  for (const ImageFeatures& f : features) {
    std::size_t points = 0;
    for (const EdgeChain& chain : f.chains) points += chain.points.size();
    shares.push_back(static_cast<double>(points) / std::max(1.0, 1.0 * f.width * f.height));
  }
  return Median(&shares);
}

}  // namespace horopter
