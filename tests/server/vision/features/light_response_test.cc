// Edges lie where the light has its step, whatever the camera's response made of it.
#include "server/vision/features/light_response.h"

#include <gtest/gtest.h>

#include <cmath>
#include <opencv2/core.hpp>
#include <random>

namespace horopter {
namespace {

double Light(double grey) {
  const double v = grey / 255.0;
  return v <= 0.04045 ? v / 12.92 : std::pow((v + 0.055) / 1.055, 2.4);
}
double Grey(double light) {
  return 255.0 * (light <= 0.0031308 ? 12.92 * light : 1.055 * std::pow(light, 1 / 2.4) - 0.055);
}

struct StepScene {
  double angle_rad = 0.0;  // of the normal, towards the bright side
  double offset_px = 0.0;  // of the edge from the image's middle along the normal
  double dark = 40.0;      // grey levels
  double bright = 200.0;
  double blur_px = 0.5;  // of the light
  double noise = 0.0;    // grey levels
};

constexpr int kSize = 160;

double SignedDistance(const StepScene& s, double x, double y) {
  const double m = 0.5 * (kSize - 1);
  return std::cos(s.angle_rad) * (x - m) + std::sin(s.angle_rad) * (y - m) - s.offset_px;
}

cv::Mat Render(const StepScene& s, bool response, std::mt19937* rng) {
  cv::Mat image(kSize, kSize, CV_8UC1);
  std::normal_distribution<double> noise(0.0, 1.0);
  for (int y = 0; y < kSize; ++y) {
    for (int x = 0; x < kSize; ++x) {
      const double share = 0.5 * std::erfc(-SignedDistance(s, x, y) / (s.blur_px * std::sqrt(2.0)));
      const double linear = s.dark + (s.bright - s.dark) * share;
      const double bent = Grey(Light(s.dark) + (Light(s.bright) - Light(s.dark)) * share);
      image.at<uint8_t>(y, x) =
          cv::saturate_cast<uint8_t>((response ? bent : linear) + s.noise * noise(*rng));
    }
  }
  return image;
}

// Mean signed distance of the chain points from the edge, towards the bright side.
double MeanOffset(const cv::Mat& image, const StepScene& scene, bool undo) {
  FeatureOptions options;
  options.undo_response = undo;
  const auto features = DetectFeatures(image, options);
  EXPECT_TRUE(features.ok());
  double sum = 0.0;
  int n = 0;
  for (const EdgeChain& chain : features->chains) {
    for (const Eigen::Vector2f& p : chain.points) {
      const double d = SignedDistance(scene, p.x(), p.y());
      if (std::abs(d) > 1.5) continue;
      sum += d;
      ++n;
    }
  }
  EXPECT_GT(n, 50);
  return sum / n;
}

TEST(DarkwardShift, GrowsWithTheStepAndVanishesWithIt) {
  EXPECT_NEAR(DarkwardShift(100, 101), 0.0, 0.02);
  double before = 0.0;
  for (const double bright : {60.0, 90.0, 130.0, 180.0, 250.0}) {
    const double shift = DarkwardShift(40, bright);
    EXPECT_GT(shift, before) << bright;
    before = shift;
  }
  EXPECT_LT(before, 1.0);
  // The same rise from a darker ground is bent more.
  EXPECT_GT(DarkwardShift(10, 110), DarkwardShift(130, 230));
}

TEST(UndoResponse, HalvesAtLeastTheOffsetOfSteps) {
  std::mt19937 rng(3);
  std::uniform_real_distribution<double> u(0.0, 1.0);
  double squared_before = 0.0, squared_after = 0.0;
  int darkward = 0;
  constexpr int kScenes = 60;
  for (int i = 0; i < kScenes; ++i) {
    StepScene scene;
    scene.angle_rad = 2.0 * M_PI * u(rng);
    scene.offset_px = 4.0 * u(rng);
    scene.dark = 15.0 + 60.0 * u(rng);
    scene.bright = scene.dark + 80.0 + 90.0 * u(rng);
    scene.blur_px = 0.4 + 0.9 * u(rng);
    scene.noise = 2.0 * u(rng);
    const cv::Mat image = Render(scene, true, &rng);
    const double before = MeanOffset(image, scene, false), after = MeanOffset(image, scene, true);
    squared_before += before * before / kScenes;
    squared_after += after * after / kScenes;
    darkward += before < -0.02;
  }
  RecordProperty("rms_before_px", std::to_string(std::sqrt(squared_before)));
  RecordProperty("rms_after_px", std::to_string(std::sqrt(squared_after)));
  EXPECT_GE(darkward, kScenes * 9 / 10);
  EXPECT_LT(std::sqrt(squared_after), 0.5 * std::sqrt(squared_before))
      << std::sqrt(squared_before) << " px before";
}

TEST(UndoResponse, LeavesFaintEdgesAlone) {
  std::mt19937 rng(4);
  StepScene scene;
  scene.dark = 120;
  scene.bright = 132;
  scene.angle_rad = 0.3;
  const cv::Mat image = Render(scene, true, &rng);
  EXPECT_NEAR(MeanOffset(image, scene, true), MeanOffset(image, scene, false), 0.02);
}

TEST(EstimateBlur, GrowsWithTheBlurAndNeedsStrongEdges) {
  std::mt19937 rng(5);
  StepScene scene;
  scene.angle_rad = 0.5;
  double before = -1.0;
  FeatureOptions options;
  options.undo_response = false;
  for (const double blur : {0.4, 0.9, 1.4}) {
    scene.blur_px = blur;
    const cv::Mat image = Render(scene, true, &rng);
    const double found = EstimateBlur(image, DetectFeatures(image, options)->chains);
    EXPECT_GT(found, before) << blur;
    before = found;
  }
  scene.dark = 120;
  scene.bright = 132;
  const cv::Mat faint = Render(scene, true, &rng);
  EXPECT_EQ(EstimateBlur(faint, DetectFeatures(faint, options)->chains), 0.0);
  EXPECT_EQ(EstimateBlur(faint, {}), 0.0);
}

}  // namespace
}  // namespace horopter
