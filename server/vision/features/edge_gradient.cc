#include "server/vision/features/edge_gradient.h"

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <opencv2/core.hpp>
#include <opencv2/imgproc.hpp>
#include <vector>

namespace horopter {
namespace {

// Rows are 16-bit with fixed point so that eight pixels fit a register: smoothed values are 8 x
// grey level, gradients 4 x the sum over 3x3 pixels.
constexpr int kPad = 8;               // columns left and right of a row
constexpr int kMaxGradient = 9800;    // keeps gradient x largest weight inside 16 bits
constexpr double kUnitsPerSum = 4.0;  // units of Size for |dx| + |dy| of one
constexpr int kMaxPlanes = 3;         // colours of an image
constexpr int kMaxChannels = 5;       // grey and opponent colours with them
// P(|dx| + |dy| < t) = erf(t / 2)^2 for standard normal dx, dy.
constexpr double kQuietShare = 0.05;
constexpr double kMedianPerQuiet = 1.487 / 0.402;
constexpr int kSampleRows = 24;  // of which the noise is measured

using Row = std::vector<int16_t>;

// One colour plane on its way down the image: binomial blur in both directions, row by row.
class SmoothRows {
 public:
  explicit SmoothRows(const cv::Mat& plane) : plane_(plane), width_(plane.cols) {
    for (Row& row : horizontal_) row.resize(width_ + 2 * kPad);
    for (Row& row : smooth_) row.resize(width_ + 2 * kPad);
    padded_.resize(width_ + 2 * kPad);
  }

  // Makes rows y - 1, y, y + 1 available; cheap when y follows the last call.
  void MoveTo(int y) {
    for (int s = (y == last_ + 1 ? y + 1 : y - 1); s <= y + 1; ++s) {
      Smooth(s);
    }
    last_ = y;
  }
  const int16_t* At(int y) const { return smooth_[(y + 3) % 3].data() + kPad; }

 private:
  const int16_t* Horizontal(int y) {
    y = std::clamp(y, 0, plane_.rows - 1);
    Row& row = horizontal_[y % 5];
    if (held_[y % 5] == y) {
      return row.data() + kPad;
    }
    held_[y % 5] = y;
    const uint8_t* source = plane_.ptr<uint8_t>(y);
    for (int x = 0; x < width_; ++x) padded_[x + kPad] = source[x];
    for (int k = 1; k <= 2; ++k) {
      padded_[kPad - k] = source[0];
      padded_[kPad + width_ - 1 + k] = source[width_ - 1];
    }
    const int16_t* __restrict in = padded_.data() + kPad;
    int16_t* __restrict out = row.data() + kPad;
    for (int x = 0; x < width_; ++x) {
      out[x] =
          static_cast<int16_t>(in[x - 2] + in[x + 2] + 4 * (in[x - 1] + in[x + 1]) + 6 * in[x]);
    }
    return out;
  }

  void Smooth(int y) {
    const auto* a = reinterpret_cast<const uint16_t*>(Horizontal(y - 2));
    const auto* b = reinterpret_cast<const uint16_t*>(Horizontal(y - 1));
    const auto* c = reinterpret_cast<const uint16_t*>(Horizontal(y));
    const auto* d = reinterpret_cast<const uint16_t*>(Horizontal(y + 1));
    const auto* e = reinterpret_cast<const uint16_t*>(Horizontal(y + 2));
    int16_t* __restrict out = smooth_[(y + 3) % 3].data() + kPad;
    for (int x = 0; x < width_; ++x) {
      // At most 256 x 255 + 16: fits 16 bits without sign.
      const auto sum = static_cast<uint16_t>(a[x] + e[x] + 4 * (b[x] + d[x]) + 6 * c[x] + 16);
      out[x] = static_cast<int16_t>(sum >> 5);
    }
    out[-1] = out[0];
    out[width_] = out[width_ - 1];
  }

