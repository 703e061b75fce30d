// Lines and junctions against rendered truth: beside OpenCV's LSD, and inside their own
// covariances.
#include <gtest/gtest.h>

#include <Eigen/LU>
#include <algorithm>
#include <opencv2/imgproc.hpp>
#include <random>

#include "server/vision/features/features.h"

namespace horopter {
namespace {

struct LineError {
  double angle_rad = 0.0;
  double offset_px = 0.0;  // at the middle of the found segment
  double length = 0.0;
};

LineError ErrorOf(const Eigen::Vector2d& start,
                  const Eigen::Vector2d& end,
                  const Eigen::Vector2d& a,
                  const Eigen::Vector2d& b) {
  const Eigen::Vector2d d = (end - start).normalized(), t = (b - a).normalized();
  const Eigen::Vector2d q = 0.5 * (start + end) - a;
  const double sine = d.x() * t.y() - d.y() * t.x();
  return {
      std::asin(std::clamp(sine, -1.0, 1.0)), t.x() * q.y() - t.y() * q.x(), (end - start).norm()};
}

// Longest of the segments that lie within 2 px and 5 degrees of a side; empty length when none.
LineError Longest(const std::vector<std::pair<Eigen::Vector2d, Eigen::Vector2d>>& segments,
                  const Eigen::Vector2d& a,
                  const Eigen::Vector2d& b,
                  int* index = nullptr) {
  LineError best;
  for (size_t i = 0; i < segments.size(); ++i) {
    const LineError error = ErrorOf(segments[i].first, segments[i].second, a, b);
    if (std::abs(error.angle_rad) < 0.087 && std::abs(error.offset_px) < 2.0 &&
        error.length > best.length) {
      best = error;
      if (index) *index = static_cast<int>(i);
    }
  }
  return best;
}

std::vector<Eigen::Vector2d> Quad(std::mt19937* rng) {
  std::uniform_real_distribution<double> u(0.0, 1.0);
  const Eigen::Vector2d center(150.0 + 20.0 * u(*rng), 110.0 + 20.0 * u(*rng));
  const double turn = 2.0 * CV_PI * u(*rng);
  std::vector<Eigen::Vector2d> quad;
  for (int k = 0; k < 4; ++k) {
    const double angle = turn + 0.5 * CV_PI * (k + 0.3 * (u(*rng) - 0.5));
    const double radius = 60.0 + 35.0 * u(*rng);
    quad.push_back(center + radius * Eigen::Vector2d(std::cos(angle), std::sin(angle)));
  }
  return quad;
}

// Grey image of a convex polygon, 8 x 8 samples per boundary pixel. (OpenCV's fillPoly also fills
// the boundary samples, which widens a shape by 0.06 px: too much here.)
cv::Mat RenderConvex(const std::vector<Eigen::Vector2d>& quad,
                     double noise_sigma,
                     double blur_sigma,
                     std::mt19937* rng) {
  cv::Mat image(240, 320, CV_32FC1);
  const auto depth =
      [&](const Eigen::Vector2d& p) {  // inside: positive distance to the nearest side
        double least = 1e9;
        for (size_t k = 0; k < quad.size(); ++k) {
          const Eigen::Vector2d t = (quad[(k + 1) % quad.size()] - quad[k]).normalized();
          const Eigen::Vector2d q = p - quad[k];
          least = std::min(least, t.x() * q.y() - t.y() * q.x());
        }
        return least;
      };
  for (int y = 0; y < image.rows; ++y) {
    for (int x = 0; x < image.cols; ++x) {
      const double d = depth({x, y});
      int inside = d > 0.0 ? 64 : 0;
      if (std::abs(d) < 1.0) {
        inside = 0;
        for (int s = 0; s < 64; ++s) {
          inside += depth({x + (s % 8 - 3.5) / 8.0, y + (s / 8 - 3.5) / 8.0}) > 0.0 ? 1 : 0;
        }
      }
      image.at<float>(y, x) = 60.0f + 90.0f * static_cast<float>(inside) / 64.0f;
    }
  }
  cv::GaussianBlur(image, image, cv::Size(), blur_sigma);
  std::normal_distribution<float> noise(0.0f, static_cast<float>(noise_sigma));
  if (noise_sigma > 0.0) {
    for (auto it = image.begin<float>(); it != image.end<float>(); ++it) *it += noise(*rng);
  }
  cv::Mat out;
  image.convertTo(out, CV_8U);
  return out;
}

std::vector<std::pair<Eigen::Vector2d, Eigen::Vector2d>> Ours(const ImageFeatures& features) {
  std::vector<std::pair<Eigen::Vector2d, Eigen::Vector2d>> out;
  for (const Segment& s : features.segments) out.emplace_back(s.start, s.end);
  return out;
}

// LSD's pixel centres are at half pixels in OpenCV 4.6; whichever convention favours it counts.
std::vector<std::pair<Eigen::Vector2d, Eigen::Vector2d>> Lsd(const cv::Mat& grey, double shift) {
  std::vector<cv::Vec4f> lines;
  cv::createLineSegmentDetector()->detect(grey, lines);
  std::vector<std::pair<Eigen::Vector2d, Eigen::Vector2d>> out;
  for (const cv::Vec4f& l : lines) {
    out.push_back(
        {Eigen::Vector2d(l[0] + shift, l[1] + shift), Eigen::Vector2d(l[2] + shift, l[3] + shift)});
  }
  return out;
}

double Rms(const std::vector<double>& values) {
  double square = 0.0;
  for (double v : values) square += v * v;
  return std::sqrt(square / static_cast<double>(values.size()));
}

double Median(std::vector<double> values) {
  std::nth_element(values.begin(), values.begin() + values.size() / 2, values.end());
  return values[values.size() / 2];
}

class NoiseSweep : public testing::TestWithParam<double> {};

TEST_P(NoiseSweep, LinesAreNoWorseThanLsdAndDeviationsAreHonest) {
  const double noise = GetParam();
  const unsigned seed = 101;
  SCOPED_TRACE(testing::Message() << "seed " << seed);
  std::mt19937 rng(seed);
  std::vector<double> angle, offset, lsd_angle, lsd_offset[2], junction;
  int lines = 0, in_angle = 0, in_offset = 0, corners = 0, in_ellipse = 0;
  for (int trial = 0; trial < 40; ++trial) {
    const std::vector<Eigen::Vector2d> quad = Quad(&rng);
    const cv::Mat grey = RenderConvex(quad, noise, 0.7 + 0.8 * (trial % 5) / 4.0, &rng);
    FeatureOptions linear;  // the quads are drawn linear in light
    linear.undo_response = false;
    const auto features = DetectFeatures(grey, linear);
    ASSERT_TRUE(features.ok());
    for (int k = 0; k < 4; ++k) {
      const Eigen::Vector2d &a = quad[k], &b = quad[(k + 1) % 4];
      int index = -1;
      const LineError own = Longest(Ours(*features), a, b, &index);
      const LineError peers[2] = {Longest(Lsd(grey, 0.0), a, b), Longest(Lsd(grey, -0.5), a, b)};
      ASSERT_GE(index, 0) << "side " << k << " of trial " << trial;
      angle.push_back(std::abs(own.angle_rad));
      offset.push_back(std::abs(own.offset_px));
      if (peers[0].length > 0.0) lsd_angle.push_back(std::abs(peers[0].angle_rad));
      for (int p = 0; p < 2; ++p) {
        if (peers[p].length > 0.0) lsd_offset[p].push_back(std::abs(peers[p].offset_px));
      }
      const Segment& s = features->segments[index];
      ++lines;
      in_angle += std::abs(own.angle_rad) <= 1.96 * s.angle_sigma_rad ? 1 : 0;
      in_offset += std::abs(own.offset_px) <= 1.96 * s.offset_sigma_px ? 1 : 0;
      for (const Junction& j : features->junctions) {
        const Eigen::Vector2d e = j.point - a;
        if (e.norm() < 3.0) {
          junction.push_back(e.norm());
          ++corners;
          in_ellipse += e.dot(j.covariance.inverse() * e) <= 5.991 ? 1 : 0;  // chi^2, 2, 95 %
          break;
        }
      }
    }
  }
  const double lsd_best = std::min(Median(lsd_offset[0]), Median(lsd_offset[1]));
  std::printf(
      "noise %.0f: angle %.5f (LSD %.5f) offset %.3f (LSD %.3f) junction rms %.3f of %d; in 95%%: "
      "angle %.3f offset %.3f junction %.3f\n",
      noise,
      Median(angle),
      Median(lsd_angle),
      Median(offset),
      lsd_best,
      Rms(junction),
      corners,
      1.0 * in_angle / lines,
      1.0 * in_offset / lines,
      1.0 * in_ellipse / corners);
  EXPECT_LE(Median(angle), Median(lsd_angle));
  EXPECT_LE(Median(offset), lsd_best);
  EXPECT_GE(corners, 150);
  if (noise <= 4.0) {
    EXPECT_LE(Rms(junction), 0.25);
  }
  EXPECT_GE(1.0 * in_angle / lines, 0.90);
  EXPECT_GE(1.0 * in_ellipse / corners, 0.90);
}

INSTANTIATE_TEST_SUITE_P(Sigma, NoiseSweep, testing::Values(0.0, 1.0, 2.0, 4.0, 6.0, 8.0));

}  // namespace
}  // namespace horopter
