// Parts of images that are searched, enlarged: where their pixels are, and what is seen of them.
#include "server/vision/recognition/aspects/searched_part.h"

#include <gtest/gtest.h>

#include <Eigen/Geometry>
#include <cmath>
#include <opencv2/core.hpp>
#include <opencv2/imgproc.hpp>
#include <optional>
#include <random>
#include <vector>

#include "server/vision/recognition/aspects/aspect_image.h"

namespace horopter {
namespace {

constexpr unsigned kSeed = 105;

ImageBox Box(double x, double y, double width, double height) {
  return {Eigen::Vector2d(x, y), Eigen::Vector2d(x + width, y + height)};
}

TEST(CutOf, HoldsTheBoxesWithinTheImageAndItsBounds) {
  std::mt19937 random(kSeed);
  std::uniform_real_distribution<double> share(0.0, 1.0);
  for (int i = 0; i < 500; ++i) {
    const cv::Size size(200 + static_cast<int>(4000 * share(random)),
                        200 + static_cast<int>(3000 * share(random)));
    std::vector<ImageBox> boxes;
    for (int k = 0; k <= i % 4; ++k) {
      const double x = share(random) * (size.width - 20), y = share(random) * (size.height - 20);
      const double width = 2.0 + share(random) * (size.width - 4 - x);
      const double height = 2.0 + share(random) * (size.height - 4 - y);
      boxes.push_back(Box(x, y, width, height).intersection(WholeImage(size.width, size.height)));
    }
    WorkingCutOptions options;
    options.least_scale = 0.2;
    const WorkingCut cut = CutOf(size, boxes, options);
    for (const ImageBox& box : boxes) {
      const ImageBox whole(
          Eigen::Vector2d(cut.cut.x - 0.5, cut.cut.y - 0.5),
          Eigen::Vector2d(cut.cut.x + cut.cut.width - 0.5, cut.cut.y + cut.cut.height - 0.5));
      EXPECT_TRUE(whole.contains(box));
      EXPECT_LE(box.sizes().maxCoeff() * cut.scale,
                std::max(options.box_px, std::hypot(size.width, size.height)) * 5);
    }
    EXPECT_EQ(cut.cut & cv::Rect(cv::Point(0, 0), size), cut.cut);
    EXPECT_LE(cut.scale, options.most_enlarged);
    EXPECT_LE(cut.cut.area() * cut.scale * cut.scale, options.most_px * (1.0 + 1e-9));
  }
}

TEST(CutOf, EnlargesASmallBoxAndNotALargeOne) {
  WorkingCutOptions options;
  options.box_px = 480.0;
  options.least_scale = 0.5;
  EXPECT_DOUBLE_EQ(CutOf({1280, 960}, {Box(100, 100, 80, 60)}, options).scale, 3.0);
  EXPECT_DOUBLE_EQ(CutOf({1280, 960}, {Box(100, 100, 240, 60)}, options).scale, 2.0);
  EXPECT_DOUBLE_EQ(CutOf({1280, 960}, {Box(0, 0, 1200, 900)}, options).scale, 0.5);
  // The smallest box says it, as far as all of the cut-out has room.
  const std::vector<ImageBox> apart = {Box(0, 0, 80, 60), Box(1100, 800, 80, 60)};
  const WorkingCut cut = CutOf({1280, 960}, apart, options);
  EXPECT_LT(cut.scale, 3.0);
  EXPECT_NEAR(cut.cut.area() * cut.scale * cut.scale, options.most_px, 1.0);
}

AspectImage Searched(const cv::Mat& image, const std::optional<SearchedPart>& part) {
  const std::vector<cv::Mat> images = {image};
  const std::vector<std::optional<SearchedPart>> parts = {part};
  return MakeAspectImagesOnGround(images, {}, {}, 1, parts)[0];
}

TEST(SearchedPart, CamerasOfItsPixelsSeeWhatThoseOfTheImageSee) {
  std::mt19937 random(kSeed);
  std::uniform_real_distribution<double> share(0.1, 0.9);
  const cv::Mat image(480, 640, CV_8UC3, cv::Scalar(90, 90, 90));
  for (int i = 0; i < 20; ++i) {
    SearchedPart part;
    part.boxes = {Box(500 * share(random), 400 * share(random), 60, 40)};
    const AspectImage found = Searched(image, part);
    EXPECT_GT(found.working_from_image, 2.9);
    EXPECT_LT(found.width, 400);
    PinholeCamera camera = CenteredCamera(640, 480, 700.0);
    camera.cx += 13.0;
    camera.k1 = -0.1;
    const PinholeCamera working = WorkingCamera(found, camera);
    const PinholeCamera back = OriginalCamera(found, working);
    EXPECT_NEAR(back.focal_px, camera.focal_px, 1e-9);
    EXPECT_NEAR(back.cx, camera.cx, 1e-9);
    EXPECT_NEAR(back.cy, camera.cy, 1e-9);
    EXPECT_EQ(back.width, camera.width);
    for (int k = 0; k < 20; ++k) {
      const Eigen::Vector3d x(share(random) - 0.5, share(random) - 0.5, 1.0 + share(random));
      const Eigen::Vector2d at = Project(camera, x), there = Project(working, x);
      EXPECT_LT((WorkingPixel(found, at) - there).norm(), 1e-9);
      EXPECT_LT((OriginalPixel(found, there) - at).norm(), 1e-9);
      const Eigen::Vector3d mapped = WorkingFromImage(found) * at.homogeneous();
      EXPECT_LT((mapped.hnormalized() - there).norm(), 1e-9);
    }
  }
}

// A bright disc of 12 px among others, drawn with so many pixels to one of the image.
constexpr double kRadius = 12.0;
const Eigen::Vector2d kMiddle(300.25, 200.5);
cv::Mat Discs(int factor) {
  constexpr int kShift = 8;
  cv::Mat image(480 * factor, 640 * factor, CV_8UC3, cv::Scalar(70, 70, 70));
  for (int i = -4; i <= 4; ++i) {
    const Eigen::Vector2d at = kMiddle + Eigen::Vector2d(60.0 * i, 0.0);
    const Eigen::Vector2d drawn = ((at.array() + 0.5) * factor - 0.5) * (1 << kShift);
    cv::circle(image,
               cv::Point(static_cast<int>(drawn.x()), static_cast<int>(drawn.y())),
               static_cast<int>(kRadius * factor * (1 << kShift)),
               cv::Scalar(160, 160, 160),
               -1,
               cv::LINE_AA,
               kShift);
  }
  // As lenses do: enlarging what is sharper rings.
  cv::GaussianBlur(image, image, {}, 0.7 * factor);
  return image;
}

// Its outline is drawn, and interpolated, to a pixel; the middle of that says where the pixels are.
void ExpectTheDiscAlone(const AspectImage& found) {
  ASSERT_GT(found.edges.size(), 2.0 * M_PI * kRadius * found.working_from_image * 0.8);
  Eigen::Vector2d sum = Eigen::Vector2d::Zero();
  for (const ImageEdgePoint& e : found.edges) {
    const Eigen::Vector2d at = OriginalPixel(found, e.point.cast<double>());
    EXPECT_NEAR((at - kMiddle).norm(), kRadius, 1.5);
    sum += at;
  }
  const Eigen::Vector2d mean = sum / static_cast<double>(found.edges.size());
  EXPECT_LT((mean - kMiddle).norm(), 0.2) << (mean - kMiddle).transpose();
}

TEST(SearchedPart, ShowsWhatLiesInItEnlargedAndNothingElse) {
  SearchedPart part;
  part.boxes = {Box(kMiddle.x() - 20, kMiddle.y() - 20, 40, 40)};
  const cv::Mat image = Discs(1);
  ExpectTheDiscAlone(Searched(image, part));
  EXPECT_GT(Searched(image, std::nullopt).edges.size(), 5 * 2.0 * M_PI * kRadius);
  // Boxes apart, with one of the discs between them left out.
  part.boxes.push_back(Box(kMiddle.x() + 100, kMiddle.y() - 20, 40, 40));
  const AspectImage two = Searched(image, part);
  for (const ImageEdgePoint& e : two.edges) EXPECT_TRUE(IsSearched(two, e.point.x(), e.point.y()));
  const Eigen::Vector2d left_out = WorkingPixel(two, kMiddle + Eigen::Vector2d(60.0, 0.0));
  EXPECT_FALSE(IsSearched(two, left_out.x(), left_out.y()));
}

TEST(SearchedPart, IsCutOutOfTheImageAsItCame) {
  const cv::Mat original = Discs(4);
  cv::Mat image;
  cv::resize(original, image, {}, 0.25, 0.25, cv::INTER_AREA);
  SearchedPart part;
  part.boxes = {Box(kMiddle.x() - 20, kMiddle.y() - 20, 40, 40)};
  part.pixels = original;
  part.pixels_from_image = 4.0;
  const AspectImage found = Searched(image, part);
  EXPECT_NEAR(found.working_from_image, 6.0, 1e-9);
  EXPECT_EQ(found.image_width, 640);
  ExpectTheDiscAlone(found);
}

TEST(SearchedPart, WithoutABoxShowsNothing) {
  const AspectImage found = Searched(Discs(1), SearchedPart());
  EXPECT_EQ(found.width, 640);
  EXPECT_TRUE(found.edges.empty());
  EXPECT_FALSE(IsSearched(found, 300, 200));
}

}  // namespace
}  // namespace horopter
