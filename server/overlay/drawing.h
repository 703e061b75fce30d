// What is drawn over an image, as plain values: lines and texts in pixels of the image.
#pragma once

#include <Eigen/Core>
#include <cstdint>
#include <string>
#include <vector>

namespace horopter {

struct DrawingColor {
  std::uint8_t red = 0, green = 0, blue = 0;
};

// Pixels: the centre of the top-left pixel is (0, 0).
struct Stroke {
  std::vector<Eigen::Vector2d> points;  // joined by straight lines
  DrawingColor color;
  double width_px = 1.0;
};

// A line of text on a dark ground.
struct TextLabel {
  Eigen::Vector2d at = Eigen::Vector2d::Zero();  // left end of the base line
  std::string text;
  DrawingColor color;
  double height_px = 12.0;
};

// Drawn in the order of the lists, texts last.
struct Drawing {
  int width = 0;
  int height = 0;
  std::vector<Stroke> strokes;
  std::vector<TextLabel> labels;
};

// An SVG of the drawing's size on a transparent ground, to be laid over the image.
std::string ToSvg(const Drawing& drawing);

}  // namespace horopter
