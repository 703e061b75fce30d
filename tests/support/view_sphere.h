// Which edges of a part a camera sees from around, for drawn scenes: by a rendering of its depth
// from the nearest of some directions over the sphere.
#pragma once

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <vector>

#include "server/vision/geometry/depth_buffer.h"
#include "server/vision/geometry/hidden_tolerance.h"
#include "server/vision/geometry/pinhole_camera.h"
#include "server/vision/recognition/object/prepared_object.h"

namespace horopter {

// The sphere as a cube map of kViewGrid^2 cells a face, 5 to 9 degrees wide: the central direction
// of the cell that a direction (of any length but 0) falls into.
inline constexpr int kViewGrid = 12;
inline Eigen::Vector3d ViewDirection(const Eigen::Vector3d& direction) {
  int axis = 0;
  direction.cwiseAbs().maxCoeff(&axis);
  const double m = std::abs(direction[axis]);
  const auto middle = [&](double x) {
    const int cell =
        std::clamp(static_cast<int>((x / m + 1.0) * 0.5 * kViewGrid), 0, kViewGrid - 1);
    return (cell + 0.5) * 2.0 / kViewGrid - 1.0;
  };
  Eigen::Vector3d out;
  out[axis] = direction[axis] < 0 ? -1.0 : 1.0;
  out[(axis + 1) % 3] = middle(direction[(axis + 1) % 3]);
  out[(axis + 2) % 3] = middle(direction[(axis + 2) % 3]);
  return out.normalized();
}

// Of each edge of the model the share of its samples that nothing hides from a camera in this
// direction from its centre, object frame.
inline std::vector<double> EdgesSeenFrom(const PreparedObject& object,
                                         const Eigen::Vector3d& direction) {
  constexpr int kPixels = 160;        // side of the rendering
  constexpr double kDiameters = 6.0;  // distance of the camera
  const double diameter = object.model.diameter_m;
  const PinholeCamera camera = CenteredCamera(kPixels, kPixels, 0.9 * kPixels * kDiameters);
  const Eigen::Vector3d d = ViewDirection(direction), x = d.unitOrthogonal();
  Rigid3 camera_from_object;
  camera_from_object.R.row(0) = x;
  camera_from_object.R.row(1) = (-d).cross(x);
  camera_from_object.R.row(2) = -d;
  camera_from_object.t = -(camera_from_object.R * (object.center + d * kDiameters * diameter));
  DepthBuffer buffer = MakeDepthBuffer(kPixels, kPixels);
  RenderDepth(object.model.mesh, camera, camera_from_object, &buffer);
  std::vector<double> all(object.model.edges.size(), 0.0), seen = all;
  for (const EdgeSample& s : object.samples) {
    const Eigen::Vector3d p = camera_from_object * s.point.cast<double>();
    all[s.edge] += 1.0;
    seen[s.edge] += IsVisible(buffer, Project(camera, p), p.z(), kHiddenShareAdjusted * diameter);
  }
  for (std::size_t e = 0; e < seen.size(); ++e) seen[e] /= std::max(1.0, all[e]);
  return seen;
}

}  // namespace horopter
