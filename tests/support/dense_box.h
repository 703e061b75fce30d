// A box as a scanner gives it: vertices all over its faces, off them by noise.
#pragma once

#include <Eigen/Core>
#include <array>
#include <map>
#include <random>

#include "server/vision/geometry/object_model.h"

namespace horopter {

// Sides of `side`, each `cells` by `cells` squares of two triangles, outward; vertices moved by
// independent normal noise.
inline TriangleMesh DenseBox(double side, int cells, double noise) {
  TriangleMesh mesh;
  std::map<std::array<int, 3>, int> index;
  std::mt19937 random(7);
  std::normal_distribution<double> gauss(0.0, 1.0);
  const auto vertex = [&](const Eigen::Vector3i& k) {
    const auto [it, added] = index.try_emplace({k[0], k[1], k[2]}, mesh.vertices.size());
    if (added) {
      const Eigen::Vector3d off(gauss(random), gauss(random), gauss(random));
      mesh.vertices.push_back(side / cells * k.cast<double>() + noise * off);
    }
    return it->second;
  };
  for (int axis = 0; axis < 3; ++axis) {
    const Eigen::Vector3i u = Eigen::Vector3i::Unit((axis + 1) % 3);
    const Eigen::Vector3i w = Eigen::Vector3i::Unit((axis + 2) % 3);
    for (const int far : {0, cells}) {
      for (int i = 0; i < cells * cells; ++i) {
        const Eigen::Vector3i at =
            far * Eigen::Vector3i::Unit(axis) + i % cells * u + i / cells * w;
        const std::array<int, 4> c = {
            vertex(at), vertex(at + u), vertex(at + u + w), vertex(at + w)};
        if (far > 0) {
          mesh.triangles.emplace_back(c[0], c[1], c[2]);
          mesh.triangles.emplace_back(c[0], c[2], c[3]);
        } else {
          mesh.triangles.emplace_back(c[0], c[2], c[1]);
          mesh.triangles.emplace_back(c[0], c[3], c[2]);
        }
      }
    }
  }
  return mesh;
}

}  // namespace horopter
