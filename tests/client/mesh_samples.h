// Triangle meshes with known edges, and writers for the formats the import reads.
#pragma once

#include <Eigen/Core>
#include <cmath>
#include <cstdio>
#include <string>
#include <vector>

#include "server/vision/geometry/object_model.h"

namespace horopter {

// Prism over a polygon in the plane z = 0 (counter-clockwise, star-shaped about `center`), z from 0
// to height.
inline TriangleMesh Prism(const std::vector<Eigen::Vector2d>& polygon,
                          double height,
                          const Eigen::Vector2d& center = Eigen::Vector2d::Zero()) {
  TriangleMesh mesh;
  const int n = static_cast<int>(polygon.size());
  for (const double z : {0.0, height}) {
    for (const auto& p : polygon) mesh.vertices.emplace_back(p.x(), p.y(), z);
  }
  mesh.vertices.emplace_back(center.x(), center.y(), 0.0);
  mesh.vertices.emplace_back(center.x(), center.y(), height);
  for (int i = 0; i < n; ++i) {
    const int j = (i + 1) % n;
    mesh.triangles.emplace_back(2 * n, j, i);
    mesh.triangles.emplace_back(2 * n + 1, n + i, n + j);
    mesh.triangles.emplace_back(i, j, n + j);
    mesh.triangles.emplace_back(i, n + j, n + i);
  }
  return mesh;
}

inline std::vector<Eigen::Vector2d> RegularPolygon(int n, double radius) {
  std::vector<Eigen::Vector2d> p;
  for (int i = 0; i < n; ++i) {
    p.emplace_back(radius * std::cos(2 * M_PI * i / n), radius * std::sin(2 * M_PI * i / n));
  }
  return p;
}

inline TriangleMesh Box(double x, double y, double z) {
  return Prism({{-x / 2, -y / 2}, {x / 2, -y / 2}, {x / 2, y / 2}, {-x / 2, y / 2}}, z);
}

inline TriangleMesh Scaled(TriangleMesh mesh, double factor) {
  for (auto& v : mesh.vertices) v *= factor;
  return mesh;
}

inline TriangleMesh Moved(TriangleMesh mesh, const Rigid3& motion) {
  for (auto& v : mesh.vertices) v = motion * v;
  return mesh;
}

inline std::string Line(const Eigen::Vector3d& p) {
  char text[120];
  std::snprintf(text, sizeof(text), "%.9g %.9g %.9g", p.x(), p.y(), p.z());
  return text;
}

inline std::string AsPly(const TriangleMesh& mesh) {
  std::string text = "ply\nformat ascii 1.0\nelement vertex " +
                     std::to_string(mesh.vertices.size()) +
                     "\nproperty float x\nproperty float y\nproperty float z\nelement face " +
                     std::to_string(mesh.triangles.size()) +
                     "\nproperty list uchar int vertex_indices\nend_header\n";
  for (const auto& v : mesh.vertices) text += Line(v) + "\n";
  for (const auto& t : mesh.triangles) {
    text += "3 " + std::to_string(t[0]) + " " + std::to_string(t[1]) + " " + std::to_string(t[2]) +
            "\n";
  }
  return text;
}

inline std::string AsObj(const TriangleMesh& mesh) {
  std::string text;
  for (const auto& v : mesh.vertices) text += "v " + Line(v) + "\n";
  for (const auto& t : mesh.triangles) {
    text += "f " + std::to_string(t[0] + 1) + " " + std::to_string(t[1] + 1) + " " +
            std::to_string(t[2] + 1) + "\n";
  }
  return text;
}

// Facets in any order, nothing shared.
inline std::string AsStl(const TriangleMesh& mesh) {
  std::string text = "solid part\n";
  for (const auto& t : mesh.triangles) {
    text += "facet normal 0 0 0\nouter loop\n";
    for (int k = 0; k < 3; ++k) text += "vertex " + Line(mesh.vertices[t[k]]) + "\n";
    text += "endloop\nendfacet\n";
  }
  return text + "endsolid part\n";
}

}  // namespace horopter
