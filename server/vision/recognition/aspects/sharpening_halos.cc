#include "server/vision/recognition/aspects/sharpening_halos.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdint>
#include <opencv2/imgproc.hpp>
#include <optional>

#include "server/vision/recognition/aspects/quantile.h"

namespace horopter {
namespace {

constexpr int kProfileReach = 8;  // working px to either side of an edge that are looked at
constexpr float kStrong = 12.0f;  // grey levels per px
constexpr std::size_t kLeastStrong = 50, kMostStrong = 4000;  // edges; the latter for time
constexpr int kEven = 3;  // working px at either end of a profile that must be even:
constexpr double kEvenShare = 0.06, kEvenLevels = 1.5;  // of the step; and grey levels of noise
constexpr double kLeastProfileStep = 25.0;              // grey levels
// Median overshoot. Images of cad-dev, real-dev and small-dev have -.03 - .01, and .04 - .18
// sharpened by an unsharp mask of 1.5 working px and 1.5 times the difference.
constexpr double kSharpened = 0.035;
constexpr double kWeaker = 0.4;  // of the strong edge's strength, at most; chosen
constexpr double kLike = 0.9;    // cosine between the two directions

// Brightness along an edge's normal, [kProfileReach] on it. Nothing at the image's border.
using Profile = std::array<double, 2 * kProfileReach + 1>;
std::optional<Profile> ProfileAt(const cv::Mat& grey, const ImageEdgePoint& e) {
  const Eigen::Vector2f ends[] = {e.point - kProfileReach * e.normal,
                                  e.point + kProfileReach * e.normal};
  for (const Eigen::Vector2f& p : ends) {
    if (!(p.x() >= 1 && p.y() >= 1 && p.x() < grey.cols - 2 && p.y() < grey.rows - 2))
      return std::nullopt;
  }
  Profile out;
  for (int t = -kProfileReach; t <= kProfileReach; ++t) {
    const Eigen::Vector2f p = e.point + static_cast<float>(t) * e.normal;
    const int x = static_cast<int>(p.x()), y = static_cast<int>(p.y());
    const double fx = p.x() - x, fy = p.y() - y;
    const std::uint8_t *above = grey.ptr(y) + x, *below = grey.ptr(y + 1) + x;
    out[t + kProfileReach] = (1 - fy) * ((1 - fx) * above[0] + fx * above[1]) +
                             fy * ((1 - fx) * below[0] + fx * below[1]);
  }
  return out;
}

// What an edge's profile has on its two sides: where it turns back (px from the edge, 0: nowhere),
// and by what share of the step. Nothing where the image is not even farther off: what lies there
// is no halo.
struct Sides {
  std::array<int, 2> turn{};
  std::array<double, 2> overshoot{};
};
std::optional<Sides> SidesOf(const Profile& profile) {
  std::array<double, 2> far_off{};
  for (int i = 0; i < kEven; ++i) {
    far_off[0] += profile[i] / kEven;
    far_off[1] += profile[profile.size() - 1 - i] / kEven;
  }
  const double far_step = std::abs(far_off[1] - far_off[0]);
  const double even = kEvenShare * far_step + kEvenLevels;
  const auto spread = [](auto from) {
    const auto [low, high] = std::minmax_element(from, from + kEven);
    return *high - *low;
  };
  if (far_step < kLeastProfileStep || spread(profile.begin()) > even ||
      spread(profile.end() - kEven) > even)
    return std::nullopt;
  Sides out;
  const double up = far_off[1] > far_off[0] ? 1.0 : -1.0;
  for (int side = 0; side < 2; ++side) {
    const int s = side == 0 ? -1 : 1;
    double most = -1e9;
    for (int t = 1; t <= kProfileReach / 2; ++t) {
      const double outward = up * s * profile[kProfileReach + s * t];
      if (outward <= most) continue;
      most = outward;
      out.turn[side] = t;
    }
    out.overshoot[side] = (most - up * s * far_off[side]) / far_step;
  }
  return out;
}

cv::Mat GreyOf(const cv::Mat& bgr) {
  cv::Mat grey;
  cv::cvtColor(bgr, grey, cv::COLOR_BGR2GRAY);
  return grey;
}

double OvershootOf(const cv::Mat& grey, const std::vector<ImageEdgePoint>& edges) {
  std::vector<double> lesser;
  const std::size_t step = edges.size() / kMostStrong + 1;
  for (std::size_t i = 0; i < edges.size(); i += step) {
    if (edges[i].strength < kStrong) continue;
    const std::optional<Profile> profile = ProfileAt(grey, edges[i]);
    if (!profile) continue;
    const std::optional<Sides> sides = SidesOf(*profile);
    if (sides) lesser.push_back(std::min(sides->overshoot[0], sides->overshoot[1]));
  }
  return lesser.size() < kLeastStrong ? 0.0 : Median(&lesser);
}

}  // namespace

double Overshoot(const cv::Mat& bgr, const std::vector<ImageEdgePoint>& edges) {
  return OvershootOf(GreyOf(bgr), edges);
}

void DropHalos(const cv::Mat& bgr, std::vector<ImageEdgePoint>* edges) {
  const cv::Mat grey = GreyOf(bgr);
  if (OvershootOf(grey, *edges) < kSharpened) return;
  cv::Mat at(grey.size(), CV_32S, cv::Scalar(-1));
  for (std::size_t i = 0; i < edges->size(); ++i) {
    const Eigen::Vector2f& p = (*edges)[i].point;
    at.at<int>(static_cast<int>(p.y() + 0.5f), static_cast<int>(p.x() + 0.5f)) =
        static_cast<int>(i);
  }
  std::vector<std::uint8_t> halo(edges->size(), 0);
  for (const ImageEdgePoint& e : *edges) {
    if (e.strength < kStrong) continue;
    const std::optional<Profile> profile = ProfileAt(grey, e);
    if (!profile) continue;
    const std::optional<Sides> sides = SidesOf(*profile);
    for (int side = 0; sides && side < 2; ++side) {
      if (sides->overshoot[side] < kSharpened) continue;
      for (int t = sides->turn[side] + 1; t <= kProfileReach; ++t) {
        const Eigen::Vector2f p = e.point + static_cast<float>(side == 0 ? -t : t) * e.normal;
        const int k = at.at<int>(static_cast<int>(p.y() + 0.5f), static_cast<int>(p.x() + 0.5f));
        if (k < 0 || (*edges)[k].strength > kWeaker * e.strength) continue;
        halo[k] |= std::abs((*edges)[k].normal.dot(e.normal)) > kLike;
      }
    }
  }
  std::size_t kept = 0;
  for (std::size_t i = 0; i < halo.size(); ++i) {
    if (!halo[i]) (*edges)[kept++] = (*edges)[i];
  }
  edges->resize(kept);
}

}  // namespace horopter
