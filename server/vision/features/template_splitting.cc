#include "server/vision/features/template_splitting.h"

#include <algorithm>
#include <cmath>
#include <string>

namespace horopter {
namespace {

constexpr int kMaxTemplateLength = 1000;  // points; chains are shorter
constexpr size_t kMaxTemplates = 64;      // for time

// Zero mean, unit norm.
std::vector<double> Samples(const CurvatureTemplate& shape) {
  std::vector<double> values;
  const int n = shape.Length();
  for (int i = 0; i < n; ++i) {
    const double s =
        std::clamp((i - shape.before + 0.5) / std::max(shape.middle, 1), 0.0, 1.0);  // through L2
    switch (shape.shape) {
      case TemplateShape::kPeak:
        values.push_back(1.0 - std::abs(2.0 * s - 1.0));
        break;
      case TemplateShape::kStepUp:
        values.push_back(s);
        break;
      case TemplateShape::kStepDown:
        values.push_back(1.0 - s);
        break;
    }
  }
  double mean = 0.0, square = 0.0;
  for (double v : values) mean += v / n;
  for (double& v : values) {
    v -= mean;
    square += v * v;
  }
  for (double& v : values) v /= std::sqrt(square);
  return values;
}

}  // namespace

std::vector<CurvatureTemplate> DefaultTemplates() {
  return {{TemplateShape::kPeak, 4, 7, 4},
          {TemplateShape::kPeak, 6, 11, 6},
          {TemplateShape::kStepUp, 8, 7, 8},
          {TemplateShape::kStepUp, 14, 11, 14},
          {TemplateShape::kStepDown, 8, 7, 8},
          {TemplateShape::kStepDown, 14, 11, 14}};
}

absl::Status Validate(const TemplateSplittingOptions& options) {
  if (options.templates.empty() || options.templates.size() > kMaxTemplates) {
    return absl::InvalidArgumentError("templates: need 1 to 64, got " +
                                      std::to_string(options.templates.size()));
  }
  for (const CurvatureTemplate& t : options.templates) {
    if (t.before < 1 || t.middle < 1 || t.after < 1 || t.before > kMaxTemplateLength ||
        t.middle > kMaxTemplateLength || t.after > kMaxTemplateLength) {
      return absl::InvalidArgumentError("templates: lengths must be 1 to 1000 points");
    }
  }
  if (!(options.threshold > 0.0 && options.threshold <= 1.0)) {
    return absl::InvalidArgumentError("threshold: need a correlation in (0, 1], got " +
                                      std::to_string(options.threshold));
  }
  if (!(options.noise_curvature >= 0.0) || !std::isfinite(options.noise_curvature)) {
    return absl::InvalidArgumentError("noise_curvature: need a finite value >= 0");
  }
  if (options.suppression < 1) {
    return absl::InvalidArgumentError("suppression: need at least 1 point, got " +
                                      std::to_string(options.suppression));
  }
  return absl::OkStatus();
}

std::vector<double> TemplateCorrelation(std::span<const double> curvature,
                                        bool closed,
                                        const CurvatureTemplate& shape,
                                        double noise_curvature) {
  const int n = static_cast<int>(curvature.size());
  std::vector<double> correlation(curvature.size(), 0.0);
  if (n == 0) return correlation;
  const std::vector<double> samples = Samples(shape);
  const int length = shape.Length(), middle = shape.before + shape.middle / 2;
  // One copy with the continuation, so that the inner loops need no test.
  std::vector<double> padded(n + length);
  for (int i = 0; i < n + length; ++i) {
    const int k = i - middle;
    padded[i] = curvature[closed ? ((k % n) + n) % n : std::clamp(k, 0, n - 1)];
  }
  const double noise = length * noise_curvature * noise_curvature;
  for (int i = 0; i < n; ++i) {
    double sum = 0.0, square = 0.0, product = 0.0;
    for (int k = 0; k < length; ++k) {
      const double v = padded[i + k];
      sum += v;
      square += v * v;
      product += v * samples[k];
    }
    const double energy = square - sum * sum / length;
    // What rounding leaves of a constant signal is no shape.
    if (energy > 1e-12 * square) correlation[i] = product / std::sqrt(energy + noise);
  }
  return correlation;
}

std::vector<int> SuppressNonMaxima(std::span<const double> values,
                                   std::span<const int> reach,
                                   bool closed,
                                   double threshold,
                                   int suppression) {
  const int n = static_cast<int>(values.size());
  std::vector<int> order, kept;
  for (int i = 0; i < n; ++i) {
    if (values[i] > threshold) order.push_back(i);
  }
  std::stable_sort(order.begin(), order.end(), [&](int a, int b) { return values[a] > values[b]; });
  std::vector<bool> blocked(values.size(), false), sharp(values.size(), false);
  const auto each_within = [&](int i, int distance, const auto& visit) {
    distance = std::min(distance, n);
    for (int k = -distance; k <= distance; ++k) {
      const int j = closed ? (i + k + n) % n : i + k;
      if (j >= 0 && j < n) visit(j);
    }
  };
  for (int i : order) {
    if (blocked[i]) continue;
    bool flank = false;
    if (!reach.empty() && reach[i] > 0) {
      each_within(i, reach[i], [&](int j) { flank = flank || sharp[j]; });
    }
    if (flank) continue;
    kept.push_back(i);
    sharp[i] = reach.empty() || reach[i] == 0;
    each_within(i, suppression, [&](int j) { blocked[j] = true; });
  }
  std::sort(kept.begin(), kept.end());
  return kept;
}

std::vector<int> FindTemplateCuts(std::span<const double> curvature,
                                  bool closed,
                                  const TemplateSplittingOptions& options) {
  std::vector<double> best(curvature.size(), 0.0);
  std::vector<int> reach(curvature.size(), 0);
  for (const CurvatureTemplate& shape : options.templates) {
    const std::vector<double> correlation =
        TemplateCorrelation(curvature, closed, shape, options.noise_curvature);
    for (size_t i = 0; i < best.size(); ++i) {
      if (std::abs(correlation[i]) <= best[i]) continue;
      best[i] = std::abs(correlation[i]);
      reach[i] = shape.shape == TemplateShape::kPeak ? 0 : shape.Length() / 2;
    }
  }
  return SuppressNonMaxima(best, reach, closed, options.threshold, options.suppression);
}

}  // namespace horopter
