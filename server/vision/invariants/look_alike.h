// Which parts are the same up to a transformation, so that some route of recognition cannot tell
// them apart.
#pragma once

#include <Eigen/Core>
#include <optional>
#include <vector>

#include "server/vision/geometry/object_model.h"

namespace horopter {

enum class LookAlikeKind {
  kCongruent,  // the same part
  kSimilar,    // the same up to scale: only a known size tells them apart
  kMirror,     // mirror images, up to scale: only handedness does
  kAffine,     // the same up to a stretch or shear: projective keys cannot, metric ones can
  kProjective  // the same up to a collineation
};

struct LookAlikeOptions {
  // Largest distance of a mapped vertex from its partner, as a share of the diameter. Raising it
  // reports parts that differ more.
  double tolerance = 5e-3;
  // Singular values of the linear part that count as equal (a similarity), as a ratio - 1.
  double stretch_tolerance = 2e-2;
  // Share of both parts' vertices that must find a partner: under a similarity, which four corners
  // seldom fit by chance, and under a stretch or collineation, which they always do.
  double min_similar_share = 0.6;
  double min_vertex_share = 0.75;
  bool projective = true;  // also look for collineations: slower
};

struct LookAlike {
  LookAlikeKind kind = LookAlikeKind::kCongruent;
  Eigen::Matrix4d b_from_a = Eigen::Matrix4d::Identity();  // metres; a collineation in general
  // Singular values of the linear part, descending: scale, or how each direction is stretched.
  Eigen::Vector3d stretch = Eigen::Vector3d::Ones();
  int matched = 0;  // pairs of vertices
  // What tells the two apart beyond the transformation: vertices without a partner.
  std::vector<int> only_in_a;
  std::vector<int> only_in_b;
};

// The best such transformation, by the smallest group of transformations first, then by matched
// vertices. Nothing when there is none, or when a part has fewer than five corners (a
// transformation of so few fits anything) or all corners in a plane.
//
// Method: four connected corners of a not in a plane fix an affine map to every chain of b; five
// fix a collineation.
std::optional<LookAlike> FindLookAlike(const ObjectModel& a,
                                       const ObjectModel& b,
                                       const LookAlikeOptions& options = {});

}  // namespace horopter
