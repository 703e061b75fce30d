// Circles, their exact images and a turned part.
#pragma once

#include <Eigen/Dense>
#include <cmath>
#include <numbers>
#include <random>
#include <vector>

#include "tests/support/synthetic_part.h"

namespace horopter {

struct CircleInSpace {
  Eigen::Vector3d center, normal;
  double radius_m = 0.0;
};

// The exact image of a circle, by a conic through its projected points.
inline EllipseArc ImageOf(const CircleInSpace& circle,
                          const PinholeCamera& camera,
                          const Rigid3& camera_from_scene,
                          double noise_px,
                          std::mt19937* rng) {
  std::normal_distribution<double> noise(0.0, noise_px);
  const Eigen::Vector3d u = circle.normal.unitOrthogonal(), w = circle.normal.cross(u);
  constexpr int kPoints = 40;
  Eigen::MatrixXd A(kPoints, 5);
  std::vector<Eigen::Vector2d> points;
  Eigen::Vector2d mean = Eigen::Vector2d::Zero();
  for (int i = 0; i < kPoints; ++i) {
    const double t = 2 * std::numbers::pi * i / kPoints;
    const Eigen::Vector3d x = circle.center + circle.radius_m * (std::cos(t) * u + std::sin(t) * w);
    points.push_back(Project(camera, camera_from_scene * x) +
                     Eigen::Vector2d(noise(*rng), noise(*rng)));
    mean += points.back() / kPoints;
  }
  for (int i = 0; i < kPoints; ++i) {
    const Eigen::Vector2d p = 0.05 * (points[i] - mean);
    A.row(i) << p.x() * p.x(), p.x() * p.y(), p.y() * p.y(), p.x(), p.y();
  }
  const Eigen::VectorXd c = A.colPivHouseholderQr().solve(Eigen::VectorXd::Ones(kPoints));
  Eigen::Matrix2d Q;
  Q << c(0), c(1) / 2, c(1) / 2, c(2);
  const Eigen::Vector2d center = -0.5 * Q.inverse() * Eigen::Vector2d(c(3), c(4));
  const double level = 1.0 + center.dot(Q * center);
  const Eigen::SelfAdjointEigenSolver<Eigen::Matrix2d> solver(Q);
  EllipseArc arc;
  arc.center = mean + 20.0 * center;
  arc.semi_major_px = 20.0 * std::sqrt(level / solver.eigenvalues()(0));
  arc.semi_minor_px = 20.0 * std::sqrt(level / solver.eigenvalues()(1));
  arc.angle_rad = std::atan2(solver.eigenvectors()(1, 0), solver.eigenvectors()(0, 0));
  arc.sweep_rad = 2 * std::numbers::pi;
  return arc;
}

// 60 chords of each arc as segments, as a detector of straight pieces leaves them.
inline void AddChords(ImageFeatures* features) {
  for (const EllipseArc& arc : features->arcs) {
    for (int i = 0; i < 60; ++i) {
      Segment s;
      for (const int end : {0, 1}) {
        const double t = 2 * std::numbers::pi * (i + end) / 60;
        const Eigen::Vector2d at(arc.semi_major_px * std::cos(t), arc.semi_minor_px * std::sin(t));
        (end == 0 ? s.start : s.end) = arc.center + Eigen::Rotation2Dd(arc.angle_rad) * at;
      }
      features->segments.push_back(s);
    }
  }
}

// A disc about the z axis, 60 mm wide and 15 mm high: a prism of 48 sides with circular rims, and
// circles printed on its top.
inline ObjectModel Disc(const std::vector<CircleInSpace>& on_top) {
  constexpr int kSides = 48;
  constexpr double kRadius = 0.03, kHeight = 0.015;
  std::vector<Eigen::Vector2d> polygon;
  for (int i = 0; i < kSides; ++i) {
    const double t = 2 * std::numbers::pi * i / kSides;
    polygon.emplace_back(kRadius * std::cos(t), kRadius * std::sin(t));
  }
  ObjectModel m = Prism("disc", polygon, kHeight);
  m.vertices.clear();
  m.edges.clear();
  std::vector<CircleInSpace> circles = {{{0, 0, 0}, {0, 0, 1}, kRadius},
                                        {{0, 0, kHeight}, {0, 0, 1}, kRadius}};
  circles.insert(circles.end(), on_top.begin(), on_top.end());
  for (const CircleInSpace& c : circles) {
    ModelEdge edge;
    edge.kind = CurveKind::kCircle;
    edge.dihedral_rad = 1.5708;
    for (int i = 0; i <= kSides; ++i) {
      const double t = 2 * std::numbers::pi * (i % kSides) / kSides;
      edge.polyline.push_back(c.center +
                              c.radius_m * Eigen::Vector3d(std::cos(t), std::sin(t), 0.0));
    }
    m.edges.push_back(edge);
  }
  return m;
}

}  // namespace horopter
