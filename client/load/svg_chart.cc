#include "client/load/svg_chart.h"

#include <algorithm>
#include <cmath>
#include <limits>

#include "absl/strings/str_cat.h"
#include "absl/strings/str_format.h"

namespace horopter {
namespace {

constexpr double kWidth = 760, kHeight = 420, kLeft = 80, kRight = 100, kTop = 40, kBottom = 60;
constexpr const char* kColors[] = {"#1b6ca8", "#2a9d5c", "#d97706", "#b91c1c"};

std::string Escaped(const std::string& text) {
  std::string out;
  for (char c : text) {
    if (c == '&') {
      out += "&amp;";
    } else if (c == '<') {
      out += "&lt;";
    } else if (c == '>') {
      out += "&gt;";
    } else {
      out += static_cast<unsigned char>(c) < 32 ? ' ' : c;
    }
  }
  return out;
}

struct Axis {
  double low = 0, high = 1, from = 0, to = 1;
  bool log = false;

  double At(double value) const {
    const double share = log ? (std::log(value) - std::log(low)) / (std::log(high) - std::log(low))
                             : (value - low) / (high - low);
    return from + share * (to - from);
  }

  std::vector<double> Ticks() const {
    std::vector<double> ticks;
    if (log) {
      for (double decade = std::pow(10.0, std::floor(std::log10(low))); decade <= high;
           decade *= 10.0) {
        for (const double step : {1.0, 2.0, 5.0}) {
          const double t = decade * step;
          if (t >= low * 0.999 && t <= high * 1.001) ticks.push_back(t);
        }
      }
      return ticks;
    }
    const double raw = (high - low) / 6.0, power = std::pow(10.0, std::floor(std::log10(raw)));
    const double step = power * (raw / power < 1.5 ? 1 : raw / power < 3.5 ? 2 : 5);
    for (double t = std::ceil(low / step) * step; t <= high + 1e-9 * step; t += step) {
      ticks.push_back(t);
    }
    return ticks;
  }
};

std::string Text(double x, double y, const char* anchor, const std::string& text) {
  return absl::StrFormat(
      "<text x=\"%.1f\" y=\"%.1f\" text-anchor=\"%s\">%s</text>\n", x, y, anchor, Escaped(text));
}

bool Usable(const SvgChart& chart, const std::pair<double, double>& p) {
  return std::isfinite(p.first) && std::isfinite(p.second) && (!chart.log_y || p.second > 0.0);
}

// The k-th series with its legend.
void AppendSeries(const SvgChart& chart, int k, const Axis& x, const Axis& y, std::string* svg) {
  const SvgSeries& s = chart.series[k];
  const char* color = kColors[k % static_cast<int>(std::size(kColors))];
  std::string points;
  for (const auto& p : s.points) {
    if (Usable(chart, p))
      absl::StrAppend(&points, absl::StrFormat("%.1f,%.1f ", x.At(p.first), y.At(p.second)));
  }
  absl::StrAppend(svg,
                  "<polyline fill=\"none\" stroke-width=\"2\" stroke=\"",
                  color,
                  "\" points=\"",
                  points,
                  "\"/>\n");
  const double at = kTop + 18.0 * k;
  absl::StrAppend(svg,
                  absl::StrFormat("<path d=\"M%.1f %.1fh18\" stroke-width=\"3\" stroke=\"%s\"/>\n",
                                  kWidth - kRight + 12,
                                  at,
                                  color),
                  Text(kWidth - kRight + 36, at + 4, "start", s.name));
}

}  // namespace

std::string SvgOf(const SvgChart& chart) {
  double x_low = std::numeric_limits<double>::infinity(), x_high = -x_low;
  double y_low = x_low, y_high = -x_low;
  for (const SvgSeries& s : chart.series) {
    for (const auto& p : s.points) {
      if (!Usable(chart, p)) continue;
      x_low = std::min(x_low, p.first), x_high = std::max(x_high, p.first);
      y_low = std::min(y_low, p.second), y_high = std::max(y_high, p.second);
    }
  }
  if (!(x_low <= x_high)) x_low = 0, x_high = 1, y_low = chart.log_y ? 1 : 0, y_high = 10;
  if (x_high - x_low < 1e-9) x_low -= 0.5, x_high += 0.5;
  y_low *= chart.log_y ? 0.8 : 0.0;
  y_high = std::max(y_high * 1.2, y_low + 1e-6);
  const Axis x{x_low, x_high, kLeft, kWidth - kRight, false};
  const Axis y{y_low, y_high, kHeight - kBottom, kTop, chart.log_y};

  std::string svg = absl::StrFormat(
      "<svg xmlns=\"http://www.w3.org/2000/svg\" width=\"%.0f\" height=\"%.0f\" "
      "font-family=\"sans-serif\" font-size=\"12\">\n"
      "<rect width=\"100%%\" height=\"100%%\" fill=\"white\"/>\n",
      kWidth,
      kHeight);
  absl::StrAppend(&svg, Text(kWidth / 2, 22, "middle", chart.title));
  absl::StrAppend(&svg, Text((kLeft + kWidth - kRight) / 2, kHeight - 16, "middle", chart.x_label));
  absl::StrAppend(&svg, Text(8, kTop - 12, "start", chart.y_label));
  for (const double t : x.Ticks()) {
    absl::StrAppend(
        &svg,
        absl::StrFormat("<path d=\"M%.1f %.1fV%.1f\" stroke=\"#ddd\"/>\n", x.At(t), y.from, y.to),
        Text(x.At(t), y.from + 18, "middle", absl::StrFormat("%g", t)));
  }
  for (const double t : y.Ticks()) {
    absl::StrAppend(
        &svg,
        absl::StrFormat("<path d=\"M%.1f %.1fH%.1f\" stroke=\"#ddd\"/>\n", x.from, y.At(t), x.to),
        Text(x.from - 6, y.At(t) + 4, "end", absl::StrFormat("%g", t)));
  }
  for (size_t k = 0; k < chart.series.size(); ++k)
    AppendSeries(chart, static_cast<int>(k), x, y, &svg);
  return svg + "</svg>\n";
}

}  // namespace horopter
