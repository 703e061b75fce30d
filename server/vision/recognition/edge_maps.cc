#include "server/vision/recognition/edge_maps.h"

#include <algorithm>
#include <cmath>
#include <cstddef>

namespace horopter {
namespace {

constexpr float kPi = 3.14159265358979f;
// An edge point counts in every bin whose centre is within this of its direction.
constexpr float kBinReach = 0.40f;  // 23 degrees
// Direction of a chain point: from this many points before to as many after.
constexpr int kTangentReach = 3;

float ModPi(float a) {
  a = std::fmod(a, kPi);
  return a < 0 ? a + kPi : a;
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

// Nearest-point propagation over the 8 neighbours, two passes (Danielsson); exact up to a fraction
// of a pixel.
class NearestMap {
 public:
  NearestMap(const EdgeMaps& maps, std::int32_t* nearest) : maps_(maps), nearest_(nearest) {}

  float SquaredDistance(int x, int y, std::int32_t index) const {
    if (index < 0) return 1e30f;
    const float dx = maps_.points[index].point.x() * maps_.scale_f - x;
    const float dy = maps_.points[index].point.y() * maps_.scale_f - y;
    return dx * dx + dy * dy;
  }

  void Propagate() {
    for (int y = 0; y < maps_.height; ++y) {
      for (int x = 0; x < maps_.width; ++x) {
        Take(x, y, -1, 0);
        Take(x, y, 0, -1);
        Take(x, y, -1, -1);
        Take(x, y, 1, -1);
      }
      for (int x = maps_.width - 1; x >= 0; --x) Take(x, y, 1, 0);
    }
    for (int y = maps_.height - 1; y >= 0; --y) {
      for (int x = maps_.width - 1; x >= 0; --x) {
        Take(x, y, 1, 0);
        Take(x, y, 0, 1);
        Take(x, y, 1, 1);
        Take(x, y, -1, 1);
      }
      for (int x = 0; x < maps_.width; ++x) Take(x, y, -1, 0);
    }
  }

 private:
  void Take(int x, int y, int dx, int dy) {
    const int nx = x + dx, ny = y + dy;
    if (nx < 0 || ny < 0 || nx >= maps_.width || ny >= maps_.height) return;
    const std::int32_t other = nearest_[maps_.Cell(nx, ny)];
    std::int32_t& mine = nearest_[maps_.Cell(x, y)];
    if (other < 0 || other == mine) return;
    if (SquaredDistance(x, y, other) < SquaredDistance(x, y, mine)) mine = other;
  }

  const EdgeMaps& maps_;
  std::int32_t* nearest_;
};

}  // namespace

EdgeMaps BuildEdgeMaps(const ImageFeatures& features) {
  EdgeMaps maps;
  maps.working_from_image = features.width > EdgeMaps::kWorkingWidth
                                ? static_cast<double>(EdgeMaps::kWorkingWidth) / features.width
                                : 1.0;
  maps.scale_f = static_cast<float>(maps.working_from_image);
  maps.width = std::max(1, static_cast<int>(std::lround(features.width * maps.working_from_image)));
  maps.height =
      std::max(1, static_cast<int>(std::lround(features.height * maps.working_from_image)));
  AddSegments(features, &maps.points);
  AddChains(features, &maps.points);

  const std::size_t cells = static_cast<std::size_t>(maps.width) * maps.height;
  maps.half_scale_f = 0.5f * maps.scale_f;
  maps.half_width = (maps.width + 1) / 2;
  maps.half_height = (maps.height + 1) / 2;
  const std::size_t half_cells = static_cast<std::size_t>(maps.half_width) * maps.half_height;
  maps.distance.assign(half_cells * kOrientationBins, 255);
  std::vector<float> distance(cells);
  maps.nearest.assign(cells * kOrientationBins, -1);
  for (int bin = 0; bin < kOrientationBins; ++bin) {
    std::int32_t* nearest = maps.nearest.data() + cells * bin;
    NearestMap map(maps, nearest);
    const float center = bin * kPi / kOrientationBins;
    for (std::size_t i = 0; i < maps.points.size(); ++i) {
      const float off = std::abs(std::remainder(maps.points[i].direction - center, kPi));
      if (off > kBinReach) continue;
      const int x = static_cast<int>(std::lround(maps.points[i].point.x() * maps.scale_f));
      const int y = static_cast<int>(std::lround(maps.points[i].point.y() * maps.scale_f));
      if (x < 0 || y < 0 || x >= maps.width || y >= maps.height) continue;
      std::int32_t& cell = nearest[maps.Cell(x, y)];
      if (map.SquaredDistance(x, y, static_cast<std::int32_t>(i)) <
          map.SquaredDistance(x, y, cell)) {
        cell = static_cast<std::int32_t>(i);
      }
    }
    map.Propagate();
    for (int y = 0; y < maps.height; ++y) {
      for (int x = 0; x < maps.width; ++x) {
        const std::size_t cell = maps.Cell(x, y);
        const float d = std::sqrt(map.SquaredDistance(x, y, nearest[cell]));
        if (d >= EdgeMaps::kMaxDistance) nearest[cell] = -1;
        distance[cell] = std::min(d, EdgeMaps::kMaxDistance);
      }
    }
    for (int y = 0; y < maps.half_height; ++y) {
      const int y0 = 2 * y, y1 = std::min(2 * y + 1, maps.height - 1);
      for (int x = 0; x < maps.half_width; ++x) {
        const int x0 = 2 * x, x1 = std::min(2 * x + 1, maps.width - 1);
        const float mean = 0.25f * (distance[maps.Cell(x0, y0)] + distance[maps.Cell(x1, y0)] +
                                    distance[maps.Cell(x0, y1)] + distance[maps.Cell(x1, y1)]);
        maps.distance[half_cells * bin + static_cast<std::size_t>(y) * maps.half_width + x] =
            static_cast<std::uint8_t>(mean * EdgeMaps::kDistanceScale);
      }
    }
  }
  return maps;
}

}  // namespace horopter