  cv::Mat plane_;
  int width_;
  int last_ = -10;
  Row padded_;
  std::array<Row, 5> horizontal_;
  std::array<int, 5> held_ = {-1, -1, -1, -1, -1};
  std::array<Row, 3> smooth_;
};

void Differences(
    const SmoothRows& rows, int y, int width, int16_t* __restrict dx, int16_t* __restrict dy) {
  const int16_t* __restrict a = rows.At(y - 1);
  const int16_t* __restrict b = rows.At(y);
  const int16_t* __restrict c = rows.At(y + 1);
  for (int x = 0; x < width; ++x) {
    const auto right = static_cast<int16_t>(a[x + 1] + b[x + 1] + c[x + 1]);
    const auto left = static_cast<int16_t>(a[x - 1] + b[x - 1] + c[x - 1]);
    const auto down = static_cast<int16_t>(c[x - 1] + c[x] + c[x + 1]);
    const auto up = static_cast<int16_t>(a[x - 1] + a[x] + a[x + 1]);
    dx[x] = static_cast<int16_t>(right - left);
    dy[x] = static_cast<int16_t>(down - up);
  }
}

// Gradients of the channels at one row, 8 x sum over 3x3 pixels; opponent channels halved on the
// way: |1.5 (a - b)| would not fit.
struct ChannelRows {
  std::array<Row, kMaxChannels> dx, dy;
  explicit ChannelRows(int width) {
    for (int c = 0; c < kMaxChannels; ++c) {
      dx[c].resize(width);
      dy[c].resize(width);
    }
  }
};

void Opponents(int width,
               const int16_t* __restrict b,
               const int16_t* __restrict g,
               const int16_t* __restrict r,
               int16_t* __restrict red_green,
               int16_t* __restrict yellow_blue) {
  for (int x = 0; x < width; ++x) {
    const auto difference = static_cast<int16_t>(r[x] - g[x]);
    red_green[x] = static_cast<int16_t>(difference + (difference >> 1));
    const auto yellow = static_cast<int16_t>(((r[x] + g[x]) >> 1) - b[x]);
    yellow_blue[x] = static_cast<int16_t>(yellow + (yellow >> 1));
  }
}

inline int16_t Size(int16_t dx, int16_t dy) {
  const auto ax = static_cast<int16_t>(dx < 0 ? -dx : dx);
  const auto ay = static_cast<int16_t>(dy < 0 ? -dy : dy);
  return static_cast<int16_t>((ax >> 1) + (ay >> 1));
}

inline int16_t Weighted(int16_t size, uint16_t weight) {
  const auto bounded = static_cast<uint16_t>(4 * (size < kMaxGradient ? size : kMaxGradient));
  return static_cast<int16_t>((static_cast<uint32_t>(bounded) * weight) >> 16);
}

double Quantile(const std::array<int, 4096>& histogram, int total, double share) {
  int below = 0;
  for (int bin = 0; bin < 4096; ++bin) {
    below += histogram[bin];
    if (below >= share * total) {
      return bin / kUnitsPerSum;
    }
  }
  return 4096 / kUnitsPerSum;
}

class FieldMaker {
 public:
  FieldMaker(const cv::Mat& image, const GradientOptions& options)
      : options_(options),
        width_(image.cols),
        height_(image.rows),
        rows_(image.cols),
        low_(image.cols) {
    std::vector<cv::Mat> planes;
    if (image.channels() == 3 && options.colour != ColourGradient::kIntensity) {
      cv::split(image, planes);
    } else if (image.channels() == 3) {
      planes.resize(1);
      cv::cvtColor(image, planes[0], cv::COLOR_BGR2GRAY);
    } else {
      planes = {image};
    }
    for (const cv::Mat& plane : planes) {
      planes_.emplace_back(plane);
    }
    channels_ = planes.size() == 3 ? kMaxChannels : 1;
  }

