#include "server/overlay/drawing.h"

#include <algorithm>

#include "absl/strings/str_cat.h"
#include "absl/strings/str_format.h"

namespace horopter {
namespace {

constexpr double kTextWidth = 0.55;  // of a letter's height, of the sans-serif faces of browsers

std::string HexOf(const DrawingColor& c) {
  return absl::StrFormat("#%02x%02x%02x", c.red, c.green, c.blue);
}

// Names come from whoever enrolled the parts.
std::string Escaped(const std::string& text) {
  std::string out;
  for (const char c : text) {
    switch (c) {
      case '&':
        out += "&amp;";
        break;
      case '<':
        out += "&lt;";
        break;
      case '>':
        out += "&gt;";
        break;
      default:
        // XML 1.0 has no control characters.
        out += static_cast<unsigned char>(c) < 0x20 ? ' ' : c;
    }
  }
  return out;
}

// The top-left corner of an SVG is that of the pixel, not its centre.
std::string PointsOf(const Stroke& stroke) {
  std::string out;
  for (const Eigen::Vector2d& p : stroke.points) {
    absl::StrAppendFormat(&out, "%s%.1f,%.1f", out.empty() ? "" : " ", p.x() + 0.5, p.y() + 0.5);
  }
  return out;
}

}  // namespace

std::string ToSvg(const Drawing& drawing) {
  std::string svg = absl::StrFormat(
      "<svg xmlns=\"http://www.w3.org/2000/svg\" width=\"%d\" height=\"%d\" "
      "viewBox=\"0 0 %d %d\">\n<g fill=\"none\" stroke-linecap=\"round\" "
      "stroke-linejoin=\"round\">\n",
      drawing.width,
      drawing.height,
      drawing.width,
      drawing.height);
  for (const Stroke& s : drawing.strokes) {
    absl::StrAppendFormat(&svg,
                          "<polyline stroke=\"%s\" stroke-width=\"%.1f\" points=\"%s\"/>\n",
                          HexOf(s.color),
                          s.width_px,
                          PointsOf(s));
  }
  svg += "</g>\n<g font-family=\"sans-serif\">\n";
  for (const TextLabel& l : drawing.labels) {
    if (l.text.empty()) continue;
    const double x = l.at.x() + 0.5, y = l.at.y() + 0.5;
    absl::StrAppendFormat(&svg,
                          "<rect x=\"%.1f\" y=\"%.1f\" width=\"%.1f\" height=\"%.1f\" "
                          "fill=\"#191919\"/>\n",
                          x - 2.0,
                          y - l.height_px,
                          kTextWidth * l.height_px * static_cast<double>(l.text.size()) + 4.0,
                          1.3 * l.height_px);
    absl::StrAppendFormat(&svg,
                          "<text x=\"%.1f\" y=\"%.1f\" font-size=\"%.1f\" fill=\"%s\">%s</text>\n",
                          x,
                          y,
                          l.height_px,
                          HexOf(l.color),
                          Escaped(l.text));
  }
  return svg + "</g>\n</svg>\n";
}

}  // namespace horopter
