#include "server/vision/matching/plane_homography.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <opencv2/imgproc.hpp>
#include <set>
#include <utility>

#include "server/base/stop_scope.h"

namespace horopter {
namespace {

// Blobs of several sizes.
cv::Mat Texture(int width, int height) {
  cv::Mat noise(height, width, CV_8UC1), fine, coarse, out;
  cv::RNG random(3);
  random.fill(noise, cv::RNG::UNIFORM, 0, 256);
  cv::GaussianBlur(noise, fine, cv::Size(), 3.0);
  cv::GaussianBlur(noise, coarse, cv::Size(), 7.0);
  cv::addWeighted(fine, 4.0, coarse, 8.0, -12.0 * 128.0 + 128.0, out);
  return out;
}

TEST(DetectPlaneKeypoints, OfALargeImageAreThoseOfItsPartsOnceEach) {
  const cv::Mat image = Texture(1300, 980);
  MatchingOptions options;
  options.max_keypoints = 100000;
  const KeypointSet whole = DetectPlaneKeypoints(image, 1.0, options);
  ASSERT_GT(whole.size(), 1000);
  // Found again in a part about the middle, where the tiles meet, that is searched in one.
  const cv::Rect part(400, 240, 500, 500);
  constexpr int kInside = 80;
  const KeypointSet again = DetectPlaneKeypoints(image(part).clone(), 1.0, options);
  int sought = 0, found = 0;
  for (const Eigen::Vector2d& p : again.points) {
    if (p.x() < kInside || p.y() < kInside || p.x() > part.width - kInside ||
        p.y() > part.height - kInside)
      continue;
    ++sought;
    const Eigen::Vector2d at = p + Eigen::Vector2d(part.x, part.y);
    found += std::any_of(whole.points.begin(), whole.points.end(), [&](const Eigen::Vector2d& q) {
      return (q - at).norm() < 0.5;
    });
  }
  EXPECT_GT(sought, 100);
  EXPECT_GE(found, 0.95 * sought);
  // Second orientations share their place, but no place has more than a few.
  std::multiset<std::pair<double, double>> places;
  for (const Eigen::Vector2d& p : whole.points) places.emplace(p.x(), p.y());
  for (const auto& place : places) EXPECT_LE(places.count(place), 4u);
}

TEST(DetectPlaneKeypoints, OfALargeImageAreTheStrongestOfAllParts) {
  cv::Mat image = Texture(1300, 980);
  // The left half is faint.
  cv::Mat left = image.colRange(0, 650);
  left = left * 0.25 + 96;
  MatchingOptions options;
  options.max_keypoints = 200;
  const KeypointSet strongest = DetectPlaneKeypoints(image, 1.0, options);
  ASSERT_EQ(strongest.size(), 200);
  const auto right = std::count_if(strongest.points.begin(),
                                   strongest.points.end(),
                                   [](const Eigen::Vector2d& p) { return p.x() > 640.0; });
  EXPECT_GE(right, 195);
}

TEST(DetectPlaneKeypoints, TheWorkMayStopBetweenTheParts) {
  const cv::Mat image = Texture(1300, 980);
  int looks = 0;
  const StopRequested at_third = [&] { return ++looks == 3; };
  const StopScope scope(at_third);
  EXPECT_THROW(DetectPlaneKeypoints(image, 1.0, MatchingOptions()), WorkStopped);
}

}  // namespace
}  // namespace horopter
