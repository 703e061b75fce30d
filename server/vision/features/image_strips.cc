#include "server/vision/features/image_strips.h"

#include <algorithm>
#include <cmath>
#include <opencv2/imgproc.hpp>
#include <vector>

#include "server/base/stop_scope.h"

namespace horopter {

void ForEachStrip(cv::Size size,
                  absl::FunctionRef<void(const cv::Range& rows)> body,
                  int unit,
                  int least) {
  const int wanted = std::max({1, least, kStripPixels / std::max(1, size.width)});
  const int rows = (wanted + unit - 1) / unit * unit;
  for (int y = 0; y < size.height; y += rows) {
    LeaveIfStopped();
    body(cv::Range(y, std::min(y + rows, size.height)));
  }
}

void SplitInStrips(const cv::Mat& image, std::vector<cv::Mat>* planes) {
  planes->assign(image.channels(), cv::Mat());
  for (cv::Mat& plane : *planes) plane.create(image.size(), image.depth());
  ForEachStrip(image.size(), [&](const cv::Range& rows) {
    std::vector<cv::Mat> strips;
    for (const cv::Mat& plane : *planes) strips.push_back(plane.rowRange(rows));
    cv::split(image.rowRange(rows), strips.data());
  });
}

cv::Mat ConvertInStrips(const cv::Mat& image, int depth, double scale, double shift) {
  cv::Mat out(image.size(), CV_MAKETYPE(depth, image.channels()));
  ForEachStrip(image.size(), [&](const cv::Range& rows) {
    cv::Mat strip = out.rowRange(rows);
    image.rowRange(rows).convertTo(strip, depth, scale, shift);
  });
  return out;
}

cv::Mat RecolourInStrips(const cv::Mat& image, int code, int channels) {
  cv::Mat out(image.size(), CV_MAKETYPE(image.depth(), channels));
  ForEachStrip(image.size(), [&](const cv::Range& rows) {
    cv::Mat strip = out.rowRange(rows);
    cv::cvtColor(image.rowRange(rows), strip, code);
  });
  return out;
}

cv::Mat BlurInStrips(const cv::Mat& image, cv::Size kernel, double sigma_px, int border) {
  cv::Mat out(image.size(), image.type());
  // OpenCV takes kernels of 3 or 4 deviations to each side.
  const int reach = kernel.height > 0 ? kernel.height / 2 : static_cast<int>(4.0 * sigma_px) + 2;
  ForEachStrip(
      image.size(),
      [&](const cv::Range& rows) {
        const cv::Range with_margin(std::max(0, rows.start - reach),
                                    std::min(image.rows, rows.end + reach));
        if (with_margin.size() == image.rows && rows.size() == image.rows) {
          cv::GaussianBlur(image, out, kernel, sigma_px, sigma_px, border);
          return;
        }
        // Isolated: the rounding of bytes differs where OpenCV reads around a part of an image.
        cv::Mat blurred;
        cv::GaussianBlur(image.rowRange(with_margin),
                         blurred,
                         kernel,
                         sigma_px,
                         sigma_px,
                         border | cv::BORDER_ISOLATED);
        const int first = rows.start - with_margin.start;
        blurred.rowRange(first, first + rows.size()).copyTo(out.rowRange(rows));
      },
      1,
      4 * reach);
  return out;
}

cv::Mat ShrinkInStrips(const cv::Mat& image, int factor) {
  const cv::Size size((image.cols + factor - 1) / factor, (image.rows + factor - 1) / factor);
  cv::Mat out(size, image.type());
  if (image.rows % factor != 0) {
    cv::resize(image, out, size, 0, 0, cv::INTER_AREA);
    return out;
  }
  ForEachStrip(
      image.size(),
      [&](const cv::Range& rows) {
        cv::Mat strip = out.rowRange(rows.start / factor, rows.end / factor);
        cv::resize(image.rowRange(rows), strip, strip.size(), 0, 0, cv::INTER_AREA);
      },
      factor);
  return out;
}

int StripFactor(cv::Size image, double size) {
  if (image.area() <= 4 * kStripPixels) return 1;
  int factor = static_cast<int>(0.5 / size);
  while (factor > 1 && (image.width % factor != 0 || image.height % factor != 0)) --factor;
  return std::max(1, factor);
}

cv::Mat EnlargeInStrips(const cv::Mat& image, int factor, cv::Size size) {
  cv::Mat out(size, image.type());
  if (size.height != factor * image.rows) {
    cv::resize(image, out, size, 0, 0, cv::INTER_LINEAR);
    return out;
  }
  ForEachStrip(
      size,
      [&](const cv::Range& rows) {
        const cv::Range from(std::max(0, rows.start / factor - 1),
                             std::min(image.rows, rows.end / factor + 1));
        cv::Mat strip;
        cv::resize(image.rowRange(from),
                   strip,
                   cv::Size(size.width, factor * from.size()),
                   0,
                   0,
                   cv::INTER_LINEAR);
        const int first = rows.start - factor * from.start;
        strip.rowRange(first, first + rows.size()).copyTo(out.rowRange(rows));
      },
      factor);
  return out;
}

cv::Mat Doubled(const cv::Mat& image) {
  cv::Mat out;
  cv::resize(image, out, {}, 2.0, 2.0, cv::INTER_CUBIC);
  return out;
}

}  // namespace horopter
