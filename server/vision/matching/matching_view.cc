#include "server/vision/matching/matching_view.h"

#include <cmath>
#include <limits>
#include <opencv2/imgproc.hpp>

#include "server/base/stop_scope.h"
#include "server/vision/features/image_strips.h"

namespace horopter {
namespace {

// Px from the segment: beyond its blur, to where it may leave the surface.
constexpr double kRowPx[SideStrip::kRows] = {2.0, 4.5, 8.0};
constexpr int kSegmentsPerLook = 256;  // at the stop flag
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

MatchingView PrepareMatchingView(const cv::Mat& image,
                                 const ImageFeatures& features,
                                 const FeatureGraphOptions& options) {
  MatchingView view;
  view.features = &features;
  view.graph = BuildFeatureGraph(features, options);
  const cv::Mat grey =
      image.channels() == 3 ? RecolourInStrips(image, cv::COLOR_BGR2GRAY, 1) : image;
  // Nearest-pixel sampling needs no finer image.
  const cv::Mat smooth = BlurInStrips(grey, cv::Size(), 1.2);
  view.strips.reserve(features.segments.size());
  StopPacer pacer(kSegmentsPerLook);
  for (const Segment& segment : features.segments) {
    pacer.Step();
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
