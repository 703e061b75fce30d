// How a part can lie on a table.
#pragma once

#include <Eigen/Core>
#include <optional>
#include <vector>

#include "server/vision/geometry/object_model.h"

namespace horopter {

struct RestingPose {
  Eigen::Vector3d down_in_object;  // unit vector: into the table
  double share = 0.0;              // of random attitudes that roll into it, quasi-statically
  double height_m = 0.0;           // of the centre of mass above the table
};

// The attitudes in which a part of even density rests: local minima, over all directions, of the
// height of its centre of mass above the plane that supports it. Poses closer than 4 degrees are
// one; directions are searched from `starts` starts. Most probable first. Empty: the mesh has no
// volume.
std::vector<RestingPose> RestingPoses(const TriangleMesh& mesh, int starts = 600);

// Centre of mass of the volume; empty when the mesh has none (open or flat).
std::optional<Eigen::Vector3d> CentreOfMass(const TriangleMesh& mesh);

// The rotation symmetries of a part by axis.
struct DrawnAxis {
  Eigen::Vector3d direction;  // unit, in the object's frame
  Eigen::Vector3d point;      // on the axis
  int order = 2;              // turns by 360/order degrees leave the part unchanged
};
std::vector<DrawnAxis> SymmetryAxes(const std::vector<Rigid3>& symmetries);

}  // namespace horopter
