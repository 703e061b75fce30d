// The features of a part that others of its kind may lack, or have elsewhere: holes, pockets and
// bosses.
#pragma once

#include <Eigen/Core>
#include <cstdint>
#include <vector>

#include "server/vision/geometry/object_model.h"

namespace horopter {

// Sharp edges that hang together and not with the rest: the rim of a hole, of a pocket, the outline
// of a boss. The rims of a hole that goes through are one.
struct ModelFeature {
  Eigen::Vector3d place = Eigen::Vector3d::Zero();  // middle of the bounding box, object frame, m
  double size_m = 0.0;                              // its longest side
  std::vector<Eigen::Vector3d> points;              // along the edges, kFeatureSpacing apart
};

inline constexpr double kFeatureSpacing = 0.01;  // diameters

struct ModelFeatureOptions {
  // Shares of the diameter: smaller ones are not seen, larger ones are the part itself.
  double min_size = 0.02, max_size = 0.5;
  double beside = 0.03;  // diameters: edges nearer to a larger feature's belong to it
  int most = 64;         // largest first
};

// Largest first. None of a model without sharp edges.
std::vector<ModelFeature> FindModelFeatures(const ObjectModel& model,
                                            const ModelFeatureOptions& options = {});

// Which of the features each place of the object frame belongs to.
class FeatureMap {
 public:
  FeatureMap(const std::vector<ModelFeature>& features, double diameter_m);
  // -1: to none, within 1.5 kFeatureSpacing.
  int At(const Eigen::Vector3d& point) const;

 private:
  struct Cell {
    std::int64_t key = 0;
    int feature = -1;
    Eigen::Vector3d point;
  };
  static constexpr int kSide = 1 << 20;
  std::int64_t KeyOf(const Eigen::Vector3i& cell) const;
  Eigen::Vector3i CellOf(const Eigen::Vector3d& point) const;

  double reach_m_ = 0.0;
  std::vector<Cell> cells_;  // by key
};

}  // namespace horopter
