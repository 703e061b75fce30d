#include "server/vision/features/edge_chains.h"

#include <algorithm>
#include <cmath>
#include <opencv2/core.hpp>

#include "server/vision/features/edge_cover.h"

namespace horopter {
namespace {

constexpr int kTangentReach = 3;  // points on each side
constexpr int kDirections = 180;  // of the occupancy map, over half a turn

struct ChainRef {
  int channel = 0;
  int index = 0;
  size_t size = 0;
};

// Undirected tangent in [0, 180).
uint8_t TangentDegrees(const std::vector<cv::Point>& chain, int i) {
  const int n = static_cast<int>(chain.size());
  const cv::Point d =
      chain[std::min(i + kTangentReach, n - 1)] - chain[std::max(i - kTangentReach, 0)];
  double degrees = std::atan2(d.y, d.x) * 180.0 / CV_PI;
  if (degrees < 0.0) {
    degrees += 180.0;
  }
  return static_cast<uint8_t>(std::min(static_cast<int>(degrees), kDirections - 1));
}

bool Covered(const cv::Mat& occupied, const cv::Point& p, uint8_t degrees) {
  for (int y = std::max(p.y - 1, 0); y <= std::min(p.y + 1, occupied.rows - 1); ++y) {
    for (int x = std::max(p.x - 1, 0); x <= std::min(p.x + 1, occupied.cols - 1); ++x) {
      const uint8_t there = occupied.at<uint8_t>(y, x);
      if (there == kFree) {
        continue;
      }
      const int difference = std::abs(there - degrees);
      if (std::min(difference, kDirections - difference) <= kSameDirection) {
        return true;
      }
    }
  }
  return false;
}

Eigen::Vector2f SubPixel(const cv::Mat& smooth, const cv::Point& p) {
  if (p.x < 2 || p.y < 2 || p.x > smooth.cols - 3 || p.y > smooth.rows - 3) {
    return {static_cast<float>(p.x), static_cast<float>(p.y)};
  }
  const float* row = smooth.ptr<float>(p.y) + p.x;
  const auto stride = static_cast<ptrdiff_t>(smooth.step1());
  Eigen::Vector2f gradient(row[1] - row[-1], row[stride] - row[-stride]);
  const float norm = gradient.norm();
  if (norm < 1e-3f) {
    return {static_cast<float>(p.x), static_cast<float>(p.y)};
  }
  gradient /= norm;
  float value[5];
  for (int t = -2; t <= 2; ++t) {
    value[t + 2] = SampleBilinear(smooth, p.x + t * gradient.x(), p.y + t * gradient.y());
  }
  const float before = value[2] - value[0];
  const float peak = value[3] - value[1];
  const float after = value[4] - value[2];
  const float curvature = before - 2.0f * peak + after;
  const float shift =
      curvature < -1e-4f ? std::clamp(0.5f * (before - after) / curvature, -1.0f, 1.0f) : 0.0f;
  return Eigen::Vector2f(static_cast<float>(p.x), static_cast<float>(p.y)) + shift * gradient;
}

Eigen::Vector2f GradientAt(const cv::Mat& smooth, const cv::Point& p) {
  const int x = std::clamp(p.x, 1, smooth.cols - 2), y = std::clamp(p.y, 1, smooth.rows - 2);
  const float* row = smooth.ptr<float>(y) + x;
  const auto stride = static_cast<ptrdiff_t>(smooth.step1());
  return {0.5f * (row[1] - row[-1]), 0.5f * (row[stride] - row[-stride])};
}

bool IsClosed(const std::vector<cv::Point>& chain) {
  const cv::Point d = chain.front() - chain.back();
  return chain.size() > 12 && std::max(std::abs(d.x), std::abs(d.y)) <= 2;
}

}  // namespace

std::vector<EdgeChain> JoinChains(const std::vector<DrawnEdges>& edges,
                                  const std::vector<DetectionChannel>& channels) {
  std::vector<ChainRef> order;
  for (size_t c = 0; c < edges.size(); ++c) {
    for (size_t i = 0; i < edges[c].chains.size(); ++i) {
      order.push_back({static_cast<int>(c), static_cast<int>(i), edges[c].chains[i].size()});
    }
  }
  std::stable_sort(order.begin(), order.end(), [](const ChainRef& a, const ChainRef& b) {
    return a.size > b.size;
  });
  std::vector<EdgeChain> joined;
  if (channels.empty()) {
    return joined;
  }
  cv::Mat occupied(channels[0].smooth.size(), CV_8UC1, cv::Scalar(kFree));
  std::vector<uint8_t> tangent;
  for (const ChainRef& ref : order) {
    const std::vector<cv::Point>& chain = edges[ref.channel].chains[ref.index];
    const int n = static_cast<int>(chain.size());
    tangent.resize(chain.size());
    for (int i = 0; i < n; ++i) {
      tangent[i] = TangentDegrees(chain, i);
    }
    int begin = 0;
    for (int i = 0; i <= n; ++i) {
      if (i < n && !Covered(occupied, chain[i], tangent[i])) {
        continue;
      }
      if (i - begin >= kMinRun) {
        EdgeChain run;
        run.channel = ref.channel;
        run.closed = begin == 0 && i == n && IsClosed(chain);
        run.points.reserve(i - begin);
        for (int k = begin; k < i; ++k) {
          run.points.push_back(SubPixel(channels[ref.channel].smooth, chain[k]));
          run.gradients.push_back(GradientAt(channels[ref.channel].smooth, chain[k]));
          run.channels.push_back(static_cast<uint8_t>(ref.channel));
        }
        joined.push_back(std::move(run));
      }
      begin = i + 1;
    }
    for (int i = 0; i < n; ++i) {
      occupied.at<uint8_t>(chain[i]) = tangent[i];
    }
  }
  return joined;
}

}  // namespace horopter
