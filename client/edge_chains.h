// Joining pieces of sharp edges: collinear lines, arcs of one circle, polygonal rims.
#pragma once

#include <Eigen/Core>
#include <optional>
#include <span>
#include <vector>

#include "server/vision/geometry/object_model.h"

namespace horopter {

struct Circle3 {
  Eigen::Vector3d center = Eigen::Vector3d::Zero();
  Eigen::Vector3d normal = Eigen::Vector3d::UnitZ();
  double radius = 0.0;
};

// Circle through all points within `tolerance` (same unit as the points); nothing for collinear
// points. The points are in order along the curve; first == last means closed.
std::optional<Circle3> CircleThrough(std::span<const Eigen::Vector3d> points, double tolerance);

bool AllOnLine(std::span<const Eigen::Vector3d> points, double tolerance);

// A run of edges of a vertex graph that lie on one circle: consecutive vertex indices; closed runs
// repeat the first.
struct ArcRun {
  std::vector<int> vertices;
  double largest_turn_rad = 0.0;
  bool closed() const { return vertices.front() == vertices.back(); }
};

// Finds the rims of tessellated circles among straight edges (pairs of indices into `points`): at
// least three edges, each turning by at most 38 degrees (a regular 10-gon is a circle, an octagon
// is not), lengths within a factor of 3. Only vertices where exactly two edges meet can be inside a
// run.
std::vector<ArcRun> FindArcRuns(const std::vector<Eigen::Vector3d>& points,
                                const std::vector<std::pair<int, int>>& edges,
                                double tolerance);

// Joins edges at vertices where exactly two edges meet: lines on one line, arcs on one circle (a
// full circle becomes closed, without vertices), and drops the vertices no edge names any more.
// Lengths and `tolerance` in the model's unit.
void MergeSmoothJoints(ObjectModel& model, double tolerance);

// Removes vertices no edge names and renumbers.
void DropUnusedVertices(ObjectModel& model);

}  // namespace horopter
