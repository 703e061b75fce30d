#include "server/vision/features/segment_fit.h"

#include <algorithm>
#include <array>
#include <cmath>

namespace horopter {
namespace {

constexpr int kReachPx = 3;       // peaks are looked for this far across the line
constexpr int kMaxSamples = 160;  // along one segment; longer ones are sampled more coarsely
constexpr double kTukeyPx = 1.0;  // samples farther than this from the line do not count
constexpr int kTukeyRounds = 5;
constexpr int kMaxExtensionPx = 16;         // the detector's ends are drawn out at most this far
constexpr double kExtensionOffsetPx = 0.8;  // ... while the peak stays this near the line
constexpr float kExtensionShare = 0.5f;     // ... and has this share of the segment's mean gradient
constexpr double kMinPeakShare = 0.5;       // of the positions along the line

struct Profile {
  std::array<float, 2 * kReachPx + 1> gradient{};  // per pixel, towards `across`
  float step = 0.0f;                               // value at +reach minus value at -reach
};

Profile SampleProfile(const cv::Mat& smooth,
                      const Eigen::Vector2d& at,
                      const Eigen::Vector2d& across) {
  std::array<float, 2 * kReachPx + 3> value;
  for (int t = -kReachPx - 1; t <= kReachPx + 1; ++t) {
    const Eigen::Vector2d p = at + t * across;
    value[t + kReachPx + 1] =
        SampleBilinear(smooth, static_cast<float>(p.x()), static_cast<float>(p.y()));
  }
  Profile profile;
  for (int k = 0; k < 2 * kReachPx + 1; ++k) {
    profile.gradient[k] = 0.5f * (value[k + 2] - value[k]);
  }
  profile.step = value[2 * kReachPx + 1] - value[1];
  return profile;
}

// Peak position relative to the middle of the profile; empty when the largest value lies on the
// border.
std::optional<float> PeakOffset(const Profile& profile, float sign, float min_gradient) {
  int best = 1;
  for (int k = 1; k < 2 * kReachPx; ++k) {
    if (sign * profile.gradient[k] > sign * profile.gradient[best]) {
      best = k;
    }
  }
  const float before = sign * profile.gradient[best - 1];
  const float peak = sign * profile.gradient[best];
  const float after = sign * profile.gradient[best + 1];
  if (peak < min_gradient || before > peak || after > peak) {
    return std::nullopt;
  }
  const float curvature = before - 2.0f * peak + after;
  const float shift = curvature < -1e-6f ? 0.5f * (before - after) / curvature : 0.0f;
  return static_cast<float>(best - kReachPx) + std::clamp(shift, -0.5f, 0.5f);
}

struct RobustLine {
  Eigen::Vector2d point = Eigen::Vector2d::Zero();
  Eigen::Vector2d direction = Eigen::Vector2d::UnitX();
  double rms_px = 0.0;
  double inlier_share = 0.0;
};

// Total least squares with weights gradient x Tukey.
RobustLine FitRobustLine(const std::vector<EdgeSample>& samples,
                         const Eigen::Vector2d& start_point,
                         const Eigen::Vector2d& start_direction) {
  RobustLine line = {start_point, start_direction, 0.0, 0.0};
  for (int round = 0; round < kTukeyRounds; ++round) {
    const Eigen::Vector2d normal(-line.direction.y(), line.direction.x());
    // Wide at first: the detector's line may be half a pixel off and slightly turned.
    const double width = kTukeyPx * (round == 0 ? 3.0 : round == 1 ? 1.5 : 1.0);
    double sum = 0.0, square = 0.0;
    int inliers = 0;
    Eigen::Vector2d mean = Eigen::Vector2d::Zero();
    Eigen::Matrix2d moment = Eigen::Matrix2d::Zero();
    for (const EdgeSample& sample : samples) {
      const Eigen::Vector2d p = sample.point.cast<double>();
      const double residual = normal.dot(p - line.point);
      const double u = residual / width;
      if (std::abs(u) >= 1.0) {
        continue;
      }
      const double weight = sample.gradient * (1.0 - u * u) * (1.0 - u * u);
      const Eigen::Vector2d q = p - start_point;
      sum += weight;
      mean += weight * q;
      moment += weight * q * q.transpose();
      square += residual * residual;
      ++inliers;
    }
    if (inliers < 4 || sum <= 0.0) {
      return line;
    }
    mean /= sum;
    const Eigen::Matrix2d cov = moment / sum - mean * mean.transpose();
    const double angle = 0.5 * std::atan2(2.0 * cov(0, 1), cov(0, 0) - cov(1, 1));
    Eigen::Vector2d direction(std::cos(angle), std::sin(angle));
    if (direction.dot(start_direction) < 0.0) {
      direction = -direction;
    }
    line = {start_point + mean,
            direction,
            std::sqrt(square / inliers),
            static_cast<double>(inliers) / samples.size()};
  }
  return line;
}

// Walks outward from `end` along the fitted line as long as the same edge goes on; returns the new
// end and appends the samples met. `right_to_bright` is the unit normal towards the brighter side.
Eigen::Vector2d ExtendEnd(const cv::Mat& smooth,
                          const Eigen::Vector2d& end,
                          const Eigen::Vector2d& outward,
                          const Eigen::Vector2d& right_to_bright,
                          float min_gradient,
                          std::vector<EdgeSample>* samples) {
  Eigen::Vector2d last = end;
  int misses = 0;
  for (int step = 1; step <= kMaxExtensionPx && misses < 2; ++step) {
    const Eigen::Vector2d at = end + step * outward;
    if (at.x() < 1.0 || at.y() < 1.0 || at.x() > smooth.cols - 2.0 || at.y() > smooth.rows - 2.0) {
      break;
    }
    const Profile profile = SampleProfile(smooth, at, right_to_bright);
    const std::optional<float> offset = PeakOffset(profile, 1.0f, min_gradient);
    if (!offset || std::abs(*offset) > kExtensionOffsetPx) {
      ++misses;
      continue;
    }
    misses = 0;
    last = at;
    samples->push_back({(at + *offset * right_to_bright).cast<float>(), min_gradient});
  }
  return last;
}

}  // namespace

std::optional<FittedSegment> FitSegment(const RawLine& raw,
                                        const DetectionChannel& channel,
                                        int channel_index,
                                        double min_gradient,
                                        double min_length_px) {
  const double length = (raw.end - raw.start).norm();
  if (length < min_length_px) {
    return std::nullopt;
  }
  const Eigen::Vector2d direction = (raw.end - raw.start) / length;
  const Eigen::Vector2d right(-direction.y(), direction.x());
  const int count = std::clamp(static_cast<int>(length) + 1, 2, kMaxSamples);
  std::vector<Profile> profiles(count);
  double polarity = 0.0;
  for (int i = 0; i < count; ++i) {
    const Eigen::Vector2d at = raw.start + direction * (length * i / (count - 1));
    profiles[i] = SampleProfile(channel.smooth, at, right);
    for (int k = 1; k < 2 * kReachPx; ++k) {
      // Near the line counts more: a parallel edge of the other sign may be within reach.
      polarity += profiles[i].gradient[k] / (1.0 + std::abs(k - kReachPx));
    }
  }
  const float sign = polarity >= 0.0 ? 1.0f : -1.0f;
  FittedSegment fitted;
  double step = 0.0;
  for (int i = 0; i < count; ++i) {
    const std::optional<float> offset =
        PeakOffset(profiles[i], sign, static_cast<float>(min_gradient));
    if (!offset) {
      continue;
    }
    const Eigen::Vector2d at = raw.start + direction * (length * i / (count - 1)) + *offset * right;
    const float gradient = *std::max_element(
        profiles[i].gradient.begin(), profiles[i].gradient.end(), [sign](float a, float b) {
          return sign * a < sign * b;
        });
    fitted.samples.push_back({at.cast<float>(), sign * gradient});
    step += sign * profiles[i].step;
  }
  if (fitted.samples.size() < std::max(4.0, kMinPeakShare * count)) {
    return std::nullopt;
  }
  const auto peaks = static_cast<double>(fitted.samples.size());
  const RobustLine line = FitRobustLine(fitted.samples, 0.5 * (raw.start + raw.end), direction);
  if (line.inlier_share < kMinPeakShare || std::abs(line.direction.dot(direction)) < 0.97) {
    return std::nullopt;
  }
  Segment& segment = fitted.segment;
  segment.start = line.point + line.direction * line.direction.dot(raw.start - line.point);
  segment.end = line.point + line.direction * line.direction.dot(raw.end - line.point);
  if (sign < 0.0f) {
    std::swap(segment.start, segment.end);
  }
  double mean_gradient = 0.0;
  for (const EdgeSample& sample : fitted.samples) {
    mean_gradient += sample.gradient / static_cast<double>(fitted.samples.size());
  }
  const float enough = std::max(static_cast<float>(min_gradient),
                                kExtensionShare * static_cast<float>(mean_gradient));
  const Eigen::Vector2d along = (segment.end - segment.start).normalized();
  const Eigen::Vector2d bright(-along.y(), along.x());
  segment.start = ExtendEnd(channel.smooth, segment.start, -along, bright, enough, &fitted.samples);
  segment.end = ExtendEnd(channel.smooth, segment.end, along, bright, enough, &fitted.samples);
  segment.contrast = std::max(step / peaks, 0.0);
  segment.rms_px = line.rms_px;
  segment.channel = channel_index;
  return fitted;
}

Segment FitLineToSamples(const std::vector<EdgeSample>& samples,
                         const std::vector<Eigen::Vector2d>& ends,
                         const Segment& like) {
  const Eigen::Vector2d direction = (like.end - like.start).normalized();
  const RobustLine line = FitRobustLine(samples, 0.5 * (like.start + like.end), direction);
  double lowest = 1e18, highest = -1e18;
  for (const Eigen::Vector2d& end : ends) {
    const double s = line.direction.dot(end - line.point);
    lowest = std::min(lowest, s);
    highest = std::max(highest, s);
  }
  Segment segment = like;
  segment.start = line.point + lowest * line.direction;
  segment.end = line.point + highest * line.direction;
  segment.rms_px = line.rms_px;
  return segment;
}

}  // namespace horopter
