// The gradient field in which edges are linked: one magnitude and one direction per pixel, made of
// grey or colour values (thesis 2.2).
#pragma once

#include <array>
#include <opencv2/core/mat.hpp>
#include <span>
#include <vector>

#include "server/vision/features/features.h"

namespace horopter {

// All matrices have the size of the image.
struct GradientField {
  cv::Mat magnitude;        // CV_16SC1: (|dx| + |dy|) in units of threshold / kThresholdUnits
  cv::Mat dx, dy;           // CV_16SC1: kSlopeUnits x slope in grey levels per pixel
  int single_channel = -1;  // the channel (order of ColourGradient) the field is of, or
  cv::Mat channel;          // CV_8UC1: which channel has the field here
  std::array<double, 5> threshold{};        // of each channel: see GradientOptions
  std::array<double, 5> median_gradient{};  // what noise and fine texture give
};

constexpr int kThresholdUnits = 80;   // the threshold in the magnitude's 16 bits
constexpr double kSlopeUnits = 24.0;  // a grey level per pixel in the slopes' 16 bits

// Gaussian (binomial, sigma 1) and 3x3 differences. image: CV_8UC1 or CV_8UC3 (BGR), at least 3x3
// pixels; the border is repeated. Five fields for kEachChannel, one otherwise; a grey image has one
// field whatever `colour` says.
std::vector<GradientField> MakeGradientFields(const cv::Mat& image, const GradientOptions& options);

// One field that has at each pixel the strongest of `fields` (of one image, not empty).
GradientField StrongestOf(std::span<const GradientField> fields);

}  // namespace horopter
