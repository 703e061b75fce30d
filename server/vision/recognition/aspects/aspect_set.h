// How a part looks from around: for views over the sphere, points of its visible edges.
#pragma once

#include <Eigen/Core>
#include <array>
#include <cstdint>
#include <functional>
#include <limits>
#include <span>
#include <vector>

#include "server/vision/geometry/pinhole_camera.h"
#include "server/vision/geometry/rigid3.h"
#include "server/vision/recognition/aspects/render_mesh.h"
#include "server/vision/recognition/aspects/visible_edges.h"

namespace horopter {

struct AspectOptions {
  int directions = 300;  // over the whole sphere, of which symmetric ones are dropped
  double distance_diameters = 4.0;
  double render_px = 180.0;  // a diameter
  int max_points = 220;      // an aspect
  int spread_points = 64;    // the first ones, spread as far apart as possible
};

// A point of a visible edge of one aspect.
struct AspectPoint {
  Eigen::Vector3f point;      // metres, object frame
  Eigen::Vector3f direction;  // unit, object frame
  VisibleEdgeKind kind;
};

// The same in six bytes: 11 bits a coordinate over the diameter (0.09 px of a rendering of 180 px),
// 13 bits of direction (to 1.5 degrees), 2 bits of kind.
using PackedAspectPoint = std::array<std::uint16_t, 3>;

// One view: the camera looks at the centre of the bounding box from `distance_m` away.
struct Aspect {
  Eigen::Matrix3f camera_from_object = Eigen::Matrix3f::Identity();  // rotation
  std::uint32_t first_point = 0;                                     // in AspectSet::points
  std::uint32_t point_count = 0;
};

// camera_from_object x = R (x - center) + (0, 0, distance_m).
struct AspectSet {
  double diameter_m = 0.0;
  double distance_m = 0.0;
  double render_px = 0.0;
  Eigen::Vector3f center = Eigen::Vector3f::Zero();
  std::vector<Aspect> aspects;
  std::vector<PackedAspectPoint> points;
};

// One aspect's points: the first `spread_points` in farthest-point order, so that every prefix of
// them is spread over the view; the rest evenly along the edges. most: of them, the first ones.
std::vector<AspectPoint> AspectPoints(const AspectSet& set,
                                      int aspect,
                                      std::size_t most = std::numeric_limits<std::size_t>::max());

// The pose of an aspect, and the camera it was rendered by: `render_px` pixels a diameter at the
// centre's depth, which projects to the principal point in the middle of the image.
Rigid3 AspectPose(const AspectSet& set, int aspect);
PinholeCamera AspectCamera(const AspectSet& set);

// All edges of an aspect in chains, as they were when its points were drawn from them. Recomputed
// (a few milliseconds), so that nothing large is stored.
VisibleEdges AspectEdges(const RenderMesh& mesh, const AspectSet& set, int aspect);

// Called with each aspect's number and its edges, in order; they are what AspectEdges gives.
using AspectVisitor = std::function<void(int aspect, const VisibleEdges& edges)>;

// `symmetries`: as ObjectModel::symmetries; of views that they make equal only one is kept.
// `visit`: who needs the edges while they are there (a rendering each).
AspectSet MakeAspects(const RenderMesh& mesh,
                      std::span<const Rigid3> symmetries,
                      const AspectOptions& options = {},
                      const AspectVisitor& visit = {});

}  // namespace horopter
