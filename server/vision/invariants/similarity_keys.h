// Keys of four connected vertices under similarities.
#pragma once

#include <Eigen/Core>
#include <array>
#include <optional>
#include <span>
#include <vector>

#include "server/vision/geometry/object_model.h"
#include "server/vision/invariants/invariant_key.h"

namespace horopter {

// Indices of four different vertices. Chain: edges 0-1, 1-2, 2-3. Star: edges 0-1, 0-2, 0-3.
using FourVertices = std::array<int, 4>;

// Straight edges of the model give its vertex graph; every chain once (its reverse is the other
// labeling), every star once per set of three neighbours (six labelings).
std::vector<FourVertices> VertexChains(const ObjectModel& model);
std::vector<FourVertices> VertexStars(const ObjectModel& model);

struct SimilarityKeyOptions {
  // Two vertices nearer than this share of the largest distance reject the key.
  double min_distance_ratio = 0.02;
  // Standard deviation of a log distance above which a key says too little (7.6, 3).
  double max_log_deviation = 0.06;
};

struct SimilarityKey {
  // Six log distances in an orthonormal basis of what a change of scale leaves alone: 5 values.
  InvariantKey key;
  double log_size = 0.0;  // mean log distance: with it the key is one of congruence
  // Sign of the triple product (p1 - p0, p2 - p0, p3 - p0); 0: nearly in one plane. Mirror images
  // differ in it.
  int handedness = 0;
};

// points in any metric frame; covariance 12 x 12 of the stacked points, or empty. Nothing when two
// points coincide or the key is too uncertain.
std::optional<SimilarityKey> SimilarityKeyOf(std::span<const Eigen::Vector3d, 4> points,
                                             const Eigen::MatrixXd& covariance = {},
                                             const SimilarityKeyOptions& options = {});

}  // namespace horopter
