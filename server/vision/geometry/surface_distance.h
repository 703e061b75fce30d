// Distance of points to the triangles of a mesh.
#pragma once

#include <Eigen/Core>
#include <cstdint>
#include <vector>

#include "server/vision/geometry/object_model.h"

namespace horopter {

// Point of the triangle a, b, c nearest to p. Ericson 2005, Real-Time Collision Detection, 5.1.5.
Eigen::Vector3d NearestInTriangle(const Eigen::Vector3d& p,
                                  const Eigen::Vector3d& a,
                                  const Eigen::Vector3d& b,
                                  const Eigen::Vector3d& c);

// A grid of cells over a mesh, which must outlive it, each with the triangles that cross it. Looks
// no farther than `reach`. Immutable: threads may share it.
class SurfaceDistance {
 public:
  // reach > 0, in metres; triangles whose indices are out of range are left out.
  SurfaceDistance(const TriangleMesh& mesh, double reach);

  struct Nearest {
    double distance = 0.0;  // `reach` if nothing is nearer
    int triangle = -1;
    Eigen::Vector3d point = Eigen::Vector3d::Zero();
  };
  Nearest At(const Eigen::Vector3d& p) const;

  double reach() const { return reach_; }

 private:
  Eigen::Vector3i CellOf(const Eigen::Vector3d& p) const;

  const TriangleMesh& mesh_;
  double reach_;
  double cell_ = 0.0;
  Eigen::Vector3d low_ = Eigen::Vector3d::Zero();
  Eigen::Vector3i size_ = Eigen::Vector3i::Zero();
  std::vector<std::int32_t> first_;      // of each cell in triangles_, one more at the end
  std::vector<std::int32_t> triangles_;  // may name a triangle in many cells
};

}  // namespace horopter