  std::vector<GradientField> Make() {
    MeasureNoise();
    const bool each = channels_ > 1 && options_.colour == ColourGradient::kEachChannel;
    std::vector<GradientField> fields(each ? channels_ : 1);
    for (size_t c = 0; c < fields.size(); ++c) {
      fields[c].threshold = field_.threshold;
      fields[c].median_gradient = field_.median_gradient;
      fields[c].magnitude.create(height_, width_, CV_16SC1);
      fields[c].dx.create(height_, width_, CV_16SC1);
      fields[c].dy.create(height_, width_, CV_16SC1);
      if (each || channels_ == 1) {
        fields[c].single_channel = static_cast<int>(c);
      } else {
        fields[c].channel.create(height_, width_, CV_8UC1);
      }
    }
    if (!each) field_ = fields[0];  // shares the pixels
    for (int y = 0; y < height_; ++y) {
      Gradients(y);
      if (each || channels_ == 1) {
        for (size_t c = 0; c < fields.size(); ++c) Single(y, static_cast<int>(c), &fields[c]);
      } else if (options_.colour == ColourGradient::kStrongestChannel) {
        Strongest(y);
      } else if (options_.colour == ColourGradient::kVectorValued) {
        VectorValued(y);
      } else {
        SaturationWeighted(y);
      }
    }
    return fields;
  }

 private:
  void Gradients(int y) {
    for (size_t p = 0; p < planes_.size(); ++p) {
      planes_[p].MoveTo(y);
      Differences(planes_[p], y, width_, rows_.dx[p].data(), rows_.dy[p].data());
    }
    if (channels_ == kMaxChannels) {
      Opponents(width_,
                rows_.dx[0].data(),
                rows_.dx[1].data(),
                rows_.dx[2].data(),
                rows_.dx[3].data(),
                rows_.dx[4].data());
      Opponents(width_,
                rows_.dy[0].data(),
                rows_.dy[1].data(),
                rows_.dy[2].data(),
                rows_.dy[3].data(),
                rows_.dy[4].data());
    }
  }

  void MeasureNoise() {
    std::array<std::array<int, 4096>, kMaxChannels> histogram{};
    int total = 0;
    const int samples = std::min(kSampleRows, height_);
    for (int s = 0; s < samples; ++s) {
      Gradients(static_cast<int>((s + 0.5) * height_ / samples));
      for (int x = 0; x < width_; x += 2) {
        for (int c = 0; c < channels_; ++c) {
          ++histogram[c][std::min<int>(Size(rows_.dx[c][x], rows_.dy[c][x]), 4095)];
        }
        ++total;
      }
    }
    for (int c = 0; c < channels_; ++c) {
      const double median = Quantile(histogram[c], total, 0.5);
      // What the median would be if the quietest 5 % were typical: texture counts less.
      const double quiet = kMedianPerQuiet * Quantile(histogram[c], total, kQuietShare);
      const double bound = std::clamp(options_.noise_factor * median,
                                      std::min(options_.min_threshold, options_.max_threshold),
                                      options_.max_threshold);
      field_.median_gradient[c] = median;
      field_.threshold[c] = std::max(bound, options_.noise_floor * quiet);
      weight_[c] = kThresholdUnits / (kUnitsPerSum * field_.threshold[c]);
    }
  }

  // size x weight with 14 fractional bits; a product's upper half is one instruction.
  uint16_t FixedWeight(int c) const {
    return static_cast<uint16_t>(std::lround(std::min(weight_[c], 3.99) * 16384.0));
  }

  void Single(int y, int c, GradientField* field) {
    int16_t* __restrict magnitude = field->magnitude.ptr<int16_t>(y);
    int16_t* __restrict out_dx = field->dx.ptr<int16_t>(y);
    int16_t* __restrict out_dy = field->dy.ptr<int16_t>(y);
    const int16_t* __restrict dx = rows_.dx[c].data();
    const int16_t* __restrict dy = rows_.dy[c].data();
    const uint16_t weight = FixedWeight(c);
    for (int x = 0; x < width_; ++x) {
      magnitude[x] = Weighted(Size(dx[x], dy[x]), weight);
      out_dx[x] = static_cast<int16_t>(dx[x] >> 1);
      out_dy[x] = static_cast<int16_t>(dy[x] >> 1);
    }
  }

