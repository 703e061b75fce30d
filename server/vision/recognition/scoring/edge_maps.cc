#include "server/vision/recognition/scoring/edge_maps.h"

#include <algorithm>
#include <cmath>
#include <cstddef>

#include "server/base/constants.h"
#include "server/base/parallel_for.h"

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

// Nearest-point propagation over the 8 neighbours, two passes (Danielsson); exact up to a fraction
// of a pixel. Keeps every cell's squared distance, so that a neighbour's point costs one distance;
// cells beyond kMaxDistance stay empty.
class NearestMap {
 public:
  NearestMap(const EdgeMaps& maps,
             const std::vector<Eigen::Vector2f>& points,
             std::int32_t* nearest,
             std::vector<float>* squared)
      : maps_(maps), points_(points.data()), nearest_(nearest), squared_(squared->data()) {
    std::fill(squared->begin(), squared->end(), kFar);
  }

  void Offer(std::int32_t index, int x, int y) {
    Cell cell = Load(maps_.Cell(x, y));
    Take(index, x, y, &cell);
    Store(cell);
  }

  void Propagate() {
    const int width = maps_.width, height = maps_.height;
    for (int y = 0; y < height; ++y) {
      Sweep<1>(y, y == 0 ? 0 : -width);
      SweepBack<-1>(y);
    }
    for (int y = height - 1; y >= 0; --y) {
      Sweep<-1>(y, y + 1 == height ? 0 : width);
      SweepBack<1>(y);
    }
  }

 private:
  // Squared working px.
  static constexpr float kFar = EdgeMaps::kMaxDistance * EdgeMaps::kMaxDistance;

  struct Cell {
    std::size_t at;
    std::int32_t nearest;
    float squared;
    bool changed;
  };
  Cell Load(std::size_t at) const { return {at, nearest_[at], squared_[at], false}; }
  void Store(const Cell& cell) {
    if (!cell.changed) return;
    nearest_[cell.at] = cell.nearest;
    squared_[cell.at] = cell.squared;
  }
  void Take(std::int32_t other, int x, int y, Cell* cell) const {
    if (other < 0 || other == cell->nearest) return;
    const float dx = points_[other].x() - static_cast<float>(x);
    const float dy = points_[other].y() - static_cast<float>(y);
    const float squared = dx * dx + dy * dy;
    if (squared >= cell->squared) return;
    *cell = {cell->at, other, squared, true};
  }

  // A row in direction kStep, from the cell before and from the row at `other_row` (0: none).
  template <int kStep>
  void Sweep(int y, std::ptrdiff_t other_row) {
    const int width = maps_.width;
    std::int32_t before = -1;
    for (int x = kStep > 0 ? 0 : width - 1; x >= 0 && x < width; x += kStep) {
      Cell cell = Load(maps_.Cell(x, y));
      Take(before, x, y, &cell);
      if (other_row != 0) {
        const std::int32_t* other = nearest_ + cell.at + other_row;
        const int back = x - kStep, ahead = x + kStep;
        Take(other[0], x, y, &cell);
        if (back >= 0 && back < width) Take(other[-kStep], x, y, &cell);
        if (ahead >= 0 && ahead < width) Take(other[kStep], x, y, &cell);
      }
      Store(cell);
      before = cell.nearest;
    }
  }

  template <int kStep>
  void SweepBack(int y) {
    const int width = maps_.width;
    std::int32_t before = -1;
    for (int x = kStep > 0 ? 0 : width - 1; x >= 0 && x < width; x += kStep) {
      Cell cell = Load(maps_.Cell(x, y));
      Take(before, x, y, &cell);
      Store(cell);
      before = cell.nearest;
    }
  }

  const EdgeMaps& maps_;
  const Eigen::Vector2f* points_;  // working pixels
  std::int32_t* nearest_;
  float* squared_;
};

// Fills both maps of one bin. points: maps->points in working pixels.
void FillBin(const std::vector<Eigen::Vector2f>& points, int bin, EdgeMaps* maps) {
  const std::size_t cells = static_cast<std::size_t>(maps->width) * maps->height;
  std::int32_t* nearest = maps->nearest.data() + cells * bin;
  std::vector<float> distance(cells);
  NearestMap map(*maps, points, nearest, &distance);
  const float center = bin * kPiF / kOrientationBins;
  for (std::size_t i = 0; i < points.size(); ++i) {
    // Both lie in [0, pi): no remainder is needed.
    float off = std::abs(maps->points[i].direction - center);
    off = std::min(off, kPiF - off);
    if (off > kBinReach) continue;
    const int x = static_cast<int>(std::lround(points[i].x()));
    const int y = static_cast<int>(std::lround(points[i].y()));
    if (x < 0 || y < 0 || x >= maps->width || y >= maps->height) continue;
    map.Offer(static_cast<std::int32_t>(i), x, y);
  }
  map.Propagate();
  for (std::size_t cell = 0; cell < cells; ++cell) {
    distance[cell] = std::sqrt(distance[cell]);
  }
  std::uint8_t* half =
      maps->distance.data() + static_cast<std::size_t>(maps->half_width) * maps->half_height * bin;
  for (int y = 0; y < maps->half_height; ++y) {
    const int y0 = 2 * y, y1 = std::min(2 * y + 1, maps->height - 1);
    for (int x = 0; x < maps->half_width; ++x) {
      const int x0 = 2 * x, x1 = std::min(2 * x + 1, maps->width - 1);
      const float mean = 0.25f * (distance[maps->Cell(x0, y0)] + distance[maps->Cell(x1, y0)] +
                                  distance[maps->Cell(x0, y1)] + distance[maps->Cell(x1, y1)]);
      half[static_cast<std::size_t>(y) * maps->half_width + x] =
          static_cast<std::uint8_t>(mean * EdgeMaps::kDistanceScale);
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

EdgeMaps BuildEdgeMaps(const ImageFeatures& features, int threads) {
  return BuildEdgeMaps(CollectEdgePoints(features), features.width, features.height, threads);
}

EdgeMaps BuildEdgeMaps(std::vector<EdgePoint> points, int width, int height, int threads) {
  EdgeMaps maps;
  maps.working_from_image =
      width > EdgeMaps::kWorkingWidth ? static_cast<double>(EdgeMaps::kWorkingWidth) / width : 1.0;
  maps.scale_f = static_cast<float>(maps.working_from_image);
  maps.width = std::max(1, static_cast<int>(std::lround(width * maps.working_from_image)));
  maps.height = std::max(1, static_cast<int>(std::lround(height * maps.working_from_image)));
  maps.points = std::move(points);
  std::vector<Eigen::Vector2f> working;
  working.reserve(maps.points.size());
  for (const EdgePoint& p : maps.points) working.push_back(p.point * maps.scale_f);

  const std::size_t cells = static_cast<std::size_t>(maps.width) * maps.height;
  maps.half_scale_f = 0.5f * maps.scale_f;
  maps.half_width = (maps.width + 1) / 2;
  maps.half_height = (maps.height + 1) / 2;
  const std::size_t half_cells = static_cast<std::size_t>(maps.half_width) * maps.half_height;
  maps.distance.assign(half_cells * kOrientationBins, 255);
  maps.nearest.assign(cells * kOrientationBins, -1);
  ParallelFor(kOrientationBins, threads, [&](int bin) { FillBin(working, bin, &maps); });
  return maps;
}

}  // namespace horopter
