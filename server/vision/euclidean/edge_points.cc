#include "server/vision/euclidean/edge_points.h"

#include <algorithm>
#include <cmath>

#include "server/base/constants.h"

namespace horopter {
namespace {

// An edge point counts in every bin whose centre is within this of its direction.
constexpr float kBinReach = 0.40f;  // 23 degrees
// Direction of a chain point: from this many points before to as many after.
constexpr int kTangentReach = 3;

float ModPi(float a) {
  a = std::fmod(a, kPiF);
  return a < 0 ? a + kPiF : a;
}

void AddChains(const ImageFeatures& features, std::vector<EdgePoint>* out) {
  for (const EdgeChain& chain : features.chains) {
    const int n = static_cast<int>(chain.points.size());
    if (n < 4) continue;
    for (int i = 0; i < n; ++i) {
      const int from = std::max(0, i - kTangentReach);
      const int to = std::min(n - 1, i + kTangentReach);
      const Eigen::Vector2f d = chain.points[to] - chain.points[from];
      if (d.squaredNorm() < 1e-6f) continue;
      out->push_back({chain.points[i], ModPi(std::atan2(d.y(), d.x()))});
    }
  }
}

void AddSegments(const ImageFeatures& features, std::vector<EdgePoint>* out) {
  for (const Segment& s : features.segments) {
    const Eigen::Vector2d d = s.end - s.start;
    const int n = std::max(1, static_cast<int>(std::ceil(d.norm())));
    const float direction = ModPi(static_cast<float>(std::atan2(d.y(), d.x())));
    for (int i = 0; i <= n; ++i) {
      out->push_back({(s.start + d * (static_cast<double>(i) / n)).cast<float>(), direction});
    }
  }
}

}  // namespace

std::vector<EdgePoint> CollectEdgePoints(const ImageFeatures& features) {
  std::vector<EdgePoint> points;
  AddSegments(features, &points);
  AddChains(features, &points);
  return points;
}

}  // namespace horopter
