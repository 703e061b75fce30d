#include "server/vision/recognition/aspects/aspect_maps.h"

#include <algorithm>
#include <cmath>
#include <opencv2/imgproc.hpp>

#include "server/base/parallel_for.h"

namespace horopter {
namespace {

constexpr float kPi = 3.14159265358979f;

// Both maps of one bin.
void FillBin(int bin, double reach_rad, const std::vector<float>& directions, AspectImage* image) {
  cv::Mat zero_at_edges(image->height, image->width, CV_8U, cv::Scalar(1));
  const float center = bin * kPi / kAspectBins;
  for (std::size_t i = 0; i < image->edges.size(); ++i) {
    float off = std::abs(directions[i] - center);
    off = std::min(off, kPi - off);
    if (off > reach_rad) continue;
    const Eigen::Vector2f& p = image->edges[i].point;
    zero_at_edges.at<std::uint8_t>(static_cast<int>(std::lround(p.y())),
                                   static_cast<int>(std::lround(p.x()))) = 0;
  }
  cv::Mat distance;
  cv::distanceTransform(zero_at_edges, distance, cv::DIST_L2, cv::DIST_MASK_3, CV_32F);
  cv::Mat full(
      image->height,
      image->width,
      CV_8U,
      image->distance.data() + static_cast<std::size_t>(bin) * image->width * image->height);
  distance.convertTo(full, CV_8U, AspectImage::kDistanceScale);
  cv::Mat half(image->half_height,
               image->half_width,
               CV_8U,
               image->half_distance.data() +
                   static_cast<std::size_t>(bin) * image->half_width * image->half_height);
  cv::resize(full, half, half.size(), 0, 0, cv::INTER_AREA);
}

// Chance levels of one bin: block means of the support, then means over the window.
void FillChance(int bin, AspectImage* image) {
  constexpr int kBlock = AspectImage::kChanceBlockPx;  // px
  const std::size_t blocks = static_cast<std::size_t>(image->chance_width) * image->chance_height;
  const std::uint8_t* half = image->half_distance.data() +
                             static_cast<std::size_t>(bin) * image->half_width * image->half_height;
  for (int level = 0; level < AspectImage::kChanceLevels; ++level) {
    const float tau = AspectImage::kChanceTausPx[level] * AspectImage::kDistanceScale;
    cv::Mat sum(image->chance_height, image->chance_width, CV_32F, cv::Scalar(0));
    cv::Mat count(image->chance_height, image->chance_width, CV_32F, cv::Scalar(1e-6));
    for (int y = 0; y < image->half_height; ++y) {
      float* sum_row = sum.ptr<float>(std::min(2 * y / kBlock, image->chance_height - 1));
      float* count_row = count.ptr<float>(std::min(2 * y / kBlock, image->chance_height - 1));
      for (int x = 0; x < image->half_width; ++x) {
        const int block = std::min(2 * x / kBlock, image->chance_width - 1);
        const float d = half[static_cast<std::size_t>(y) * image->half_width + x];
        sum_row[block] += std::max(0.0f, 1.0f - d / tau);
        count_row[block] += 1.0f;
      }
    }
    const cv::Size window(AspectImage::kChanceWindows[level], AspectImage::kChanceWindows[level]);
    cv::blur(sum, sum, window, cv::Point(-1, -1), cv::BORDER_REPLICATE);
    cv::blur(count, count, window, cv::Point(-1, -1), cv::BORDER_REPLICATE);
    cv::divide(sum, count, sum);
    cv::Mat out(
        image->chance_height,
        image->chance_width,
        CV_8U,
        image->chance.data() + static_cast<std::size_t>(level * kAspectBins + bin) * blocks);
    sum.convertTo(out, CV_8U, 255.0);
  }
}

void FillTexture(AspectImage* image) {
  const std::size_t blocks = static_cast<std::size_t>(image->chance_width) * image->chance_height;
  image->texture.resize(blocks);
  for (std::size_t b = 0; b < blocks; ++b) {
    int sum = 0;
    for (int bin = 0; bin < kAspectBins; ++bin) sum += image->chance[bin * blocks + b];
    image->texture[b] = static_cast<std::uint8_t>(sum / kAspectBins);
  }
}

}  // namespace

void FillAspectMaps(const AspectImageOptions& options, AspectImage* image) {
  const std::size_t cells = static_cast<std::size_t>(image->width) * image->height;
  image->half_width = (image->width + 1) / 2;
  image->half_height = (image->height + 1) / 2;
  image->distance.resize(cells * kAspectBins);
  image->half_distance.resize(static_cast<std::size_t>(image->half_width) * image->half_height *
                              kAspectBins);
  image->chance_width =
      (image->width + AspectImage::kChanceBlockPx - 1) / AspectImage::kChanceBlockPx;
  image->chance_height =
      (image->height + AspectImage::kChanceBlockPx - 1) / AspectImage::kChanceBlockPx;
  image->chance.resize(static_cast<std::size_t>(AspectImage::kChanceLevels) * kAspectBins *
                       image->chance_width * image->chance_height);
  std::vector<float> directions;
  directions.reserve(image->edges.size());
  for (const ImageEdgePoint& e : image->edges) {
    float angle = std::atan2(e.normal.x(), -e.normal.y());
    angle = angle < 0 ? angle + kPi : angle;
    directions.push_back(angle >= kPi ? angle - kPi : angle);
  }
  ParallelFor(kAspectBins, options.threads, [&](int bin) {
    FillBin(bin, options.bin_reach_rad, directions, image);
    FillChance(bin, image);
  });
  FillTexture(image);
}

AspectImage WithoutEdges(const AspectImage& image,
                         const std::vector<bool>& dropped,
                         const AspectImageOptions& options) {
  AspectImage out;
  out.image_width = image.image_width;
  out.image_height = image.image_height;
  out.width = image.width;
  out.height = image.height;
  out.working_from_image = image.working_from_image;
  out.ground = image.ground;
  for (std::size_t i = 0; i < image.edges.size(); ++i) {
    if (!dropped[i]) out.edges.push_back(image.edges[i]);
  }
  FillAspectMaps(options, &out);
  return out;
}

}  // namespace horopter
