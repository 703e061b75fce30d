#include "server/vision/matching/plane_links.h"

#include <gtest/gtest.h>

#include <Eigen/Dense>
#include <cmath>
#include <opencv2/core.hpp>
#include <opencv2/imgproc.hpp>
#include <string>

#include "server/vision/matching/homography.h"
#include "server/vision/matching/plane_homography.h"
#include "tests/support/textured_plane.h"

namespace horopter {
namespace {

constexpr int kWidth = 640, kHeight = 480;
constexpr double kFocalPx = 800.0;

std::vector<std::pair<int, int>> AllPairs(int views) {
  std::vector<std::pair<int, int>> pairs;
  for (int a = 0; a < views; ++a) {
    for (int b = a + 1; b < views; ++b) pairs.emplace_back(a, b);
  }
  return pairs;
}

FoundPlanes FindAll(const std::vector<cv::Mat>& images, int threads = 2) {
  MatchingOptions options;
  options.threads = threads;
  return FindPlanes(images, AllPairs(static_cast<int>(images.size())), options, {});
}

std::vector<PlaneHomography> Find(const std::vector<cv::Mat>& images, int threads = 2) {
  return FindAll(images, threads).planes;
}

// A flat picture larger than the images.
cv::Mat Picture(int seed) {
  cv::Mat picture;
  cv::resize(PlaneTexture(seed, 15.0), picture, cv::Size(1300, 1300), 0, 0, cv::INTER_CUBIC);
  return picture;
}

// The picture as seen under image_from_picture, with noise of its own.
cv::Mat See(const cv::Mat& picture,
            const Eigen::Matrix3d& image_from_picture,
            int noise_seed,
            const cv::Size& size = cv::Size(kWidth, kHeight)) {
  cv::Matx33d M;
  for (int r = 0; r < 3; ++r) {
    for (int c = 0; c < 3; ++c) M(r, c) = image_from_picture(r, c);
  }
  cv::Mat image, wide, noise(size, CV_32FC1);
  cv::warpPerspective(picture, image, M, size, cv::INTER_LINEAR, cv::BORDER_REFLECT);
  cv::RNG(noise_seed).fill(noise, cv::RNG::NORMAL, 0.0, 1.0);
  image.convertTo(wide, CV_32F);
  wide += noise;
  wide.convertTo(image, CV_8U);
  return image;
}

Eigen::Matrix3d Shift(double x, double y) {
  Eigen::Matrix3d T = Eigen::Matrix3d::Identity();
  T(0, 2) = x, T(1, 2) = y;
  return T;
}

// Pixels of a camera turned by R from those of the camera before; same centre of projection.
Eigen::Matrix3d Turned(const Eigen::Matrix3d& R) {
  Eigen::Matrix3d K;
  K << kFocalPx, 0, kWidth / 2.0, 0, kFocalPx, kHeight / 2.0, 0, 0, 1;
  return K * R * K.inverse();
}

// Largest distance of the two images of points of the image's middle, pixels.
double WorstDifference(const Eigen::Matrix3d& H, const Eigen::Matrix3d& truth) {
  double worst = 0.0;
  for (double x = 200; x <= 440; x += 60) {
    for (double y = 150; y <= 330; y += 60)
      worst = std::max(worst, (Transfer(H, {x, y}) - Transfer(truth, {x, y})).norm());
  }
  return worst;
}

void ExpectLink(const std::vector<cv::Mat>& images, const Eigen::Matrix3d& truth, double max_px) {
  const std::vector<PlaneHomography> planes = Find(images);
  ASSERT_EQ(planes.size(), 1u);
  EXPECT_LT(WorstDifference(planes[0].b_from_a, truth), max_px);
}

TEST(FindPlanes, IdenticalImagesAreLinkedByTheIdentity) {
  const cv::Mat image = See(Picture(1), Shift(-300, -400), 1);
  ExpectLink({image, image.clone()}, Eigen::Matrix3d::Identity(), 0.02);
}

TEST(FindPlanes, PureRotationGivesItsHomography) {
  const cv::Mat picture = Picture(2);
  for (const double angle : {0.05, 0.3, 1.2}) {
    SCOPED_TRACE(angle);
    const Eigen::Matrix3d R = (Eigen::AngleAxisd(angle, Eigen::Vector3d::UnitZ()) *
                               Eigen::AngleAxisd(0.06, Eigen::Vector3d::UnitY()))
                                  .toRotationMatrix();
    const Eigen::Matrix3d first = Shift(-330, -410);
    const Eigen::Matrix3d truth = Turned(R);
    ExpectLink({See(picture, first, 1), See(picture, truth * first, 2)}, truth, 0.3);
  }
}

TEST(FindPlanes, PureZoomGivesItsHomography) {
  const cv::Mat picture = Picture(3);
  for (const double zoom : {0.6, 1.25, 1.8}) {
    SCOPED_TRACE(zoom);
    const Eigen::Vector3d scale(zoom, zoom, 1.0);
    const Eigen::Matrix3d truth = Shift(kWidth / 2.0, kHeight / 2.0) * scale.asDiagonal() *
                                  Shift(-kWidth / 2.0, -kHeight / 2.0);
    const Eigen::Matrix3d first = Shift(-330, -410);
    ExpectLink({See(picture, first, 1), See(picture, truth * first, 2)}, truth, 0.4);
  }
}

TEST(FindPlanes, OddAndUnequalSizesAreExact) {
  const cv::Mat picture = Picture(4);
  const Eigen::Matrix3d first = Shift(-330, -410), truth = Shift(-23.5, 14.25);
  ExpectLink(
      {See(picture, first, 1, {641, 483}), See(picture, truth * first, 2, {599, 517})}, truth, 0.1);
}

TEST(FindPlanes, AnotherSceneIsNotLinked) {
  EXPECT_TRUE(
      Find({See(Picture(5), Shift(-300, -400), 1), See(Picture(6), Shift(-300, -400), 2)}).empty());
}

TEST(FindPlanes, AMirrorImageIsNotLinked) {
  const cv::Mat image = See(Picture(7), Shift(-300, -400), 1);
  for (const int axis : {0, 1}) {
    cv::Mat mirrored;
    cv::flip(image, mirrored, axis);
    EXPECT_TRUE(Find({image, mirrored}).empty());
  }
}

// One period looks like the next: what fits as well a period further on must not be believed.
TEST(FindPlanes, RepeatedStructureIsCalledAmbiguousAndNotLinked) {
  for (const int period : {24, 40, 80}) {
    for (const bool grid : {false, true}) {
      SCOPED_TRACE(std::to_string(period) + (grid ? " grid" : " checker"));
      cv::Mat picture(1300, 1300, CV_8UC1);
      for (int y = 0; y < picture.rows; ++y) {
        for (int x = 0; x < picture.cols; ++x) {
          const bool dark = grid ? x % period < 4 || y % period < 4
                                 : (x / (period / 2) + y / (period / 2)) % 2 == 0;
          picture.at<unsigned char>(y, x) = dark ? 110 : 140;
        }
      }
      cv::GaussianBlur(picture, picture, cv::Size(), 1.0);
      const Eigen::Matrix3d R =
          Eigen::AngleAxisd(0.06, Eigen::Vector3d(0.3, 1, 0.5).normalized()).toRotationMatrix();
      const Eigen::Matrix3d first = Shift(-330, -410), truth = Turned(R) * Shift(60, 40);
      const FoundPlanes found = FindAll({See(picture, first, 1), See(picture, truth * first, 2)});
      EXPECT_EQ(found.ambiguous_views, 2);
      EXPECT_TRUE(found.planes.empty());
    }
  }
}

TEST(FindPlanes, DoesNotDependOnThreads) {
  const cv::Mat picture = Picture(8);
  std::vector<cv::Mat> images;
  for (int v = 0; v < 4; ++v) images.push_back(See(picture, Shift(-300 - 25 * v, -400), v));
  const std::vector<PlaneHomography> one = Find(images, 1), three = Find(images, 3);
  ASSERT_EQ(one.size(), 6u);
  ASSERT_EQ(three.size(), 6u);
  for (size_t k = 0; k < one.size(); ++k) EXPECT_EQ(one[k].b_from_a, three[k].b_from_a);
}

TEST(FindPlanes, StopsWhenAsked) {
  const cv::Mat image = See(Picture(9), Shift(-300, -400), 1);
  EXPECT_TRUE(FindPlanes(std::vector<cv::Mat>{image, image}, AllPairs(2), {}, [] {
                return true;
              }).planes.empty());
}

// The definition, with Gaussians of the full size.
cv::Mat NormalizedSlowly(const cv::Mat& grey) {
  cv::Mat value, mean, variance, deviation, result;
  grey.convertTo(value, CV_32F);
  cv::GaussianBlur(value, mean, cv::Size(), 12.0, 12.0, cv::BORDER_REFLECT);
  value -= mean;
  cv::GaussianBlur(value.mul(value), variance, cv::Size(), 20.0, 20.0, cv::BORDER_REFLECT);
  cv::sqrt(cv::max(variance, 1.0), deviation);
  cv::GaussianBlur(value / deviation, value, cv::Size(), 1.0);
  value.convertTo(result, CV_8U, 40.0, 128.0);
  return result;
}

TEST(NormalizeLocalContrast, IsCloseToItsDefinition) {
  cv::Mat image = See(Picture(10), Shift(-300, -400), 1, {637, 475});
  // Light falls off and a dark part stands before the texture.
  for (int y = 0; y < image.rows; ++y) {
    for (int x = 0; x < image.cols; ++x) {
      image.at<unsigned char>(y, x) =
          static_cast<unsigned char>(image.at<unsigned char>(y, x) * (0.4 + 0.5 * x / image.cols));
    }
  }
  cv::rectangle(image, cv::Rect(250, 180, 120, 90), cv::Scalar(15), cv::FILLED);
  cv::Mat difference;
  cv::absdiff(NormalizeLocalContrast(image), NormalizedSlowly(image), difference);
  EXPECT_LT(cv::mean(difference)[0], 1.0);  // of 40 a deviation
  double largest = 0.0;
  cv::minMaxLoc(difference, nullptr, &largest);
  EXPECT_LT(largest, 20.0);
}

TEST(NormalizeLocalContrast, DoesNotSeeGainAndOffset) {
  const cv::Mat image = See(Picture(11), Shift(-300, -400), 1);
  cv::Mat brighter, difference;
  image.convertTo(brighter, CV_8U, 1.4, -40.0);
  cv::absdiff(NormalizeLocalContrast(image), NormalizeLocalContrast(brighter), difference);
  EXPECT_LT(cv::mean(difference)[0], 1.5);
}

TEST(NormalizeLocalContrast, TakesTheSmallestImages) {
  for (const cv::Size& size : {cv::Size(1, 1), cv::Size(3, 2), cv::Size(1, 200), cv::Size(17, 5)}) {
    const cv::Mat out = NormalizeLocalContrast(cv::Mat(size, CV_8UC1, cv::Scalar(90)));
    EXPECT_EQ(out.size(), size);
    EXPECT_EQ(cv::countNonZero(out != 128), 0);
  }
}

}  // namespace
}  // namespace horopter
