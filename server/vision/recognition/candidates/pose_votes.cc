#include "server/vision/recognition/candidates/pose_votes.h"

#include <algorithm>
#include <cmath>
#include <limits>

namespace horopter {
namespace {

constexpr double kTwoPi = 6.283185307179586;
// A peak's own cell holds at least this share of what its neighbourhood must.
constexpr double kPeakShare = 0.3;

// Weights in blocks of 2 x 2 positions and kYaws yaws, hashed into few slots: what it says of a
// neighbourhood is never too little.
class CoarseSums {
 public:
  explicit CoarseSums(int yaw_bins) : yaw_bins_(yaw_bins) {}
  void Add(int x, int y, int yaw, int scale, double weight) {
    slots_[Slot(x >> 1, y >> 1, yaw / kYaws, scale)] += static_cast<float>(weight);
  }
  // Of the cells within one of (x, y, yaw) and `reach` of the scale.
  float Around(int x, int y, int yaw, int scale, int reach) const {
    const int low = (yaw + yaw_bins_ - 1) % yaw_bins_ / kYaws, own = yaw / kYaws,
              high = (yaw + 1) % yaw_bins_ / kYaws;
    float sum = 0.0f;
    for (int s = scale - reach; s <= scale + reach; ++s) {
      for (int j = (y - 1) >> 1; j <= (y + 1) >> 1; ++j) {
        for (int i = (x - 1) >> 1; i <= (x + 1) >> 1; ++i) {
          sum += slots_[Slot(i, j, own, s)];
          if (low != own) sum += slots_[Slot(i, j, low, s)];
          if (high != own) sum += slots_[Slot(i, j, high, s)];
        }
      }
    }
    return kRounding * sum;
  }

 private:
  static constexpr int kYaws = 4;                 // cells that share a block
  static constexpr std::size_t kSlots = 1 << 15;  // of the sketch, 128 kB
  static constexpr float kRounding = 1.001f;      // sums in single precision stay bounds
  static std::size_t Slot(int x, int y, int yaw, int scale) {
    const auto u = [](int i) { return static_cast<std::uint32_t>(i); };
    const std::uint32_t h =
        u(x) * 0x9e3779b1u ^ u(y) * 0x85ebca77u ^ u(scale) * 0xc2b2ae3du ^ u(yaw) * 0x27d4eb2fu;
    return (h ^ h >> 15) % kSlots;
  }
  int yaw_bins_;
  std::vector<float> slots_ = std::vector<float>(kSlots, 0.0f);
};

}  // namespace

int PoseVotes::YawBins() const {
  return std::max(3, static_cast<int>(std::lround(kTwoPi / options_.cell_rad)));
}

int PoseVotes::ScaleBin(double units_per_metre) const {
  return static_cast<int>(std::floor(std::log(units_per_metre) / options_.cell_log));
}

// Positions are voted for in units: they hardly depend on the scale. The cells' size does, so that
// every scale bin has a grid of its own.
PoseVotes::Key PoseVotes::KeyOf(const PlaneYaw& pose, int scale) const {
  const double cell = options_.cell_m * std::exp((scale + 0.5) * options_.cell_log);
  const double yaw = std::atan2(pose.sin_yaw, pose.cos_yaw) / kTwoPi + 0.5;
  const int bins = YawBins();
  return {static_cast<std::int32_t>(std::floor(pose.position.x() / cell)),
          static_cast<std::int32_t>(std::floor(pose.position.y() / cell)),
          std::clamp(static_cast<int>(yaw * bins), 0, bins - 1),
          scale};
}

void PoseVotes::Add(const PlaneYaw& pose, double weight) {
  Cell& cell = cells_[KeyOf(pose, ScaleBin(pose.units_per_metre))];
  cell.weight += weight;
  cell.x += weight * pose.position.x();
  cell.y += weight * pose.position.y();
  cell.c += weight * pose.cos_yaw;
  cell.s += weight * pose.sin_yaw;
  cell.log_units += weight * std::log(pose.units_per_metre);
}

PlaneYaw PoseVotes::MeanOf(const Cell& cell) const {
  PlaneYaw mean;
  mean.position = Eigen::Vector2d(cell.x, cell.y) / cell.weight;
  const double norm = std::hypot(cell.c, cell.s);
  mean.cos_yaw = cell.c / norm;
  mean.sin_yaw = cell.s / norm;
  mean.units_per_metre = std::exp(cell.log_units / cell.weight);
  return mean;
}

std::vector<PoseVotes::Peak> PoseVotes::Peaks(double min_weight, int most) const {
  std::vector<Peak> peaks;
  const int bins = YawBins();
  int lowest = std::numeric_limits<int>::max(), highest = std::numeric_limits<int>::min();
  for (const auto& [key, cell] : cells_) {
    lowest = std::min(lowest, key.scale);
    highest = std::max(highest, key.scale);
  }
  const int reach = lowest < highest ? 1 : 0;
  // Most cells are lonely: a bound from coarse sums spares them the look at their neighbours.
  CoarseSums coarse(bins);
  for (const auto& [key, cell] : cells_) coarse.Add(key.x, key.y, key.yaw, key.scale, cell.weight);
  for (const auto& [key, cell] : cells_) {
    if (cell.weight < kPeakShare * min_weight) continue;
    if (coarse.Around(key.x, key.y, key.yaw, key.scale, reach) < min_weight) continue;
    const PlaneYaw mean = MeanOf(cell);
    double weight = 0.0;
    bool heaviest = true;
    for (int ds = -reach; ds <= reach && heaviest; ++ds) {
      const Key middle = KeyOf(mean, key.scale + ds);
      for (int dyaw = -1; dyaw <= 1 && heaviest; ++dyaw) {
        for (int dy = -1; dy <= 1 && heaviest; ++dy) {
          for (int dx = -1; dx <= 1; ++dx) {
            const Key near{
                middle.x + dx, middle.y + dy, (key.yaw + dyaw + bins) % bins, key.scale + ds};
            const auto it = cells_.find(near);
            if (it == cells_.end()) continue;
            weight += it->second.weight;
            if (it->second.weight > cell.weight) {
              heaviest = false;
              break;
            }
          }
        }
      }
    }
    if (heaviest && weight >= min_weight) peaks.push_back({mean, weight});
  }
  std::sort(peaks.begin(), peaks.end(), [](const Peak& a, const Peak& b) {
    if (a.weight != b.weight) return a.weight > b.weight;
    if (a.pose.position.x() != b.pose.position.x())
      return a.pose.position.x() < b.pose.position.x();
    return a.pose.position.y() < b.pose.position.y();
  });
  if (static_cast<int>(peaks.size()) > most) peaks.resize(most);
  return peaks;
}

}  // namespace horopter
