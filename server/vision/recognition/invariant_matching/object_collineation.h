// The transformation of an object into a reconstructed scene from corresponding vertices and edges:
// a collineation, a similarity or a rigid motion (thesis 4.4).
#pragma once

#include <Eigen/Core>
#include <span>
#include <vector>

#include "absl/status/statusor.h"
#include "server/vision/geometry/object_model.h"
#include "server/vision/recognition/invariant_matching/scene_structure.h"

namespace horopter {

enum class TransformGroup {
  kCollineation,  // projective structures: 15 parameters
  kSimilarity,    // metric structures of unknown scale: 7
  kCongruence,    // ... of known scale: 6
};

// An object in coordinates of order one: centred on its vertices, largest distance 1.
struct ObjectShape {
  std::vector<Eigen::Vector3d> vertices;  // of the model, mapped by unit_from_object
  std::vector<std::array<int, 2>> edges;  // straight ones, by vertex
  std::vector<std::vector<bool>> joined;  // [vertex][vertex]
  Eigen::Matrix4d unit_from_object = Eigen::Matrix4d::Identity();  // centre, then scale

  int size() const { return static_cast<int>(vertices.size()); }
};
ObjectShape ShapeOf(const ObjectModel& model);

// A vertex of an object that is a point of the structure, an edge that is one of its lines.
struct VertexMatch {
  int vertex = -1;
  int point = -1;

  friend bool operator==(const VertexMatch&, const VertexMatch&) = default;
};
struct EdgeMatch {
  int edge = -1;
  int line = -1;

  friend bool operator==(const EdgeMatch&, const EdgeMatch&) = default;
};

// Structure from shape by linear, scale-free equations. Five vertices in general position, three
// and two edges or five edges for a collineation; four vertices not in a plane, of similar shape,
// for a similarity (absolute orientation, edges are ignored). A congruence takes the scale
// `structure_units_per_shape`. Errors: INVALID_ARGUMENT (an index out of range, a vertex or point
// twice, not finite), FAILED_PRECONDITION (too few, or in a degenerate position).
absl::StatusOr<Eigen::Matrix4d> FitTransform(TransformGroup group,
                                             const SceneStructure& structure,
                                             const ObjectShape& shape,
                                             std::span<const VertexMatch> vertices,
                                             std::span<const EdgeMatch> edges,
                                             double structure_units_per_shape = 1.0);

// The collineation that takes points to others, in closed form (the point-only geometric solution):
// exact on the first four, which make the bases of both sides and should be the best conditioned;
// the others, one at least, determine the scales of the bases in the least-squares sense. Errors:
// INVALID_ARGUMENT (sizes differ, fewer than five), FAILED_PRECONDITION (four basis points
// coplanar, or the others do not determine the scales).
absl::StatusOr<Eigen::Matrix4d> CollineationFromBasis(std::span<const Eigen::Vector4d> from,
                                                      std::span<const Eigen::Vector4d> to);

// What the observations of each point say about it with the cameras fixed: 3 x 3, inverse
// variances.
std::vector<Eigen::Matrix3d> PointInformation(const SceneStructure& structure);

// Squared Mahalanobis distance of a mapped vertex (3 degrees of freedom); infinite behind w = 0.
double VertexChi2(const Eigen::Matrix4d& transform,
                  const Eigen::Vector3d& vertex,
                  const Eigen::Vector3d& point,
                  const Eigen::Matrix3d& information);

struct RefineTransformOptions {
  int iterations = 8;
};

// Levenberg-Marquardt on the reprojection errors of the matched vertices (to second order about
// their points) and of the matched edges' ends, robust. Returns `transform` where nothing improves.
Eigen::Matrix4d RefineTransform(TransformGroup group,
                                const SceneStructure& structure,
                                std::span<const Eigen::Matrix3d> information,
                                const ObjectShape& shape,
                                std::span<const VertexMatch> vertices,
                                std::span<const EdgeMatch> edges,
                                const RefineTransformOptions& options,
                                const Eigen::Matrix4d& transform);

// Mean squared distance, in sigmas, of an observed line's ends from the projected edge over all
// views that see it; infinite when no view does.
double EdgeChi2(const SceneStructure& structure,
                const std::vector<std::vector<int>>& observations_of_line,
                const Eigen::Matrix4d& transform,
                const Eigen::Vector3d& a,
                const Eigen::Vector3d& b,
                int line);

// Line observations by line.
std::vector<std::vector<int>> ObservationsOfLines(const SceneStructure& structure);

}  // namespace horopter
