#include "server/vision/features/keypoints.h"

#include <algorithm>
#include <cmath>
#include <numeric>
#include <opencv2/features2d.hpp>

#include "server/base/stop_scope.h"

namespace horopter {
namespace {

// Larger images are searched for keypoints in tiles, with a margin that the patches of all but the
// largest keypoints fit into.
constexpr int kWholePixels = 400000;
constexpr int kTileWidth = 640;
constexpr int kTileHeight = 480;
constexpr int kTileMargin = 48;
constexpr float kRootLength = 512.0f;  // of a descriptor of roots; its largest entries are 255

struct Keypoints {
  std::vector<cv::KeyPoint> points;
  cv::Mat descriptors;  // a row each
};

// Empty for images too small for one octave.
Keypoints Sift(const cv::Mat& grey, const cv::Mat& within, const KeypointOptions& options) {
  Keypoints found;
  try {
    const auto sift = cv::SIFT::create(options.max_keypoints, 3, options.contrast, 10.0, 1.6);
    sift->detectAndCompute(grey, within, found.points, found.descriptors);
  } catch (const cv::Exception&) {
    return {};
  }
  return found;
}

// The strongest of all tiles, each searched with a margin: what SIFT does to a whole image at a
// time would keep a call that is cancelled.
Keypoints SiftInTiles(const cv::Mat& grey, const cv::Mat& within, const KeypointOptions& options) {
  const int across = (grey.cols + kTileWidth - 1) / kTileWidth;
  const int down = (grey.rows + kTileHeight - 1) / kTileHeight;
  std::vector<cv::KeyPoint> points;
  cv::Mat descriptors;
  for (int tile = 0; tile < across * down; ++tile) {
    const int i = tile % across, j = tile / across;
    const cv::Rect core(cv::Point(i * grey.cols / across, j * grey.rows / down),
                        cv::Point((i + 1) * grey.cols / across, (j + 1) * grey.rows / down));
    const cv::Rect searched = cv::Rect(core.tl() - cv::Point(kTileMargin, kTileMargin),
                                       core.br() + cv::Point(kTileMargin, kTileMargin)) &
                              cv::Rect(cv::Point(), grey.size());
    LeaveIfStopped();
    const Keypoints found =
        Sift(grey(searched).clone(), within.empty() ? within : within(searched).clone(), options);
    for (int k = 0; k < found.descriptors.rows; ++k) {
      cv::KeyPoint point = found.points[k];
      point.pt += cv::Point2f(searched.tl());
      // A point between two tiles belongs to one.
      if (!cv::Rect2f(core).contains(point.pt + cv::Point2f(0.5f, 0.5f))) continue;
      points.push_back(point);
      descriptors.push_back(found.descriptors.row(k));
    }
  }
  std::vector<int> order(points.size());
  std::iota(order.begin(), order.end(), 0);
  std::stable_sort(order.begin(), order.end(), [&](int a, int b) {
    return points[a].response > points[b].response;
  });
  if (order.size() > static_cast<size_t>(options.max_keypoints))
    order.resize(options.max_keypoints);
  Keypoints strongest;
  for (const int k : order) {
    strongest.points.push_back(points[k]);
    strongest.descriptors.push_back(descriptors.row(k));
  }
  return strongest;
}

}  // namespace

KeypointSet DetectKeypoints(const cv::Mat& grey,
                            const cv::Mat& within,
                            const KeypointOptions& options) {
  KeypointSet set;
  const bool large = static_cast<int>(grey.total()) > kWholePixels;
  const auto [keypoints, descriptors] =
      large ? SiftInTiles(grey, within, options) : Sift(grey, within, options);
  const int n = std::min<int>(descriptors.rows, options.max_keypoints);
  set.points.reserve(n);
  set.descriptors.resize(static_cast<size_t>(n) * kDescriptorLength);
  set.squared_norms.resize(n);
  for (int i = 0; i < n; ++i) {
    set.points.emplace_back(keypoints[i].pt.x, keypoints[i].pt.y);
    const float* from = descriptors.ptr<float>(i);
    std::int16_t* to = &set.descriptors[static_cast<size_t>(i) * kDescriptorLength];
    const float sum = options.root ? std::accumulate(from, from + kDescriptorLength, 0.0f) : 0.0f;
    std::int32_t norm = 0;
    for (int k = 0; k < kDescriptorLength; ++k) {
      const float value =
          sum > 0.0f ? kRootLength * std::sqrt(std::max(0.0f, from[k]) / sum) : from[k];
      to[k] = static_cast<std::int16_t>(std::clamp(value, 0.0f, 255.0f) + 0.5f);
      norm += to[k] * to[k];
    }
    set.squared_norms[i] = norm;
  }
  return set;
}

}  // namespace horopter
