// Votes of edges for the poses of one standing part: a part that is there is suggested by several
// of its edges in several views, a chance agreement by one.
#pragma once

#include <Eigen/Core>
#include <cstdint>
#include <vector>

#include "absl/container/flat_hash_map.h"
#include "server/vision/recognition/search_options.h"

namespace horopter {

// Yaw and position of a standing part, and the plane units that one metre has.
struct PlaneYaw {
  double cos_yaw = 1.0;
  double sin_yaw = 0.0;
  Eigen::Vector2d position = Eigen::Vector2d::Zero();  // plane units
  double units_per_metre = 1.0;
};

// An accumulator over position, yaw and scale whose cells know the mean of their votes.
class PoseVotes {
 public:
  explicit PoseVotes(const PoseVoteOptions& options = {}) : options_(options) {}

  void Add(const PlaneYaw& pose, double weight);

  struct Peak {
    PlaneYaw pose;        // weighted mean of the cell
    double weight = 0.0;  // of the cell and its neighbours
  };
  // Cells whose neighbourhood holds at least min_weight and that are the heaviest of it (and hold
  // 0.3 of min_weight themselves), at most `most`; heaviest first.
  std::vector<Peak> Peaks(double min_weight, int most) const;

 private:
  struct Key {
    std::int32_t x, y, yaw, scale;
    bool operator==(const Key&) const = default;
    template <typename H>
    friend H AbslHashValue(H h, const Key& k) {
      return H::combine(std::move(h), k.x, k.y, k.yaw, k.scale);
    }
  };
  struct Cell {
    double weight = 0.0;
    double x = 0.0, y = 0.0, c = 0.0, s = 0.0, log_units = 0.0;  // weighted sums
  };
  Key KeyOf(const PlaneYaw& pose, int scale) const;
  int ScaleBin(double units_per_metre) const;
  int YawBins() const;
  PlaneYaw MeanOf(const Cell& cell) const;

  PoseVoteOptions options_;
  absl::flat_hash_map<Key, Cell> cells_;
};

}  // namespace horopter
