#include "server/vision/matching/matching_view.h"

#include <cmath>
#include <limits>
#include <opencv2/imgproc.hpp>

namespace horopter {
namespace {

// Px from the segment: beyond its blur, to where it may leave the surface.
constexpr double kRowPx[SideStrip::kRows] = {2.0, 4.5, 8.0};
constexpr float kMinDeviation = 3.0f;  // grey levels, of a strip

float SampleGrey(const cv::Mat& grey, const Eigen::Vector2d& p) {
  const int x = std::clamp(static_cast<int>(std::lround(p.x())), 0, grey.cols - 1);
  const int y = std::clamp(static_cast<int>(std::lround(p.y())), 0, grey.rows - 1);
  return grey.at<uint8_t>(y, x);
}

SideStrip SampleStrip(const cv::Mat& grey, const Segment& segment, double side) {
  const Eigen::Vector2d along = segment.end - segment.start;
  const Eigen::Vector2d right(-along.y() / along.norm(), along.x() / along.norm());
  SideStrip strip;
  for (int r = 0; r < SideStrip::kRows; ++r) {
    for (int k = 0; k < SideStrip::kAlong; ++k) {
      const double s = (k + 0.5) / SideStrip::kAlong;
      strip.values[r * SideStrip::kAlong + k] =
          SampleGrey(grey, segment.start + s * along + side * kRowPx[r] * right);
    }
  }
  strip.values.array() -= strip.values.mean();
  const float norm = strip.values.norm();
  strip.flat = norm < kMinDeviation * std::sqrt(static_cast<float>(strip.values.size()));
  if (!strip.flat) strip.values /= norm;
  return strip;
}

}  // namespace

MatchingView PrepareMatchingView(const cv::Mat& image, const ImageFeatures& features) {
  MatchingView view;
  view.features = &features;
  view.graph = BuildFeatureGraph(features, FeatureGraphOptions());
  cv::Mat grey = image;
  if (image.channels() == 3) cv::cvtColor(image, grey, cv::COLOR_BGR2GRAY);
  cv::Mat smooth;  // nearest-pixel sampling needs no finer image
  cv::GaussianBlur(grey, smooth, cv::Size(), 1.2);
  view.strips.reserve(features.segments.size());
  for (const Segment& segment : features.segments) {
    view.strips.push_back({SampleStrip(smooth, segment, -1.0), SampleStrip(smooth, segment, 1.0)});
  }
  view.smooth = SmoothForPatches(image);
  view.patches = SampleJunctionPatches(view.smooth, features.junctions);
  return view;
}

float StripCorrelation(const SideStrip& a, const SideStrip& b, bool reversed) {
  if (a.flat || b.flat) return std::numeric_limits<float>::quiet_NaN();
  if (!reversed) return a.values.dot(b.values);
  float sum = 0.0f;
  for (int r = 0; r < SideStrip::kRows; ++r) {
    const int row = r * SideStrip::kAlong;
    sum += a.values.segment<SideStrip::kAlong>(row).dot(
        b.values.segment<SideStrip::kAlong>(row).reverse());
  }
  return sum;
}

}  // namespace horopter
