#include "client/resting_poses.h"

#include <Eigen/Dense>
#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>

namespace horopter {
namespace {

// Evenly spread unit vectors (Fibonacci lattice).
std::vector<Eigen::Vector3d> Directions(int n) {
  const double golden = M_PI * (3.0 - std::sqrt(5.0));
  std::vector<Eigen::Vector3d> directions;
  for (int i = 0; i < n; ++i) {
    const double z = 1.0 - 2.0 * (i + 0.5) / n, r = std::sqrt(1.0 - z * z);
    directions.emplace_back(r * std::cos(golden * i), r * std::sin(golden * i), z);
  }
  return directions;
}

// Vertices that are the farthest in some direction: those the part can stand on.
std::vector<Eigen::Vector3d> ExtremePoints(const TriangleMesh& mesh, const Eigen::Vector3d& c) {
  constexpr int kDirections = 3000;
  std::vector<size_t> indices;
  Eigen::Matrix3Xd points(3, static_cast<Eigen::Index>(mesh.vertices.size()));
  for (size_t i = 0; i < mesh.vertices.size(); ++i) {
    points.col(static_cast<Eigen::Index>(i)) = mesh.vertices[i] - c;
  }
  for (const Eigen::Vector3d& d : Directions(kDirections)) {
    Eigen::Index farthest = 0;
    (d.transpose() * points).maxCoeff(&farthest);
    indices.push_back(static_cast<size_t>(farthest));
  }
  std::sort(indices.begin(), indices.end());
  indices.erase(std::unique(indices.begin(), indices.end()), indices.end());
  std::vector<Eigen::Vector3d> extreme;
  for (const size_t i : indices) extreme.push_back(mesh.vertices[i] - c);
  return extreme;
}

double Height(const Eigen::Matrix3Xd& points, const Eigen::Vector3d& down) {
  return (down.transpose() * points).maxCoeff();
}

// Goes down the height by steps that shrink from 8 degrees to a hundredth of one.
Eigen::Vector3d Roll(const Eigen::Matrix3Xd& points, Eigen::Vector3d down) {
  double height = Height(points, down);
  for (double step = 0.14; step > 2e-4;) {
    const Eigen::Vector3d u = down.unitOrthogonal(), v = down.cross(u);
    Eigen::Vector3d best = down;
    constexpr int kWays = 8;
    for (int k = 0; k < kWays; ++k) {
      const double a = 2.0 * M_PI * k / kWays;
      const Eigen::Vector3d d = (down + step * (std::cos(a) * u + std::sin(a) * v)).normalized();
      const double h = Height(points, d);
      if (h < height) best = d, height = h;
    }
    if (best == down) step *= 0.5;
    down = best;
  }
  return down;
}

}  // namespace

std::optional<Eigen::Vector3d> CentreOfMass(const TriangleMesh& mesh) {
  if (mesh.vertices.empty()) return std::nullopt;
  // Relative to a vertex: the sums of signed tetrahedra cancel less.
  const Eigen::Vector3d origin = mesh.vertices[0];
  double volume = 0.0, largest = 0.0;
  Eigen::Vector3d moment = Eigen::Vector3d::Zero();
  const auto n = static_cast<int>(mesh.vertices.size());
  for (const Eigen::Vector3i& t : mesh.triangles) {
    if (t.minCoeff() < 0 || t.maxCoeff() >= n) continue;
    const Eigen::Vector3d a = mesh.vertices[static_cast<size_t>(t[0])] - origin;
    const Eigen::Vector3d b = mesh.vertices[static_cast<size_t>(t[1])] - origin;
    const Eigen::Vector3d c = mesh.vertices[static_cast<size_t>(t[2])] - origin;
    const double six = a.dot(b.cross(c));
    volume += six / 6.0;
    moment += six / 24.0 * (a + b + c);
    largest = std::max({largest, a.norm(), b.norm(), c.norm()});
  }
  constexpr double kLeastShare = 1e-5;  // of the cube of the size; below: a sheet
  if (!(volume > kLeastShare * largest * largest * largest)) return std::nullopt;
  return Eigen::Vector3d(origin + moment / volume);
}

std::vector<RestingPose> RestingPoses(const TriangleMesh& mesh, int starts) {
  const std::optional<Eigen::Vector3d> centre = CentreOfMass(mesh);
  if (!centre) return {};
  const std::vector<Eigen::Vector3d> extreme = ExtremePoints(mesh, *centre);
  Eigen::Matrix3Xd points(3, static_cast<Eigen::Index>(extreme.size()));
  for (size_t i = 0; i < extreme.size(); ++i) points.col(static_cast<Eigen::Index>(i)) = extreme[i];
  const double same = std::cos(4.0 * M_PI / 180.0);
  std::vector<RestingPose> poses;
  for (const Eigen::Vector3d& start : Directions(starts)) {
    const Eigen::Vector3d down = Roll(points, start);
    const double height = Height(points, down);
    const auto known = std::find_if(poses.begin(), poses.end(), [&](const RestingPose& p) {
      return p.down_in_object.dot(down) > same;
    });
    if (known == poses.end()) {
      poses.push_back({down, 1.0 / starts, height});
      continue;
    }
    known->share += 1.0 / starts;
    if (height < known->height_m) known->down_in_object = down, known->height_m = height;
  }
  std::stable_sort(poses.begin(), poses.end(), [](const RestingPose& a, const RestingPose& b) {
    return a.share > b.share;
  });
  return poses;
}

std::vector<DrawnAxis> SymmetryAxes(const std::vector<Rigid3>& symmetries) {
  std::vector<DrawnAxis> axes;
  for (const Rigid3& s : symmetries) {
    const Eigen::AngleAxisd turn(s.R);
    if (std::abs(turn.angle()) < 1e-4) continue;
    auto axis = std::find_if(axes.begin(), axes.end(), [&](const DrawnAxis& a) {
      return std::abs(a.direction.dot(turn.axis())) > 0.9999;
    });
    if (axis != axes.end()) {
      ++axis->order;
      continue;
    }
    // (I - R) p = t, of least norm: R leaves the axis' points where they are.
    const Eigen::Matrix3d I_R = Eigen::Matrix3d::Identity() - s.R;
    axes.push_back({turn.axis(), I_R.completeOrthogonalDecomposition().solve(s.t), 2});
  }
  return axes;
}

}  // namespace horopter
