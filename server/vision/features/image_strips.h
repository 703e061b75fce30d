// OpenCV's functions over whole images, strip by strip: the same pixels, and the work may stop
// (stop_scope.h) between two strips of a large image, where one call takes a second.
#pragma once

#include <opencv2/core.hpp>
#include <vector>

#include "absl/functional/function_ref.h"

namespace horopter {

inline constexpr int kStripPixels = 1 << 20;  // between two looks at the stop flag

// Calls body with consecutive ranges of rows, each a multiple of `unit` rows but the last and about
// kStripPixels large, at least `least` rows; together all of them.
void ForEachStrip(cv::Size size,
                  absl::FunctionRef<void(const cv::Range& rows)> body,
                  int unit = 1,
                  int least = 1);

// As cv::split of an image with three channels.
void SplitInStrips(const cv::Mat& image, std::vector<cv::Mat>* planes);

// As Mat::convertTo.
cv::Mat ConvertInStrips(const cv::Mat& image, int depth, double scale = 1.0, double shift = 0.0);

// As cv::cvtColor; channels: of what comes out. For colour spaces of single pixels.
cv::Mat RecolourInStrips(const cv::Mat& image, int code, int channels);

// As cv::GaussianBlur into an image of its own; kernel of size 0: by the deviation.
cv::Mat BlurInStrips(const cv::Mat& image,
                     cv::Size kernel,
                     double sigma_px,
                     int border = cv::BORDER_DEFAULT);

// As cv::resize by area to a `factor` of times smaller size, rounded up. Where the rows are no
// multiple of it, all in one.
cv::Mat ShrinkInStrips(const cv::Mat& image, int factor);

// By how much a large image may be shrunk in strips before it is resized to `size` of its own size:
// what is left is half at least. 1 where nothing divides it, and of images that are not large.
int StripFactor(cv::Size image, double size);

// As cv::resize, cubic, to twice the size: of small images, all in one.
cv::Mat Doubled(const cv::Mat& image);

// As cv::resize, linear, to `factor` times the size but for rows and columns that are too many for
// `size`. Where its rows are no multiple of the factor, all in one.
cv::Mat EnlargeInStrips(const cv::Mat& image, int factor, cv::Size size);

}  // namespace horopter
