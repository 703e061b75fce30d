#include "server/vision/recognition/aspects/aspect_image.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <opencv2/core.hpp>
#include <opencv2/imgproc.hpp>
#include <vector>

namespace horopter {
namespace {

TEST(AspectImage, BinIsTheNearestDirection) {
  for (int i = 0; i < 720; ++i) {
    const double angle = (i + 0.3) * M_PI / 360.0;
    const int expected = static_cast<int>(std::lround(angle * kAspectBins / M_PI)) % kAspectBins;
    EXPECT_EQ(AspectBin(static_cast<float>(std::cos(angle)), static_cast<float>(std::sin(angle))),
              expected)
        << angle;
  }
}

// Looks at small images in their own size.
AspectImageOptions OfWidth(int width_px) {
  AspectImageOptions options;
  options.max_width_px = width_px;
  return options;
}

TEST(AspectImage, EmptyAndForeignImagesGiveNothing) {
  EXPECT_EQ(MakeAspectImage(cv::Mat()).width, 0);
  EXPECT_EQ(MakeAspectImage(cv::Mat(50, 50, CV_32FC3, cv::Scalar(1))).width, 0);
  const AspectImage flat =
      MakeAspectImage(cv::Mat(120, 160, CV_8UC3, cv::Scalar(90, 90, 90)), OfWidth(160));
  EXPECT_EQ(flat.width, 160);
  EXPECT_TRUE(flat.edges.empty());
  EXPECT_TRUE(flat.contours.chains.empty());
}

cv::Mat Disc(const cv::Scalar& background, const cv::Scalar& disc) {
  cv::Mat image(240, 320, CV_8UC3, background);
  cv::circle(image, cv::Point(160, 120), 60, disc, -1, cv::LINE_AA);
  return image;
}

TEST(AspectImage, EdgesLieOnTheContourWithItsDirection) {
  const AspectImage image = MakeAspectImage(Disc({60, 60, 60}, {150, 150, 150}), OfWidth(320));
  ASSERT_GT(image.edges.size(), 300u);
  for (const ImageEdgePoint& e : image.edges) {
    const Eigen::Vector2f radius = e.point - Eigen::Vector2f(160, 120);
    EXPECT_NEAR(radius.norm(), 60.0f, 1.0f);
    EXPECT_GT(std::abs(radius.normalized().dot(e.normal)), 0.95f);
    const int bin = AspectBin(-e.normal.y(), e.normal.x());
    EXPECT_LE(image.DistanceAt(e.point.x(), e.point.y(), bin), 1);
    // Nothing runs across the contour here.
    const int across = (bin + kAspectBins / 2) % kAspectBins;
    EXPECT_GT(image.DistanceAt(e.point.x(), e.point.y(), across), 80);
  }
}

TEST(AspectImage, ColourAloneMakesAnEdge) {
  // The same grey by the usual weights.
  const AspectImage image = MakeAspectImage(Disc({100, 100, 100}, {100, 78, 143}), OfWidth(320));
  EXPECT_GT(image.edges.size(), 300u);
}

TEST(AspectImage, FineRandomTextureIsNoEdge) {
  cv::Mat noise(240, 320, CV_8UC3);
  cv::RNG random(5);
  random.fill(noise, cv::RNG::UNIFORM, 0, 255);
  cv::GaussianBlur(noise, noise, cv::Size(), 1.5);
  AspectImageOptions keep = OfWidth(320);
  keep.max_texture = 1.0;
  keep.noise_factor = 0.0;
  const std::size_t all = MakeAspectImage(noise, keep).edges.size();
  ASSERT_GT(all, 5000u);
  AspectImageOptions drop = OfWidth(320);
  drop.noise_factor = 0.0;
  EXPECT_LT(MakeAspectImage(noise, drop).edges.size(), all / 20);
}

std::ptrdiff_t OnCircle(const AspectImage& image, const Eigen::Vector2f& center, float radius_px) {
  return std::count_if(image.edges.begin(), image.edges.end(), [&](const ImageEdgePoint& e) {
    return std::abs((e.point - center).norm() - radius_px) < 2.0f;
  });
}

TEST(AspectImage, EdgesOfDarkSurfacesAreMeasuredByTheNoiseThere) {
  const std::uint64_t seed = 3;
  SCOPED_TRACE(seed);
  // A bright ground and a dark part with a darker face, under noise as of light.
  cv::Mat image(480, 640, CV_32FC3, cv::Scalar::all(160));
  cv::rectangle(image, cv::Rect(250, 180, 140, 120), cv::Scalar::all(32), cv::FILLED);
  cv::rectangle(image, cv::Rect(320, 180, 70, 120), cv::Scalar::all(12), cv::FILLED);
  cv::Mat grains(image.size(), CV_32FC3), deviation;
  cv::RNG(seed).fill(grains, cv::RNG::NORMAL, 0.0, 1.0);
  cv::sqrt(0.5 * image, deviation);
  image += grains.mul(deviation);
  image.convertTo(image, CV_8U);
  const AspectImage found = MakeAspectImage(image);
  int of_face = 0, of_outline = 0, others = 0;
  for (const ImageEdgePoint& e : found.edges) {
    const float x = e.point.x(), y = e.point.y();
    const float outside = std::max(std::abs(x - 319.5f) - 70, std::abs(y - 239.5f) - 60);
    const bool outline = std::abs(outside) < 4;
    const bool face = std::abs(x - 319.5f) < 3 && std::abs(y - 239.5f) < 56;
    ++(outline ? of_outline : face ? of_face : others);
  }
  EXPECT_GT(of_outline, 450);
  EXPECT_GT(of_face, 80);
  EXPECT_LT(others, 100);
}

TEST(AspectImage, WeakContoursInNoiseAreFoundBySmoothingMore) {
  for (const int seed : {5, 6, 7}) {
    SCOPED_TRACE(testing::Message() << "seed " << seed);
    cv::Mat image(480, 640, CV_32FC3, cv::Scalar::all(110));
    cv::circle(image, cv::Point(320, 240), 100, cv::Scalar::all(136), cv::FILLED, cv::LINE_AA);
    cv::Mat noise(image.size(), CV_32FC3);
    cv::RNG(seed).fill(noise, cv::RNG::NORMAL, 0.0, 8.0);
    image += noise;
    image.convertTo(image, CV_8U);
    AspectImageOptions plain;
    plain.noisy = 1e9;
    const AspectImage found = MakeAspectImage(image), missed = MakeAspectImage(image, plain);
    const auto of_circle = OnCircle(found, {320, 240}, 100);
    EXPECT_GT(of_circle, 1.3 * OnCircle(missed, {320, 240}, 100));
    EXPECT_LT(static_cast<double>(found.edges.size()), 1.2 * of_circle);
  }
}

TEST(AspectImage, OutlineOfASmoothPartOnTextureStays) {
  for (const int seed : {5, 6, 7}) {
    SCOPED_TRACE(testing::Message() << "seed " << seed);
    cv::Mat granite(240, 320, CV_8UC1);
    cv::RNG random(seed);
    random.fill(granite, cv::RNG::UNIFORM, 0, 255);
    cv::GaussianBlur(granite, granite, cv::Size(), 1.5);
    cv::cvtColor(granite, granite, cv::COLOR_GRAY2BGR);
    cv::circle(granite, cv::Point(160, 120), 60, cv::Scalar(235, 235, 235), -1, cv::LINE_AA);
    cv::Mat noise(granite.size(), CV_8UC3);
    random.fill(noise, cv::RNG::UNIFORM, 0, 5);
    granite += noise;
    const auto of_disc = [](const AspectImage& image) { return OnCircle(image, {160, 120}, 60); };
    AspectImageOptions all = OfWidth(320);
    all.max_texture = 1.0;
    const AspectImage kept = MakeAspectImage(granite, OfWidth(320));
    const auto most = of_disc(MakeAspectImage(granite, all));
    EXPECT_GT(of_disc(kept), 0.8 * most);
    EXPECT_LT(kept.edges.size(), 0.5 * MakeAspectImage(granite, all).edges.size());
  }
}

// Its edges are fewer than those of fine grain, but everywhere.
TEST(AspectImage, CoarseGrainIsTextureToo) {
  for (const int seed : {71, 72, 73}) {
    SCOPED_TRACE(seed);
    cv::Mat granite(480, 640, CV_8UC1);
    cv::RNG random(seed);
    random.fill(granite, cv::RNG::UNIFORM, 0, 255);
    cv::GaussianBlur(granite, granite, cv::Size(), 2.6);
    cv::normalize(granite, granite, 40, 170, cv::NORM_MINMAX);
    cv::cvtColor(granite, granite, cv::COLOR_GRAY2BGR);
    cv::circle(granite, cv::Point(320, 240), 110, cv::Scalar(235, 235, 235), -1, cv::LINE_AA);
    const auto of_disc = [](const AspectImage& image) { return OnCircle(image, {320, 240}, 110); };
    AspectImageOptions all = OfWidth(640);
    all.max_texture = 1.0;
    const AspectImage kept = MakeAspectImage(granite, OfWidth(640));
    const AspectImage most = MakeAspectImage(granite, all);
    std::vector<std::uint8_t> levels(most.texture.begin(), most.texture.end());
    std::nth_element(levels.begin(), levels.begin() + levels.size() / 2, levels.end());
    EXPECT_LT(levels[levels.size() / 2], 255 * AspectImageOptions{}.max_texture);
    EXPECT_GT(of_disc(kept), 0.7 * of_disc(most));
    EXPECT_LT(kept.edges.size(), 0.6 * most.edges.size());
  }
}

TEST(AspectImage, WorkingCameraShowsThePointWhereTheSmallImageHasIt) {
  cv::Mat large(960, 1280, CV_8UC3, cv::Scalar(40, 40, 40));
  cv::rectangle(large, cv::Rect(400, 300, 400, 300), cv::Scalar(200, 200, 200), -1);
  const AspectImage image = MakeAspectImage(large);
  EXPECT_EQ(image.width, 640);
  const PinholeCamera camera = CenteredCamera(1280, 960, 1500.0);
  const PinholeCamera working = WorkingCamera(image, camera);
  const PinholeCamera back = OriginalCamera(image, working);
  EXPECT_NEAR(back.focal_px, camera.focal_px, 1e-9);
  EXPECT_NEAR(back.cx, camera.cx, 1e-9);
  // The left side of the rectangle, between pixels 399 and 400.
  const Eigen::Vector3d at((399.5 - camera.cx) / camera.focal_px, 0.0, 1.0);
  const float x = static_cast<float>(Project(working, at).x());
  float nearest = 1e9f;
  for (const ImageEdgePoint& e : image.edges) {
    if (std::abs(e.normal.x()) > 0.99f && e.point.x() < 300) {
      nearest = std::min(nearest, std::abs(e.point.x() - x));
    }
  }
  EXPECT_LT(nearest, 0.1f);
}

// The disc of a small image has the edges that it has in a large one, and they map back to where it
// is.
TEST(AspectImage, ASmallImageIsLookedAtAsLargeAsOthers) {
  const AspectImage image = MakeAspectImage(Disc({100, 100, 100}, {112, 112, 112}));
  EXPECT_EQ(image.width, 512);
  EXPECT_DOUBLE_EQ(image.working_from_image, 1.6);
  ASSERT_GT(image.edges.size(), 600u);
  for (const ImageEdgePoint& e : image.edges) {
    const Eigen::Vector2f at = (e.point.array() + 0.5f) / 1.6f - 0.5f;
    EXPECT_NEAR((at - Eigen::Vector2f(160, 120)).norm(), 60.0f, 1.0f);
  }
  const PinholeCamera camera = CenteredCamera(320, 240, 400.0);
  const PinholeCamera back = OriginalCamera(image, WorkingCamera(image, camera));
  EXPECT_NEAR(back.focal_px, camera.focal_px, 1e-9);
  EXPECT_NEAR(back.cx, camera.cx, 1e-9);
  // Larger than by 1.6 nothing is made; a portrait of common size stays.
  EXPECT_EQ(MakeAspectImage(cv::Mat(80, 100, CV_8UC1, cv::Scalar(9))).width, 160);
  EXPECT_EQ(MakeAspectImage(cv::Mat(640, 480, CV_8UC1, cv::Scalar(9))).width, 480);
}

TEST(AspectImage, ThreadsDoNotMatter) {
  const cv::Mat disc = Disc({60, 60, 60}, {150, 120, 100});
  AspectImageOptions two;
  two.threads = 2;
  const AspectImage a = MakeAspectImage(disc), b = MakeAspectImage(disc, two);
  EXPECT_EQ(a.distance, b.distance);
  EXPECT_EQ(a.chance, b.chance);
  EXPECT_EQ(a.edge_at, b.edge_at);
}

TEST(AspectImage, ValidateNamesTheField) {
  AspectImageOptions options;
  EXPECT_TRUE(Validate(options).ok());
  options.sigma_px = 0;
  EXPECT_NE(std::string(Validate(options).message()).find("sigma_px"), std::string::npos);
}

}  // namespace
}  // namespace horopter
