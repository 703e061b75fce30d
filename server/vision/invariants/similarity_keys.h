// Keys of four connected vertices under similarities (geometry.md 7.3) and as seen in an image.
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

// Image of a chain a-b-c-d, 4 values: a and d in the similarity frame of the image that puts b at
// (0, 0) and c at (1, 0). No single view of four points has an invariant; a model path is therefore
// a surface of keys over the view sphere, stored by sampling (PathKeysOverViews). covariance is 8 x
// 8 of the stacked pixels, or empty. Nothing when b and c (nearly) coincide.
std::optional<InvariantKey> PathViewKey(std::span<const Eigen::Vector2d, 4> image_points,
                                        const Eigen::MatrixXd& covariance = {});

struct PathView {
  Eigen::Vector3d direction = Eigen::Vector3d::UnitZ();  // from the object to the camera, unit
  InvariantKey key;
};

struct PathViewOptions {
  int directions = 200;  // samples of the view sphere; more: denser keys, more memory
  // Camera distance in diameters of the path; 0: weak perspective (infinitely far).
  double distance_diameters = 0.0;
  double min_length_ratio = 0.1;  // b-c foreshortened below this share of its length is left out
};

std::vector<PathView> PathKeysOverViews(std::span<const Eigen::Vector3d, 4> path,
                                        const PathViewOptions& options = {});

// The image of the path from a direction, up to a similarity of the image.
std::array<Eigen::Vector2d, 4> ProjectPath(std::span<const Eigen::Vector3d, 4> path,
                                           const Eigen::Vector3d& direction,
                                           double distance_diameters);

}  // namespace horopter
