// Meshes of simple solids, metres, closed, counter-clockwise seen from outside.
#pragma once

#include <Eigen/Core>
#include <cmath>
#include <numbers>
#include <utility>
#include <vector>

#include "server/vision/geometry/object_model.h"

namespace horopter {

// A closed outline in the plane, counter-clockwise and star-shaped about its mean, swept along z
// from -half to half.
inline TriangleMesh SweptMesh(const std::vector<Eigen::Vector2d>& outline, double half) {
  TriangleMesh mesh;
  const int n = static_cast<int>(outline.size());
  Eigen::Vector2d mean = Eigen::Vector2d::Zero();
  for (const Eigen::Vector2d& p : outline) mean += p / n;
  for (const double z : {-half, half}) {
    for (const Eigen::Vector2d& p : outline) mesh.vertices.emplace_back(p.x(), p.y(), z);
  }
  mesh.vertices.emplace_back(mean.x(), mean.y(), -half);
  mesh.vertices.emplace_back(mean.x(), mean.y(), half);
  for (int i = 0; i < n; ++i) {
    const int j = (i + 1) % n;
    mesh.triangles.emplace_back(i, j, n + j);
    mesh.triangles.emplace_back(i, n + j, n + i);
    mesh.triangles.emplace_back(2 * n, j, i);
    mesh.triangles.emplace_back(2 * n + 1, n + i, n + j);
  }
  return mesh;
}

inline TriangleMesh BoxMesh(const Eigen::Vector3d& half) {
  return SweptMesh(
      {{half.x(), -half.y()}, {half.x(), half.y()}, {-half.x(), half.y()}, {-half.x(), -half.y()}},
      half.z());
}

inline std::vector<Eigen::Vector2d> Circle(double radius, int sides) {
  std::vector<Eigen::Vector2d> out;
  for (int i = 0; i < sides; ++i) {
    const double a = 2.0 * std::numbers::pi * i / sides;
    out.emplace_back(radius * std::cos(a), radius * std::sin(a));
  }
  return out;
}

inline TriangleMesh CylinderMesh(double radius, double half, int sides) {
  return SweptMesh(Circle(radius, sides), half);
}

// A disc with a round hole, around the z axis.
inline TriangleMesh RingMesh(double outer, double inner, double half, int sides) {
  TriangleMesh mesh;
  for (const double z : {-half, half}) {
    for (const double r : {outer, inner}) {
      for (const Eigen::Vector2d& p : Circle(r, sides)) mesh.vertices.emplace_back(p.x(), p.y(), z);
    }
  }
  const auto quad = [&](int a, int b, int c, int d) {
    mesh.triangles.emplace_back(a, b, c);
    mesh.triangles.emplace_back(a, c, d);
  };
  for (int i = 0; i < sides; ++i) {
    const int j = (i + 1) % sides;
    const int s = sides;
    quad(i, j, 2 * s + j, 2 * s + i);                  // outside
    quad(s + j, s + i, 3 * s + i, 3 * s + j);          // inside
    quad(j, i, s + i, s + j);                          // below
    quad(2 * s + i, 2 * s + j, 3 * s + j, 3 * s + i);  // above
  }
  return mesh;
}

// Meridians and parallels; 4 * steps * (steps - 1) triangles.
inline TriangleMesh SphereMesh(double radius, int steps) {
  TriangleMesh mesh;
  const int around = 2 * steps;
  for (int i = 1; i < steps; ++i) {
    const double a = std::numbers::pi * i / steps;
    for (const Eigen::Vector2d& p : Circle(radius * std::sin(a), around)) {
      mesh.vertices.emplace_back(p.x(), p.y(), radius * std::cos(a));
    }
  }
  const int north = static_cast<int>(mesh.vertices.size());
  mesh.vertices.emplace_back(0, 0, radius);
  mesh.vertices.emplace_back(0, 0, -radius);
  for (int k = 0; k < around; ++k) {
    const int next = (k + 1) % around;
    mesh.triangles.emplace_back(north, k, next);
    const int last = (steps - 2) * around;
    mesh.triangles.emplace_back(north + 1, last + next, last + k);
    for (int i = 0; i + 2 < steps; ++i) {
      const int up = i * around, down = up + around;
      mesh.triangles.emplace_back(up + k, down + k, down + next);
      mesh.triangles.emplace_back(up + k, down + next, up + next);
    }
  }
  return mesh;
}

// A bar along z whose corner at (+side, +side) is rounded: a quarter circle of `radius`.
inline TriangleMesh FilletedBarMesh(double side, double radius, double half) {
  std::vector<Eigen::Vector2d> outline = {{-side, side}, {-side, -side}, {side, -side}};
  constexpr int kSteps = 32;
  for (int i = 0; i <= kSteps; ++i) {
    const double a = 0.5 * std::numbers::pi * i / kSteps;
    outline.emplace_back(side - radius + radius * std::cos(a),
                         side - radius + radius * std::sin(a));
  }
  return SweptMesh(outline, half);
}

inline void Append(const TriangleMesh& more, const Eigen::Vector3d& shift, TriangleMesh* mesh) {
  const int first = static_cast<int>(mesh->vertices.size());
  for (const Eigen::Vector3d& p : more.vertices) mesh->vertices.push_back(p + shift);
  for (const Eigen::Vector3i& t : more.triangles) {
    mesh->triangles.emplace_back(t.array() + first);
  }
}

inline void TurnInsideOut(TriangleMesh* mesh) {
  for (Eigen::Vector3i& t : mesh->triangles) std::swap(t[1], t[2]);
}

}  // namespace horopter
