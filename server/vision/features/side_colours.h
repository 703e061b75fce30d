// Colour of the image beside each segment.
#pragma once

#include <opencv2/core/mat.hpp>
#include <vector>

#include "server/vision/features/features.h"

namespace horopter {

// Fills left_bgr and right_bgr with the channel-wise median of up to 15 pixels, 3 px beside the
// segment. A grey image gives three equal values. image: CV_8UC1 or CV_8UC3.
void MeasureSideColours(const cv::Mat& image, std::vector<Segment>* segments);

}  // namespace horopter
