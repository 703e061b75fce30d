// The grey images in which edges are looked for: intensity in each primary and two opponent
// colours.
#pragma once

#include <Eigen/Core>
#include <opencv2/core/mat.hpp>
#include <vector>

namespace horopter {

struct DetectionChannel {
  cv::Mat grey;    // CV_8UC1, what the detector sees
  cv::Mat smooth;  // CV_32FC1, grey after a Gaussian; sub-pixel positions come from it
  double median_gradient = 0.0;  // see MedianGradient
};

// Colour: B, G, R, 128 + 1.5 (R - G), 128 + 1.5 ((R + G) / 2 - B); grey: the image itself. `image`
// is CV_8UC1 or CV_8UC3. The opponent channels show edges between faces of equal brightness and
// different hue.
std::vector<DetectionChannel> MakeDetectionChannels(const cv::Mat& image,
                                                    double smoothing_sigma_px);

// Median over the image of |dx| + |dy| (sums over 3x3 pixels, the edge detector's measure) of the
// smoothed channel: what noise and fine texture give where no edge is. A mask on neighbouring
// pixels would miss the noise that JPEG leaves.
double MedianGradient(const cv::Mat& smooth);

// Bilinear value of a CV_32FC1 image; positions outside are clamped to the border.
float SampleBilinear(const cv::Mat& image, float x, float y);

}  // namespace horopter
