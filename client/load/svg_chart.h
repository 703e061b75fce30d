// A line chart as an SVG file.
#pragma once

#include <string>
#include <utility>
#include <vector>

namespace horopter {

struct SvgSeries {
  std::string name;
  std::vector<std::pair<double, double>> points;  // x ascending
};

struct SvgChart {
  std::string title, x_label, y_label;
  bool log_y = false;  // values must be > 0; others are left out
  std::vector<SvgSeries> series;
};

std::string SvgOf(const SvgChart& chart);

}  // namespace horopter
