#include "server/vision/recognition/aspects/aspect_maps.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <numeric>
#include <opencv2/imgproc.hpp>

#include "server/base/constants.h"
#include "server/base/parallel_for.h"
#include "server/vision/recognition/aspects/capped_distance.h"

namespace horopter {
namespace {

static_assert(AspectImage::kDistanceScale == 8.0f);     // of FillCappedDistance
constexpr int kSide = AspectImage::kChanceBlockPx / 2;  // of a block, half cells

// Both maps of one bin.
void FillBin(int bin, double reach_rad, const std::vector<float>& directions, AspectImage* image) {
  const std::size_t cells = static_cast<std::size_t>(image->width) * image->height;
  std::vector<std::uint8_t> marked(cells, 0);
  const float center = bin * kPiF / kAspectBins;
  for (std::size_t i = 0; i < image->edges.size(); ++i) {
    float off = std::abs(directions[i] - center);
    off = std::min(off, kPiF - off);
    if (off > reach_rad) continue;
    const Eigen::Vector2f& p = image->edges[i].point;
    marked[image->Cell(static_cast<int>(std::lround(p.x())),
                       static_cast<int>(std::lround(p.y())))] = 1;
  }
  std::uint8_t* distance = image->distance.data() + bin * cells;
  FillCappedDistance(marked, image->width, image->height, {distance, cells});
  const cv::Mat full(image->height, image->width, CV_8U, distance);
  cv::Mat half(image->half_height,
               image->half_width,
               CV_8U,
               image->half_distance.data() +
                   static_cast<std::size_t>(bin) * image->half_width * image->half_height);
  cv::resize(full, half, half.size(), 0, 0, cv::INTER_AREA);
}

cv::Mat WindowMean(const cv::Mat& blocks, int level) {
  const cv::Size window(AspectImage::kChanceWindows[level], AspectImage::kChanceWindows[level]);
  cv::Mat mean;
  cv::blur(blocks, mean, window, cv::Point(-1, -1), cv::BORDER_REPLICATE);
  return mean;
}

// Sums of max(0, tau - d) over the blocks, both in steps; half: distances, half cells of the image.
cv::Mat BlockSums(const AspectImage& image, const std::uint8_t* half, int tau) {
  cv::Mat sums(image.chance_height, image.chance_width, CV_32F);
  std::vector<std::uint16_t> columns(image.half_width);  // of a row of blocks: at most 8 x 255
  for (int block_y = 0; block_y < image.chance_height; ++block_y) {
    std::fill(columns.begin(), columns.end(), 0);
    const int end_y = std::min((block_y + 1) * kSide, image.half_height);
    for (int y = block_y * kSide; y < end_y; ++y) {
      const std::uint8_t* row = half + static_cast<std::size_t>(y) * image.half_width;
      for (int x = 0; x < image.half_width; ++x)
        columns[x] = static_cast<std::uint16_t>(columns[x] + std::max(0, tau - row[x]));
    }
    for (int block_x = 0; block_x < image.chance_width; ++block_x) {
      const auto end_x = columns.begin() + std::min((block_x + 1) * kSide, image.half_width);
      const int sum = std::accumulate(columns.begin() + block_x * kSide, end_x, 0);
      sums.at<float>(block_y, block_x) = static_cast<float>(sum);
    }
  }
  return sums;
}

// Mean half cells of a block over the window of each level.
std::array<cv::Mat, AspectImage::kChanceLevels> MeanCounts(const AspectImage& image) {
  cv::Mat counts(image.chance_height, image.chance_width, CV_32F);
  for (int y = 0; y < counts.rows; ++y) {
    for (int x = 0; x < counts.cols; ++x) {
      counts.at<float>(y, x) = static_cast<float>(std::min(kSide, image.half_height - y * kSide) *
                                                  std::min(kSide, image.half_width - x * kSide));
    }
  }
  std::array<cv::Mat, AspectImage::kChanceLevels> means;
  for (int level = 0; level < AspectImage::kChanceLevels; ++level)
    means[level] = WindowMean(counts, level);
  return means;
}

// Chance levels of one bin: block means of the support, then means over the window.
void FillChance(int bin,
                const std::array<cv::Mat, AspectImage::kChanceLevels>& mean_counts,
                AspectImage* image) {
  const std::size_t blocks = static_cast<std::size_t>(image->chance_width) * image->chance_height;
  const std::uint8_t* half = image->half_distance.data() +
                             static_cast<std::size_t>(bin) * image->half_width * image->half_height;
  for (int level = 0; level < AspectImage::kChanceLevels; ++level) {
    const float tau = AspectImage::kChanceTausPx[level] * AspectImage::kDistanceScale;
    cv::Mat mean = WindowMean(BlockSums(*image, half, static_cast<int>(tau)), level);
    cv::divide(mean, mean_counts[level], mean);
    cv::Mat out(
        image->chance_height,
        image->chance_width,
        CV_8U,
        image->chance.data() + static_cast<std::size_t>(level * kAspectBins + bin) * blocks);
    mean.convertTo(out, CV_8U, 255.0 / tau);
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

void FillAspectMaps(int threads, AspectImage* image) {
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
    angle = angle < 0 ? angle + kPiF : angle;
    directions.push_back(angle >= kPiF ? angle - kPiF : angle);
  }
  const auto mean_counts = MeanCounts(*image);
  ParallelFor(kAspectBins, threads, [&](int bin) {
    FillBin(bin, kBinReachRad, directions, image);
    FillChance(bin, mean_counts, image);
  });
  FillTexture(image);
}

AspectImage WithoutEdges(const AspectImage& image, const std::vector<bool>& dropped) {
  AspectImage out;
  out.image_width = image.image_width;
  out.image_height = image.image_height;
  out.width = image.width;
  out.height = image.height;
  out.working_from_image = image.working_from_image;
  out.origin = image.origin;
  out.searched = image.searched;
  out.ground = image.ground;
  for (std::size_t i = 0; i < image.edges.size(); ++i) {
    if (!dropped[i]) out.edges.push_back(image.edges[i]);
  }
  FillAspectMaps(1, &out);
  return out;
}

}  // namespace horopter
