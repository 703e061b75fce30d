// Anti-aliased test images of known geometry.
#pragma once

#include <Eigen/Core>
#include <opencv2/core.hpp>
#include <opencv2/imgproc.hpp>
#include <random>
#include <vector>

namespace horopter {

struct ShapeRenderOptions {
  int width = 320;
  int height = 240;
  cv::Scalar background = cv::Scalar(60, 60, 60);
  cv::Scalar foreground = cv::Scalar(150, 150, 150);
  double blur_sigma = 0.8;
  double noise_sigma = 0.0;
};

namespace rendered_shapes_internal {

constexpr int kSuper = 8;  // samples per pixel and direction
constexpr int kShift = 8;  // fixed-point bits of OpenCV's drawing

// Pixel centres are integers, so (0, 0) is the middle of a kSuper x kSuper block.
inline cv::Point ToSuper(const Eigen::Vector2d& p) {
  const Eigen::Vector2d q = ((p.array() + 0.5) * kSuper - 0.5) * (1 << kShift);
  return {static_cast<int>(std::lround(q.x())), static_cast<int>(std::lround(q.y()))};
}

inline cv::Mat Finish(const cv::Mat& large, const ShapeRenderOptions& options, std::mt19937* rng) {
  cv::Mat image;
  cv::resize(large, image, cv::Size(options.width, options.height), 0, 0, cv::INTER_AREA);
  image.convertTo(image, CV_32F);
  if (options.blur_sigma > 0.0) {
    cv::GaussianBlur(image, image, cv::Size(), options.blur_sigma);
  }
  if (options.noise_sigma > 0.0) {
    std::normal_distribution<float> noise(0.0f, static_cast<float>(options.noise_sigma));
    auto* values = image.ptr<float>();
    for (size_t i = 0; i < image.total() * image.channels(); ++i) {
      values[i] += noise(*rng);
    }
  }
  cv::Mat out;
  image.convertTo(out, CV_8U);
  return out;
}

}  // namespace rendered_shapes_internal

// BGR image of a filled polygon.
inline cv::Mat RenderPolygon(const std::vector<Eigen::Vector2d>& vertices,
                             const ShapeRenderOptions& options,
                             std::mt19937* rng) {
  namespace internal = rendered_shapes_internal;
  cv::Mat large(options.height * internal::kSuper,
                options.width * internal::kSuper,
                CV_8UC3,
                options.background);
  std::vector<cv::Point> points;
  for (const Eigen::Vector2d& v : vertices) {
    points.push_back(internal::ToSuper(v));
  }
  cv::fillPoly(large,
               std::vector<std::vector<cv::Point>>{points},
               options.foreground,
               cv::LINE_8,
               internal::kShift);
  return internal::Finish(large, options, rng);
}

// The points of a finely sampled ellipse, to be rendered as a polygon.
inline std::vector<Eigen::Vector2d> EllipsePolygon(const Eigen::Vector2d& center,
                                                   double semi_major,
                                                   double semi_minor,
                                                   double angle) {
  std::vector<Eigen::Vector2d> points;
  for (int k = 0; k < 360; ++k) {
    const double t = k * CV_PI / 180.0;
    const Eigen::Vector2d q(semi_major * std::cos(t), semi_minor * std::sin(t));
    points.push_back(center + Eigen::Vector2d(std::cos(angle) * q.x() - std::sin(angle) * q.y(),
                                              std::sin(angle) * q.x() + std::cos(angle) * q.y()));
  }
  return points;
}

}  // namespace horopter
