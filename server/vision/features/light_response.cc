#include "server/vision/features/light_response.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdint>
#include <opencv2/core.hpp>

#include "server/base/stop_scope.h"
#include "server/vision/features/learnt_constants.h"
#include "server/vision/features/stop_paces.h"

namespace horopter {
namespace {

constexpr double kSidePx = 3.0;                   // where the colours beside an edge are read
constexpr double kStrongStep = 40.0;              // grey levels; weaker steps do not tell the blur
constexpr std::size_t kFewestSteps = 50;          // strong ones, for their median to say the blur
constexpr double kMostBlurPx = 2.0;               // deviation that is corrected at most
constexpr double kMostShiftPx = 0.6;              // a point is moved by at most
constexpr int kTableStep = 8;                     // grey levels
constexpr int kTableSize = 256 / kTableStep + 1;  // both ends included

double Light(double grey) {
  const double v = grey / 255.0;
  return v <= 0.04045 ? v / 12.92 : std::pow((v + 0.055) / 1.055, 2.4);
}
double Grey(double light) {
  return 255.0 * (light <= 0.0031308 ? 12.92 * light : 1.055 * std::pow(light, 1.0 / 2.4) - 0.055);
}

// Mean of x over the slope of Grey(step of light blurred with deviation 1): the integral of
// (step at 0 - normalised grey), negated for the dark side.
double IntegrateShift(double dark, double bright) {
  const double low = Light(dark), high = Light(bright);
  // Deviations of the blur on each side, and the integral's step.
  constexpr double kReach = 4.0, kStep = 0.1;
  double area = 0.0;
  for (double x = -kReach + 0.5 * kStep; x < kReach; x += kStep) {
    const double share = 0.5 * std::erfc(-x / std::sqrt(2.0));
    const double grey = (Grey(low + (high - low) * share) - dark) / (bright - dark);
    area += kStep * (grey - (x > 0.0 ? 1.0 : 0.0));
  }
  return area;
}

using ShiftTable = std::array<std::array<float, kTableSize>, kTableSize>;

const ShiftTable& Shifts() {
  static const ShiftTable table = [] {
    ShiftTable t{};
    for (int dark = 0; dark < kTableSize; ++dark) {
      for (int bright = dark + 1; bright < kTableSize; ++bright) {
        const double at_dark = std::min(255, dark * kTableStep);
        const double at_bright = std::min(255, bright * kTableStep);
        t[dark][bright] = static_cast<float>(IntegrateShift(at_dark, at_bright));
      }
    }
    // Between neighbouring steps the table is read across its diagonal: mirrored, it is smooth.
    for (int dark = 0; dark < kTableSize; ++dark) {
      for (int bright = 0; bright < dark; ++bright) t[dark][bright] = -t[bright][dark];
    }
    return t;
  }();
  return table;
}

using Colour = std::array<float, 3>;

Colour ColourAt(const cv::Mat& image, const Eigen::Vector2f& p) {
  const int x = std::clamp(static_cast<int>(std::lround(p.x())), 0, image.cols - 1);
  const int y = std::clamp(static_cast<int>(std::lround(p.y())), 0, image.rows - 1);
  const int channels = image.channels();
  const uint8_t* pixel = image.ptr<uint8_t>(y) + static_cast<ptrdiff_t>(x) * channels;
  if (channels == 1) return {static_cast<float>(pixel[0]), 0.0f, 0.0f};
  return {static_cast<float>(pixel[0]), static_cast<float>(pixel[1]), static_cast<float>(pixel[2])};
}

// What the detector's channels (order of ColourGradient::kEachChannel) are made of.
constexpr float kMixture[5][3] = {{1.0f, 0.0f, 0.0f},
                                  {0.0f, 1.0f, 0.0f},
                                  {0.0f, 0.0f, 1.0f},
                                  {0.0f, -1.5f, 1.5f},
                                  {-1.5f, 0.75f, 0.75f}};

struct Step {
  double height = 0.0;  // of the channel, grey levels, from the gradient's tail to its head
  double shift = 0.0;   // of its middle against the gradient, in deviations of the blur
};

Step StepAt(const cv::Mat& image, const EdgeChain& chain, std::size_t i) {
  const Eigen::Vector2f along = static_cast<float>(kSidePx) * chain.gradients[i].normalized();
  const Colour from = ColourAt(image, chain.points[i] - along);
  const Colour to = ColourAt(image, chain.points[i] + along);
  Step step;
  double moment = 0.0;
  for (int c = 0; c < 3; ++c) {
    const double weight = kMixture[chain.channels[i]][c];
    if (weight == 0.0) continue;
    const double rise = weight * (to[c] - from[c]);
    step.height += rise;
    // The middle of a plane's step lies on its own dark side, whichever that is.
    const bool brightens = to[c] > from[c];
    const double shift = brightens ? DarkwardShift(from[c], to[c]) : -DarkwardShift(to[c], from[c]);
    moment += rise * shift;
  }
  if (std::abs(step.height) > 1.0) step.shift = moment / step.height;
  return step;
}

bool Usable(const EdgeChain& chain) {
  return chain.gradients.size() == chain.points.size() &&
         chain.channels.size() == chain.points.size();
}

}  // namespace

double DarkwardShift(double dark, double bright) {
  const double x = std::clamp(dark, 0.0, 255.0) / kTableStep;
  const double y = std::clamp(bright, 0.0, 255.0) / kTableStep;
  const int i = std::min(static_cast<int>(x), kTableSize - 2);
  const int j = std::min(static_cast<int>(y), kTableSize - 2);
  const double u = x - i, v = y - j;
  const ShiftTable& t = Shifts();
  return std::max(0.0,
                  (1 - u) * ((1 - v) * t[i][j] + v * t[i][j + 1]) +
                      u * ((1 - v) * t[i + 1][j] + v * t[i + 1][j + 1]));
}

double EstimateBlur(const cv::Mat& image, const std::vector<EdgeChain>& chains) {
  // The slope at the middle of a step of height h blurred by s is h / (sqrt(2 pi) s).
  std::vector<double> widths;
  StopPacer pacer(kChainsPerLook);
  for (const EdgeChain& chain : chains) {
    pacer.Step();
    if (!Usable(chain)) continue;
    for (std::size_t i = 0; i < chain.points.size(); ++i) {
      const double slope = chain.gradients[i].norm();
      if (slope < 1.0) continue;
      const double height = StepAt(image, chain, i).height;
      if (height > kStrongStep) widths.push_back(height / (std::sqrt(2.0 * M_PI) * slope));
    }
  }
  if (widths.size() < kFewestSteps) return 0.0;
  const auto middle = widths.begin() + static_cast<std::ptrdiff_t>(widths.size() / 2);
  StopPacer comparisons(kComparisonsPerLook);
  std::nth_element(widths.begin(), middle, widths.end(), [&](double a, double b) {
    comparisons.Step();
    return a < b;
  });
  const double squared = *middle * *middle - kDetectorWidthPx * kDetectorWidthPx;
  return std::min(kMostBlurPx, std::sqrt(std::max(0.0, squared)));
}

void UndoResponse(const cv::Mat& image, double blur_px, std::vector<EdgeChain>* chains) {
  if (!(blur_px > 0.0)) return;
  StopPacer pacer(kChainsPerLook);
  for (EdgeChain& chain : *chains) {
    pacer.Step();
    if (!Usable(chain)) continue;
    for (std::size_t i = 0; i < chain.points.size(); ++i) {
      if (!(chain.gradients[i].squaredNorm() > 0.0f)) continue;
      const double shift = std::clamp(
          kSteepestShare * blur_px * StepAt(image, chain, i).shift, -kMostShiftPx, kMostShiftPx);
      chain.points[i] += static_cast<float>(shift) * chain.gradients[i].normalized();
    }
  }
}

}  // namespace horopter
