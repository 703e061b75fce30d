#include "server/vision/recognition/aspects/aspect_image.h"

#include <algorithm>
#include <cmath>
#include <opencv2/imgproc.hpp>

#include "absl/strings/str_cat.h"
#include "server/base/parallel_for.h"
#include "server/vision/recognition/aspects/edge_pixels.h"

namespace horopter {
namespace {

constexpr float kPi = 3.14159265358979f;

cv::Mat AsBgr(const cv::Mat& image) {
  if (image.depth() != CV_8U) return {};
  cv::Mat bgr;
  switch (image.channels()) {
    case 1: cv::cvtColor(image, bgr, cv::COLOR_GRAY2BGR); return bgr;
    case 3: return image;
    case 4: cv::cvtColor(image, bgr, cv::COLOR_BGRA2BGR); return bgr;
    default: return {};
  }
}

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
  cv::Mat full(image->height,
               image->width,
               CV_8U,
               image->distance.data() +
                   static_cast<std::size_t>(bin) * image->width * image->height);
  distance.convertTo(full, CV_8U, AspectImage::kDistanceScale);
  cv::Mat half(image->half_height,
               image->half_width,
               CV_8U,
               image->half_distance.data() +
                   static_cast<std::size_t>(bin) * image->half_width * image->half_height);
  cv::resize(full, half, half.size(), 0, 0, cv::INTER_AREA);
}

void FillMaps(const AspectImageOptions& options, AspectImage* image) {
  const std::size_t cells = static_cast<std::size_t>(image->width) * image->height;
  image->half_width = (image->width + 1) / 2;
  image->half_height = (image->height + 1) / 2;
  image->distance.resize(cells * kAspectBins);
  image->half_distance.resize(static_cast<std::size_t>(image->half_width) * image->half_height *
                              kAspectBins);
  std::vector<float> directions;
  directions.reserve(image->edges.size());
  for (const ImageEdgePoint& e : image->edges) {
    float angle = std::atan2(e.normal.x(), -e.normal.y());
    angle = angle < 0 ? angle + kPi : angle;
    directions.push_back(angle >= kPi ? angle - kPi : angle);
  }
  ParallelFor(kAspectBins, options.threads, [&](int bin) {
    FillBin(bin, options.bin_reach_rad, directions, image);
  });
}

}  // namespace

absl::Status Validate(const AspectImageOptions& o) {
  const auto bad = [](const char* field) {
    return absl::InvalidArgumentError(absl::StrCat("AspectImageOptions.", field));
  };
  if (o.max_width_px < 64) return bad("max_width_px");
  if (!(o.sigma_px > 0)) return bad("sigma_px");
  if (!(o.low_threshold > 0)) return bad("low_threshold");
  if (!(o.high_threshold >= o.low_threshold)) return bad("high_threshold");
  if (!(o.noise_factor >= 0)) return bad("noise_factor");
  if (o.min_component_px < 1) return bad("min_component_px");
  if (!(o.max_gap_px >= 0)) return bad("max_gap_px");
  if (!(o.bin_reach_rad > 0.14)) return bad("bin_reach_rad");
  if (o.threads < 1) return bad("threads");
  return absl::OkStatus();
}

PinholeCamera WorkingCamera(const AspectImage& image, const PinholeCamera& camera) {
  const double s = image.working_from_image;
  PinholeCamera out = camera;
  out.width = image.width;
  out.height = image.height;
  out.focal_px *= s;
  out.cx = (camera.cx + 0.5) * s - 0.5;
  out.cy = (camera.cy + 0.5) * s - 0.5;
  return out;
}

PinholeCamera OriginalCamera(const AspectImage& image, const PinholeCamera& working) {
  const double s = 1.0 / image.working_from_image;
  PinholeCamera out = working;
  out.width = image.image_width;
  out.height = image.image_height;
  out.focal_px *= s;
  out.cx = (working.cx + 0.5) * s - 0.5;
  out.cy = (working.cy + 0.5) * s - 0.5;
  return out;
}

AspectImage MakeAspectImage(const cv::Mat& image, const AspectImageOptions& options) {
  AspectImage out;
  cv::Mat bgr = image.empty() ? cv::Mat() : AsBgr(image);
  if (bgr.empty()) return out;
  if (bgr.cols > options.max_width_px) {
    out.working_from_image = static_cast<double>(options.max_width_px) / bgr.cols;
    const int height =
        std::max(1, static_cast<int>(std::lround(bgr.rows * out.working_from_image)));
    cv::Mat small;
    cv::resize(bgr, small, cv::Size(options.max_width_px, height), 0, 0, cv::INTER_AREA);
    bgr = small;
  }
  out.image_width = image.cols;
  out.image_height = image.rows;
  out.width = bgr.cols;
  out.height = bgr.rows;
  out.edges = DetectEdgePoints(bgr, options);
  std::vector<Eigen::Vector2f> points;
  points.reserve(out.edges.size());
  for (const ImageEdgePoint& e : out.edges) points.push_back(e.point);
  // One a cell already: indices of the raster are those of the edges.
  PointRaster raster = MakePointRaster(out.width, out.height, points);
  out.contours = TraceContours(raster, options.max_gap_px);
  out.edge_at = std::move(raster.at);
  FillMaps(options, &out);
  return out;
}

}  // namespace horopter
