#include "server/vision/recognition/aspects/attention.h"

#include <algorithm>
#include <cmath>
#include <opencv2/imgproc.hpp>

#include "server/base/stop_scope.h"

namespace horopter {
namespace {

// The image is looked at in so many pixels of width: things of 1.5 % have ten of them.
constexpr int kWidthPx = 640;
constexpr double kSmoothedPx = 1.0;
// The surroundings are a median over a sixth of the width each way, of every fourth pixel: things
// of less than an eighth have no say in it.
constexpr int kStep = 4, kAroundSteps = 41, kSpreadSteps = 61;
constexpr double kAroundSmooth = 6.0;
// What differs by so much: levels of lightness, and of colour; and so many times what the
// surroundings themselves differ by (median), which grain does.
constexpr double kLeastLevels = 7.0, kLeastColour = 5.0, kSpreads = 3.5;
constexpr double kMostClear = 4.0;  // thresholds; clearer is not better
constexpr int kClosedPx = 3;
constexpr int kEdgeReachPx = 2;    // edges of one thing are nearer than twice these
constexpr double kSame = 0.7;      // overlap (of the union) of windows that are one
constexpr double kRoomSide = 0.2;  // share of the width from which on nothing is gained by a window

cv::Mat Quarter(const cv::Mat& channel) {
  cv::Mat out;
  cv::resize(channel, out, {}, 1.0 / kStep, 1.0 / kStep, cv::INTER_AREA);
  return out;
}

// The larger of `a` and what is there.
void Raise(const cv::Mat& a, cv::Mat* most) {
  cv::max(a, *most, *most);
}

// How clearly each pixel differs from its surroundings, in thresholds (1: just so).
cv::Mat Difference(const cv::Mat& small) {
  cv::Mat lab;
  if (small.channels() == 3) {
    cv::cvtColor(small, lab, cv::COLOR_BGR2Lab);
  } else {
    lab = small;
  }
  cv::GaussianBlur(lab, lab, {}, kSmoothedPx);
  std::vector<cv::Mat> channels;
  cv::split(lab, channels);
  cv::Mat most(small.size(), CV_32F, cv::Scalar(0.0));
  for (std::size_t c = 0; c < channels.size(); ++c) {
    LeaveIfStopped();
    cv::Mat around, spread, difference;
    cv::medianBlur(Quarter(channels[c]), around, kAroundSteps);
    cv::GaussianBlur(around, around, {}, kAroundSmooth);
    cv::resize(around, around, small.size(), 0, 0, cv::INTER_LINEAR);
    cv::absdiff(channels[c], around, difference);
    cv::medianBlur(Quarter(difference), spread, kSpreadSteps);
    cv::resize(spread, spread, small.size(), 0, 0, cv::INTER_LINEAR);
    spread.convertTo(spread, CV_32F, kSpreads);
    cv::max(spread, cv::Scalar(c == 0 ? kLeastLevels : kLeastColour), spread);
    difference.convertTo(difference, CV_32F);
    cv::divide(difference, spread, difference);
    Raise(difference, &most);
  }
  return most;
}

double Overlap(const ImageBox& a, const ImageBox& b) {
  const ImageBox both = a.intersection(b);
  if (both.isEmpty()) return 0.0;
  return both.volume() / (a.volume() + b.volume() - both.volume());
}

// Connected pixels of the mask whose box is of a size that is looked for, added to `windows`.
void AddComponents(const cv::Mat& mask,
                   const cv::Mat& difference,
                   double image_from_small,
                   const AttentionOptions& options,
                   std::vector<AttentionWindow>* windows) {
  cv::Mat labels, stats, centers;
  const int n = cv::connectedComponentsWithStats(mask, labels, stats, centers, 8);
  std::vector<double> clear(n, 0.0);
  for (int y = 0; y < mask.rows; ++y) {
    const int* label = labels.ptr<int>(y);
    const float* d = difference.ptr<float>(y);
    for (int x = 0; x < mask.cols; ++x) clear[label[x]] += std::min<double>(d[x], kMostClear);
  }
  for (int i = 1; i < n; ++i) {
    const int w = stats.at<int>(i, cv::CC_STAT_WIDTH), h = stats.at<int>(i, cv::CC_STAT_HEIGHT);
    const int area = stats.at<int>(i, cv::CC_STAT_AREA), side = std::max(w, h);
    const double share = static_cast<double>(side) / mask.cols;
    if (share < options.least_side || share > options.most_side) continue;
    if (area < options.least_fill * w * h) continue;
    const Eigen::Vector2d from(stats.at<int>(i, cv::CC_STAT_LEFT),
                               stats.at<int>(i, cv::CC_STAT_TOP));
    const Eigen::Vector2d grown = Eigen::Vector2d::Constant(options.margin * side);
    ImageBox box((from - grown).array() * image_from_small - 0.5,
                 (from + Eigen::Vector2d(w, h) + grown).array() * image_from_small - 0.5);
    const double gain = clear[i] / area * std::min(3.0, kRoomSide / share);
    windows->push_back({box, gain});
  }
}

// The edges of the searched image, wide enough to meet where they are of one thing.
cv::Mat EdgeMask(const AspectImage& searched, const cv::Size& size, double image_from_small) {
  cv::Mat mask(size, CV_8U, cv::Scalar(0));
  for (const ImageEdgePoint& e : searched.edges) {
    const Eigen::Vector2d at =
        (OriginalPixel(searched, e.point.cast<double>()).array() + 0.5) / image_from_small;
    const int x = static_cast<int>(at.x()), y = static_cast<int>(at.y());
    if (x >= 0 && y >= 0 && x < size.width && y < size.height) mask.at<std::uint8_t>(y, x) = 1;
  }
  const int side = 2 * kEdgeReachPx + 1;
  cv::dilate(mask, mask, cv::getStructuringElement(cv::MORPH_ELLIPSE, {side, side}));
  return mask;
}

}  // namespace

std::vector<AttentionWindow> FindWindows(const cv::Mat& image,
                                         const AspectImage& searched,
                                         const AttentionOptions& options) {
  if (image.empty() || (image.type() != CV_8UC1 && image.type() != CV_8UC3)) return {};
  const double image_from_small = std::max(1.0, static_cast<double>(image.cols) / kWidthPx);
  cv::Mat small;
  cv::resize(image, small, {}, 1.0 / image_from_small, 1.0 / image_from_small, cv::INTER_AREA);
  LeaveIfStopped();
  const cv::Mat difference = Difference(small);
  cv::Mat differs;
  cv::compare(difference, cv::Scalar(1.0), differs, cv::CMP_GT);
  cv::morphologyEx(differs, differs, cv::MORPH_OPEN, cv::Mat::ones(2, 2, CV_8U));
  cv::morphologyEx(differs, differs, cv::MORPH_CLOSE, cv::Mat::ones(kClosedPx, kClosedPx, CV_8U));
  std::vector<AttentionWindow> found, out;
  AddComponents(differs, difference, image_from_small, options, &found);
  AddComponents(EdgeMask(searched, small.size(), image_from_small),
                difference,
                image_from_small,
                options,
                &found);
  std::stable_sort(
      found.begin(), found.end(), [](const auto& a, const auto& b) { return a.gain > b.gain; });
  const ImageBox whole = WholeImage(image.cols, image.rows);
  for (AttentionWindow& w : found) {
    if (std::ssize(out) >= options.most_windows) break;
    w.box = w.box.intersection(whole);
    const bool known = std::any_of(
        out.begin(), out.end(), [&](const auto& o) { return Overlap(o.box, w.box) > kSame; });
    if (!known && !w.box.isEmpty()) out.push_back(w);
  }
  return out;
}

}  // namespace horopter
