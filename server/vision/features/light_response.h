// Edges where the light changes, not where the grey values do.
#pragma once

#include <opencv2/core/mat.hpp>
#include <vector>

#include "server/vision/features/features.h"

namespace horopter {

// Lens and pixels blur light; then the camera bends it into grey values (sRGB, IEC 61966-2-1),
// steeply where it is dark. The steepest grey value of a blurred step therefore lies on its dark
// side, by 0.05 px at a faint edge up to 0.3 px at a strong one: all bright things look larger,
// which a joint adjustment takes for another focal length.

// Standard deviation (pixels) of the blur of an image before the response, from how much flatter
// its strong edges are than the detector alone makes them; 0 without such edges. image: CV_8UC1 or
// CV_8UC3; chains: of image, as LinkEdges gives them.
double EstimateBlur(const cv::Mat& image, const std::vector<EdgeChain>& chains);

// How far (in deviations of the blur, >= 0) towards the dark side the middle of the grey step lies
// from the middle of the light step between two grey values, 0..255.
double DarkwardShift(double dark, double bright);

// Moves every point of the chains along its gradient to where the light has its step, given the
// colours 3 px to both sides of it.
void UndoResponse(const cv::Mat& image, double blur_px, std::vector<EdgeChain>* chains);

}  // namespace horopter
