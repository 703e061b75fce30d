// Parts with known geometry and the features an ideal detector would find of them.
#pragma once

#include <Eigen/Geometry>
#include <map>
#include <random>
#include <string>
#include <utility>
#include <vector>

#include "server/vision/features/features.h"
#include "server/vision/geometry/object_model.h"
#include "server/vision/geometry/pinhole_camera.h"
#include "server/vision/recognition/object/prepared_object.h"
#include "tests/support/view_sphere.h"

namespace horopter {

// A prism over a polygon (counter-clockwise, metres), extruded from z = 0 to height. The polygon
// must be star-shaped about its first vertex (caps are triangulated as a fan).
inline ObjectModel Prism(const std::string& id,
                         const std::vector<Eigen::Vector2d>& polygon,
                         double height) {
  ObjectModel m;
  m.id = id;
  const int n = static_cast<int>(polygon.size());
  for (int level = 0; level < 2; ++level) {
    for (const auto& p : polygon) m.vertices.emplace_back(p.x(), p.y(), level * height);
  }
  auto edge = [&](int a, int b) {
    ModelEdge e;
    e.start_vertex = a;
    e.end_vertex = b;
    e.dihedral_rad = 1.5708;
    e.polyline = {m.vertices[a], m.vertices[b]};
    m.edges.push_back(e);
  };
  for (int i = 0; i < n; ++i) {
    const int j = (i + 1) % n;
    edge(i, j);
    edge(n + i, n + j);
    edge(i, n + i);
    m.mesh.triangles.emplace_back(i, j, n + j);
    m.mesh.triangles.emplace_back(i, n + j, n + i);
  }
  for (int i = 1; i + 1 < n; ++i) {
    m.mesh.triangles.emplace_back(0, i + 1, i);
    m.mesh.triangles.emplace_back(n, n + i, n + i + 1);
  }
  m.mesh.vertices = m.vertices;
  for (const auto& a : m.vertices) {
    for (const auto& b : m.vertices) m.diameter_m = std::max(m.diameter_m, (a - b).norm());
  }
  return m;
}

// An L-shaped bracket without symmetry, 80 x 60 x 40 mm.
inline ObjectModel LBracket() {
  return Prism("l_bracket",
               {{0, 0}, {0.08, 0}, {0.08, 0.015}, {0.02, 0.02}, {0.015, 0.06}, {0, 0.06}},
               0.04);
}

// A wedge, 70 x 30 x 50 mm.
inline ObjectModel Wedge() {
  return Prism("wedge", {{0, 0}, {0.07, 0}, {0.015, 0.03}}, 0.05);
}

// Camera looking at a target from `eye`, image x roughly along the world's horizontal.
inline Rigid3 LookAt(const Eigen::Vector3d& eye, const Eigen::Vector3d& target) {
  Rigid3 camera_from_world;
  const Eigen::Vector3d z = (target - eye).normalized();
  const Eigen::Vector3d x = z.cross(Eigen::Vector3d::UnitZ()).normalized();
  camera_from_world.R.row(0) = x;
  camera_from_world.R.row(1) = z.cross(x);
  camera_from_world.R.row(2) = z;
  camera_from_world.t = -(camera_from_world.R * eye);
  return camera_from_world;
}

// The segments and junctions of the straight edges seen in full, end points with Gaussian noise.
inline void AddSyntheticFeatures(const PreparedObject& object,
                                 const PinholeCamera& camera,
                                 const Rigid3& camera_from_object,
                                 double noise_px,
                                 std::mt19937* rng,
                                 ImageFeatures* features) {
  features->width = camera.width;
  features->height = camera.height;
  std::normal_distribution<double> noise(0.0, noise_px);
  const Eigen::Vector3d to_camera =
      camera_from_object.R.transpose() * -camera_from_object.t - object.center;
  const std::vector<double> seen = EdgesSeenFrom(object, to_camera);
  std::map<int, Junction> junctions;
  for (int e = 0; e < static_cast<int>(object.model.edges.size()); ++e) {
    const ModelEdge& edge = object.model.edges[e];
    if (seen[e] < 0.9) continue;
    Segment s;
    s.start = Project(camera, camera_from_object * edge.polyline.front());
    s.end = Project(camera, camera_from_object * edge.polyline.back());
    s.start += Eigen::Vector2d(noise(*rng), noise(*rng));
    s.end += Eigen::Vector2d(noise(*rng), noise(*rng));
    s.contrast = 40;
    const int index = static_cast<int>(features->segments.size());
    features->segments.push_back(s);
    junctions[edge.start_vertex].ends.push_back({index, true});
    junctions[edge.end_vertex].ends.push_back({index, false});
  }
  for (auto& [vertex, junction] : junctions) {
    if (junction.ends.size() < 2) continue;
    junction.point = Project(camera, camera_from_object * object.model.vertices[vertex]) +
                     Eigen::Vector2d(noise(*rng), noise(*rng));
    features->junctions.push_back(junction);
  }
}

}  // namespace horopter