  void Strongest(int y) {
    int16_t* __restrict best = field_.magnitude.ptr<int16_t>(y);
    int16_t* __restrict best_dx = field_.dx.ptr<int16_t>(y);
    int16_t* __restrict best_dy = field_.dy.ptr<int16_t>(y);
    int16_t* __restrict which = low_.data();
    for (int c = 0; c < channels_; ++c) {
      const int16_t* __restrict dx = rows_.dx[c].data();
      const int16_t* __restrict dy = rows_.dy[c].data();
      const uint16_t weight = FixedWeight(c);
      const auto index = static_cast<int16_t>(c);
      for (int x = 0; x < width_; ++x) {
        const int16_t weighted = Weighted(Size(dx[x], dy[x]), weight);
        const bool first = c == 0;
        const bool wins = first || weighted > best[x];
        best[x] = wins ? weighted : best[x];
        best_dx[x] = wins ? static_cast<int16_t>(dx[x] >> 1) : best_dx[x];
        best_dy[x] = wins ? static_cast<int16_t>(dy[x] >> 1) : best_dy[x];
        which[x] = wins ? index : which[x];
      }
    }
    uint8_t* __restrict channel = field_.channel.ptr<uint8_t>(y);
    for (int x = 0; x < width_; ++x) channel[x] = static_cast<uint8_t>(which[x]);
  }

  // Largest eigenvalue of the tensor (E F; F G) and its direction, signed like the channel that
  // changes most.
  void Store(int y, int x, float E, float F, float G, float weight, int strongest) {
    const float half = 0.5f * (E - G);
    const float root = std::sqrt(half * half + F * F);
    const float lambda = 0.5f * (E + G) + root;
    // Eigenvector (lambda - G, F) or (F, lambda - E), whichever is longer.
    float vx = half >= 0.0f ? half + root : F;
    float vy = half >= 0.0f ? F : root - half;
    const float norm = std::sqrt(vx * vx + vy * vy);
    const float size = std::sqrt(std::max(lambda, 0.0f));
    const float scale = norm > 1e-6f ? size / norm : 0.0f;
    vx *= scale;
    vy *= scale;
    if (vx * rows_.dx[strongest][x] + vy * rows_.dy[strongest][x] < 0.0f) {
      vx = -vx;
      vy = -vy;
    }
    field_.dx.ptr<int16_t>(y)[x] = static_cast<int16_t>(std::lround(0.5f * vx));
    field_.dy.ptr<int16_t>(y)[x] = static_cast<int16_t>(std::lround(0.5f * vy));
    field_.channel.ptr<uint8_t>(y)[x] = static_cast<uint8_t>(strongest);
    const float sum = 0.5f * weight * (std::abs(vx) + std::abs(vy));
    field_.magnitude.ptr<int16_t>(y)[x] = static_cast<int16_t>(std::min(sum, 32000.0f));
  }

  int StrongestPlane(int x) const {
    int best = 0;
    for (int c = 1; c < kMaxPlanes; ++c) {
      if (Size(rows_.dx[c][x], rows_.dy[c][x]) > Size(rows_.dx[best][x], rows_.dy[best][x])) {
        best = c;
      }
    }
    return best;
  }

  // The noise of the tensor's root is about that of its noisiest plane.
  float PlaneWeight() const {
    return static_cast<float>(std::min({weight_[0], weight_[1], weight_[2]}));
  }

  void VectorValued(int y) {
    for (int x = 0; x < width_; ++x) {
      float E = 0.0f, F = 0.0f, G = 0.0f;
      for (int c = 0; c < kMaxPlanes; ++c) {
        const float dx = rows_.dx[c][x], dy = rows_.dy[c][x];
        E += dx * dx;
        F += dx * dy;
        G += dy * dy;
      }
      // Equal steps in all planes have the size they have in grey.
      Store(y, x, E / 3.0f, F / 3.0f, G / 3.0f, PlaneWeight(), StrongestPlane(x));
    }
  }

