#include "server/overlay/paint.h"

#include <algorithm>
#include <cmath>
#include <opencv2/core.hpp>
#include <opencv2/imgproc.hpp>
#include <vector>

namespace horopter {
namespace {

constexpr int kFractionBits = 4;    // of a pixel, in OpenCV's sub-pixel drawing
constexpr double kLetterPx = 22.0;  // height of OpenCV's letters at scale 1
constexpr double kFarPx = 1e6;      // beyond it coordinates leave OpenCV's range

cv::Scalar ScalarOf(const DrawingColor& c) {
  return {static_cast<double>(c.blue), static_cast<double>(c.green), static_cast<double>(c.red)};
}

void PaintStroke(const Stroke& stroke, cv::Mat* image) {
  std::vector<cv::Point> points;
  for (const Eigen::Vector2d& p : stroke.points) {
    if (!(p.cwiseAbs().maxCoeff() < kFarPx)) return;
    const Eigen::Vector2d fixed = p * (1 << kFractionBits);
    points.emplace_back(static_cast<int>(std::lround(fixed.x())),
                        static_cast<int>(std::lround(fixed.y())));
  }
  cv::polylines(*image,
                points,
                false,
                ScalarOf(stroke.color),
                std::max(1, static_cast<int>(std::lround(stroke.width_px))),
                cv::LINE_AA,
                kFractionBits);
}

void PaintLabel(const TextLabel& label, cv::Mat* image) {
  if (label.text.empty() || !(label.at.cwiseAbs().maxCoeff() < kFarPx)) return;
  const double scale = label.height_px / kLetterPx;
  const cv::Point at(static_cast<int>(label.at.x()), static_cast<int>(label.at.y()));
  int below = 0;
  const cv::Size size = cv::getTextSize(label.text, cv::FONT_HERSHEY_SIMPLEX, scale, 1, &below);
  cv::rectangle(*image,
                at + cv::Point(-2, below),
                at + cv::Point(size.width + 2, -size.height - 2),
                {25, 25, 25},
                cv::FILLED);
  cv::putText(*image,
              label.text,
              at,
              cv::FONT_HERSHEY_SIMPLEX,
              scale,
              ScalarOf(label.color),
              1,
              cv::LINE_AA);
}

}  // namespace

cv::Mat Canvas(const cv::Mat& image) {
  if (image.channels() == 3) return image.clone();
  cv::Mat canvas;
  cv::cvtColor(image, canvas, cv::COLOR_GRAY2BGR);
  return canvas;
}

void Paint(const Drawing& drawing, cv::Mat* image) {
  for (const Stroke& s : drawing.strokes) PaintStroke(s, image);
  for (const TextLabel& l : drawing.labels) PaintLabel(l, image);
}

cv::Mat Tile(std::span<const cv::Mat> images, int tile_width) {
  if (images.empty()) return {};
  std::vector<cv::Mat> tiles;
  cv::Size cell(0, 0);
  for (const cv::Mat& image : images) {
    const double scale = std::min(1.0, static_cast<double>(tile_width) / image.cols);
    cv::Mat tile;
    cv::resize(image, tile, {}, scale, scale, cv::INTER_AREA);
    cell.width = std::max(cell.width, tile.cols);
    cell.height = std::max(cell.height, tile.rows);
    tiles.push_back(tile);
  }
  const int n = static_cast<int>(tiles.size());
  const int columns = static_cast<int>(std::ceil(std::sqrt(n)));
  const int rows = (n + columns - 1) / columns;
  cv::Mat out(rows * cell.height, columns * cell.width, CV_8UC3, cv::Scalar(30, 30, 30));
  for (int i = 0; i < n; ++i) {
    tiles[i].copyTo(
        out({i % columns * cell.width, i / columns * cell.height, tiles[i].cols, tiles[i].rows}));
  }
  return out;
}

}  // namespace horopter
