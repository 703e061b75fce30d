#include "server/vision/features/segment_fit.h"

#include <algorithm>
#include <array>
#include <cmath>

namespace horopter {
namespace {

constexpr int kReachPx = 3;          // peaks are looked for this far across the line
constexpr int kMaxFitSamples = 160;  // along one segment; longer ones are sampled more coarsely
constexpr double kTukeyPx = 1.0;     // samples farther than this from the line do not count
// Neighbouring points err alike: the detector's smoothing along the edge, sigma^2 = 1 + 2/3.
constexpr double kCorrelationPx = 4.8;
constexpr double kMinSigmaPx = 0.05;        // what pixel sampling leaves without noise
constexpr double kTukeyPerRms = 3.0;        // ... from the third round on
constexpr double kMinTukeyPx = 0.3;         // ... and never narrower
constexpr int kTukeyRounds = 5;             // of reweighting
constexpr int kMaxExtensionPx = 16;         // the detector's ends are drawn out at most this far
constexpr double kExtensionOffsetPx = 0.8;  // ... while the peak stays this near the line
constexpr float kExtensionShare = 0.5f;     // ... and has this share of the segment's mean gradient
constexpr int kChainRounds = 4;             // chain points start nearer to the line
constexpr int kRoundedFrom = 16;            // pieces of this many points can spare
constexpr int kRoundedPoints = 3;           // ... so many at each end
constexpr double kMinInlierShare = 0.6;     // of a chain's samples, to be one line
// Shorter pieces may be noise: they must be straighter and stronger.
constexpr double kSurelyEdgePx = 20.0;
constexpr double kMaxShortRms = 0.7;        // px, at kSurelyEdgePx
constexpr double kMinShortStrength = 40.0;  // slope x length, grey levels
// Height of a step over its steepest slope after the detector's smoothing: sqrt(2 pi) sigma with
// sigma^2 = 1 (binomial) + 2/3 (differences) + 0.8^2 (optics, typical).
constexpr float kStepPerSlope = 4.5f;
constexpr double kMinPeakShare = 0.5;  // of the positions along the line

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
RobustLine FitRobustLine(const std::vector<GradientPeak>& samples,
                         const Eigen::Vector2d& start_point,
                         const Eigen::Vector2d& start_direction,
                         int rounds = kTukeyRounds) {
  RobustLine line = {start_point, start_direction, 0.0, 0.0};
  for (int round = 0; round < rounds; ++round) {
    const Eigen::Vector2d normal(-line.direction.y(), line.direction.x());
    // Wide at first: the detector's line may be half a pixel off and slightly turned.
    double width = kTukeyPx * (round == 0 ? 3.0 : round == 1 ? 1.5 : 1.0);
    if (round >= 2) {
      // Bent ends stand out from a clean edge.
      width = std::clamp(kTukeyPerRms * line.rms_px, kMinTukeyPx, width);
    }
    double sum = 0.0, square = 0.0;
    int inliers = 0;
    Eigen::Vector2d mean = Eigen::Vector2d::Zero();
    Eigen::Matrix2d moment = Eigen::Matrix2d::Zero();
    for (const GradientPeak& sample : samples) {
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

// Total least squares over n points at one pixel's distance: var(offset at the middle) = s^2 / m
// and var(angle) = 12 s^2 / (m L^2), with m = n / correlation length independent points.
void SetDeviations(size_t samples, Segment* segment) {
  const double length = std::max(segment->Length(), 1.0);
  const double independent =
      std::max(std::min<double>(static_cast<double>(samples), length) / kCorrelationPx, 2.0);
  const double sigma = std::max(segment->rms_px, kMinSigmaPx);
  segment->offset_sigma_px = sigma / std::sqrt(independent);
  segment->angle_sigma_rad = sigma * std::sqrt(12.0 / independent) / length;
}

// Walks outward from `end` along the fitted line as long as the same edge goes on; returns the new
// end and appends the samples met. `right_to_bright` is the unit normal towards the brighter side.
Eigen::Vector2d ExtendEnd(const cv::Mat& smooth,
                          const Eigen::Vector2d& end,
                          const Eigen::Vector2d& outward,
                          const Eigen::Vector2d& right_to_bright,
                          float min_gradient,
                          std::vector<GradientPeak>* samples) {
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
  const int count = std::clamp(static_cast<int>(length) + 1, 2, kMaxFitSamples);
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
  for (const GradientPeak& sample : fitted.samples) {
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

std::optional<FittedSegment> FitChainPiece(const EdgeChain& chain,
                                           int begin,
                                           int end,
                                           double min_length_px) {
  const Eigen::Vector2d first = chain.points[begin].cast<double>();
  const Eigen::Vector2d last = chain.points[end - 1].cast<double>();
  const double length = (last - first).norm();
  if (length < min_length_px) {
    return std::nullopt;
  }
  const int n = end - begin;
  const int skip = n >= kRoundedFrom ? kRoundedPoints : n > 8 ? 1 : 0;
  FittedSegment fitted;
  fitted.samples.reserve(n - 2 * skip);
  int votes[5] = {0, 0, 0, 0, 0};
  for (int i = begin; i < end; ++i) {
    ++votes[chain.channels[i]];
  }
  const int channel = static_cast<int>(std::max_element(votes, votes + 5) - votes);
  const Eigen::Vector2d direction = (last - first) / length;
  const Eigen::Vector2f right(static_cast<float>(-direction.y()),
                              static_cast<float>(direction.x()));
  float slope = 0.0f, polarity = 0.0f;
  for (int i = begin + skip; i < end - skip; ++i) {
    const float across = right.dot(chain.gradients[i]);
    slope += std::abs(across);
    polarity += chain.channels[i] == channel ? across : 0.0f;
    fitted.samples.push_back({chain.points[i], 1.0f});
  }
  slope /= static_cast<float>(fitted.samples.size());
  // Not the chord's middle: a chain that runs into another ends on it, off its own line.
  Eigen::Vector2d middle = Eigen::Vector2d::Zero();
  for (const GradientPeak& sample : fitted.samples) {
    middle += sample.point.cast<double>() / static_cast<double>(fitted.samples.size());
  }
  const RobustLine line = FitRobustLine(fitted.samples, middle, direction, kChainRounds);
  if (line.inlier_share < kMinInlierShare || std::abs(line.direction.dot(direction)) < 0.97) {
    return std::nullopt;
  }
  if (length < kSurelyEdgePx &&
      (line.rms_px > kMaxShortRms * length / kSurelyEdgePx || slope * length < kMinShortStrength)) {
    return std::nullopt;
  }
  Segment& segment = fitted.segment;
  segment.start = line.point + line.direction * line.direction.dot(first - line.point);
  segment.end = line.point + line.direction * line.direction.dot(last - line.point);
  if (polarity < 0.0f) {
    std::swap(segment.start, segment.end);
  }
  segment.contrast = kStepPerSlope * slope;
  segment.rms_px = line.rms_px;
  segment.channel = channel;
  SetDeviations(fitted.samples.size(), &segment);
  return fitted;
}

Segment FitLineToSamples(const std::vector<GradientPeak>& samples,
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
  SetDeviations(samples.size(), &segment);
  return segment;
}

}  // namespace horopter