  void SaturationWeighted(int y) {
    constexpr float kFullSaturation = 0.5f;  // of (max - min) / max
    constexpr float kDark = 8.0f * 24.0f;    // below this brightness the ratio is noise
    for (int x = 0; x < width_; ++x) {
      const float b = planes_[0].At(y)[x], g = planes_[1].At(y)[x], r = planes_[2].At(y)[x];
      const float brightest = std::max({b, g, r});
      const float spread = brightest - std::min({b, g, r});
      const float s = std::min(spread / (kFullSaturation * std::max(brightest, kDark)), 1.0f);
      float E = 0.0f, F = 0.0f, G = 0.0f;
      const auto add = [&](float weight, float dx, float dy) {
        E += weight * weight * dx * dx;
        F += weight * weight * dx * dy;
        G += weight * weight * dy * dy;
      };
      add(1.0f - s,
          0.114f * rows_.dx[0][x] + 0.587f * rows_.dx[1][x] + 0.299f * rows_.dx[2][x],
          0.114f * rows_.dy[0][x] + 0.587f * rows_.dy[1][x] + 0.299f * rows_.dy[2][x]);
      add(s, rows_.dx[3][x], rows_.dy[3][x]);
      add(s, rows_.dx[4][x], rows_.dy[4][x]);
      const auto opponent = static_cast<float>(std::min(weight_[3], weight_[4]));
      Store(y, x, E, F, G, (1.0f - s) * PlaneWeight() + s * opponent, StrongestPlane(x));
    }
  }

  GradientOptions options_;
  int width_;
  int height_;
  int channels_ = 1;
  std::vector<SmoothRows> planes_;
  ChannelRows rows_;
  Row low_;
  std::array<double, kMaxChannels> weight_{};
  GradientField field_;
};

}  // namespace

std::vector<GradientField> MakeGradientFields(const cv::Mat& image,
                                              const GradientOptions& options) {
  return FieldMaker(image, options).Make();
}

GradientField StrongestOf(std::span<const GradientField> fields) {
  GradientField best = fields.front();
  if (fields.size() == 1) {
    return best;
  }
  best.magnitude = best.magnitude.clone();
  best.dx = best.dx.clone();
  best.dy = best.dy.clone();
  best.channel = cv::Mat(best.dx.size(), CV_8UC1, cv::Scalar(best.single_channel));
  best.single_channel = -1;
  for (const GradientField& field : fields.subspan(1)) {
    best.threshold[field.single_channel] = field.threshold[field.single_channel];
    best.median_gradient[field.single_channel] = field.median_gradient[field.single_channel];
    const auto channel = static_cast<uint8_t>(field.single_channel);
    for (int y = 0; y < best.dx.rows; ++y) {
      const int16_t* __restrict magnitude = field.magnitude.ptr<int16_t>(y);
      const int16_t* __restrict dx = field.dx.ptr<int16_t>(y);
      const int16_t* __restrict dy = field.dy.ptr<int16_t>(y);
      int16_t* __restrict best_magnitude = best.magnitude.ptr<int16_t>(y);
      int16_t* __restrict best_dx = best.dx.ptr<int16_t>(y);
      int16_t* __restrict best_dy = best.dy.ptr<int16_t>(y);
      uint8_t* __restrict best_channel = best.channel.ptr<uint8_t>(y);
      for (int x = 0; x < best.dx.cols; ++x) {
        const bool wins = magnitude[x] > best_magnitude[x];
        best_magnitude[x] = wins ? magnitude[x] : best_magnitude[x];
        best_dx[x] = wins ? dx[x] : best_dx[x];
        best_dy[x] = wins ? dy[x] : best_dy[x];
        best_channel[x] = wins ? channel : best_channel[x];
      }
    }
  }
  return best;
}

}  // namespace horopter
