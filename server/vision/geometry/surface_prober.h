// How well motions take a surface onto itself, from samples of it: what the search for symmetries
// (mesh_symmetry.h) asks.
#pragma once

#include <Eigen/Dense>
#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <limits>
#include <numbers>
#include <numeric>
#include <optional>
#include <random>
#include <vector>

#include "server/base/stop_scope.h"
#include "server/vision/geometry/mesh_symmetry.h"
#include "server/vision/geometry/surface_distance.h"

namespace horopter {

inline constexpr double kSameAxis = 0.9998;  // cosine, one degree
inline constexpr int kAreaSamples = 700;     // at most, that stand for the surface
inline constexpr int kFitSamples = 300;      // of them, for moving an axis

struct SurfaceSample {
  Eigen::Vector3d point;
  bool vertex = false;  // of the mesh, where its features are; otherwise stands for area
};

// Samples are drawn once; everything else is asked of them. The mesh and the options outlive it.
class SurfaceProber {
 public:
  SurfaceProber(const TriangleMesh& mesh, double diameter_m, const MeshSymmetryOptions& options)
      : mesh_(mesh),
        options_(options),
        diameter_(diameter_m),
        surface_(mesh, options.reach * diameter_m) {
    Draw();
  }

  bool empty() const { return area_.empty(); }
  const Eigen::Vector3d& center() const { return center_; }
  double diameter_m() const { return diameter_; }
  double near_mean_m() const { return options_.near_mean * diameter_; }
  double tolerance_m() const { return options_.tolerance * diameter_; }

  // Mean distance of the first `count` samples of the area; at least `enough` if it gets there.
  double Mean(const Rigid3& motion, int count, double enough) const {
    count = std::min<int>(count, static_cast<int>(area_.size()));
    LeaveIfStopped();
    const double most = enough * count;
    double sum = 0.0;
    for (int i = 0; i < count; ++i) {
      sum += surface_.At(motion * area_[i].point).distance;
      if (sum > most) return std::max(enough, sum / count);
    }
    return sum / count;
  }

  // Whether no sample is off.
  bool Exact(const Rigid3& motion) const {
    const auto on = [&](const SurfaceSample& s) {
      return surface_.At(motion * s.point).distance <= tolerance_m();
    };
    return std::all_of(area_.begin(), area_.end(), on) &&
           std::all_of(vertices_.begin(), vertices_.end(), on);
  }

  // Vertices at one distance from the centre, and the facets between them not far inside.
  bool IsSphere() const {
    double least = std::numeric_limits<double>::infinity(), most = 0.0, inside = least;
    for (const SurfaceSample& s : vertices_) {
      const double r = (s.point - center_).norm();
      least = std::min(least, r);
      most = std::max(most, r);
    }
    for (const SurfaceSample& s : area_) inside = std::min(inside, (s.point - center_).norm());
    return most - least <= 2.0 * tolerance_m() && inside >= kSphereInside * most;
  }

  SurfaceMismatch Measure(const Rigid3& motion) const {
    SurfaceMismatch out;
    std::vector<Eigen::Vector3d> off_area, off_vertices;
    for (const auto* samples : {&area_, &vertices_}) {
      for (const SurfaceSample& s : *samples) {
        const double distance = surface_.At(motion * s.point).distance;
        out.largest_m = std::max(out.largest_m, distance);
        const bool off = distance > tolerance_m();
        if (off) (s.vertex ? off_vertices : off_area).push_back(s.point);
        if (!s.vertex) out.mean_m += distance / static_cast<double>(area_.size());
      }
    }
    out.area_share = static_cast<double>(off_area.size()) / static_cast<double>(area_.size());
    // What a feature is told by are its vertices; the plain face in the place of its counterpart
    // has none.
    const auto& off = off_vertices.size() >= 3 ? off_vertices : off_area;
    const Eigen::AlignedBox3d region = LargestRegion(off);
    if (!region.isEmpty()) {
      out.place = region.center();
      out.size_m = region.diagonal().norm();
    }
    return out;
  }

  // The axis moved to where its turn fits best: point-to-plane steps on what lies near already.
  SymmetryAxis Fit(SymmetryAxis axis, double angle) const {
    Rigid3 motion = TurnAbout(axis, angle);
    double gate = 0.03 * diameter_;
    for (int round = 0; round < 4; ++round, gate *= 0.6) {
      Eigen::Matrix<double, 6, 6> A = Eigen::Matrix<double, 6, 6>::Zero();
      Eigen::Matrix<double, 6, 1> b = Eigen::Matrix<double, 6, 1>::Zero();
      const int count = std::min<int>(kFitSamples, static_cast<int>(area_.size()));
      for (int i = 0; i < count; ++i) {
        const Eigen::Vector3d p = motion * area_[i].point;
        const SurfaceDistance::Nearest nearest = surface_.At(p);
        if (nearest.triangle < 0 || nearest.distance > gate) continue;
        const Eigen::Vector3d n = NormalOf(nearest.triangle);
        Eigen::Matrix<double, 6, 1> row;
        row << (p - center_).cross(n) / diameter_, n;  // rotations in diameters
        A += row * row.transpose();
        b -= n.dot(p - nearest.point) * row;
      }
      // Free directions (a cylinder turns as it likes) stay as they are.
      A.diagonal().array() += 1e-3 * A.trace() / 6.0 + 1e-12;
      const Eigen::Matrix<double, 6, 1> step = A.ldlt().solve(b);
      const Eigen::Vector3d turn = step.head<3>() / diameter_;
      const double size = turn.norm();
      const Eigen::Matrix3d R = size > 1e-12
                                    ? Eigen::AngleAxisd(size, turn / size).toRotationMatrix()
                                    : Eigen::Matrix3d(Eigen::Matrix3d::Identity());
      motion = Rigid3{R, center_ - R * center_ + step.tail<3>()} * motion;
    }
    return AxisOf(motion, axis);
  }

  // Normals of the largest plane faces, largest first; opposite ones are one.
  std::vector<Eigen::Vector3d> FaceDirections() const {
    struct Direction {
      Eigen::Vector3d normal;
      int count;
    };
    std::vector<Direction> found;
    for (std::size_t i = 0; i < area_.size(); ++i) {
      const Eigen::Vector3d& n = area_normals_[i];
      const auto known = std::find_if(found.begin(), found.end(), [&](const Direction& d) {
        return std::abs(d.normal.dot(n)) > kSameAxis;
      });
      if (known != found.end()) {
        ++known->count;
      } else {
        found.push_back({n, 1});
      }
    }
    std::stable_sort(found.begin(), found.end(), [](const Direction& a, const Direction& b) {
      return a.count > b.count;
    });
    std::vector<Eigen::Vector3d> out;
    for (const Direction& d : found) {
      if (static_cast<int>(out.size()) == kPlaneAxes || d.count < 4) break;
      out.push_back(d.normal);
    }
    return out;
  }

  std::vector<Eigen::Vector3d> PrincipalDirections() const {
    Eigen::Matrix3d moment = Eigen::Matrix3d::Zero();
    for (const SurfaceSample& s : area_) {
      moment += (s.point - center_) * (s.point - center_).transpose();
    }
    const Eigen::SelfAdjointEigenSolver<Eigen::Matrix3d> solver(moment);
    return {
        solver.eigenvectors().col(2), solver.eigenvectors().col(1), solver.eigenvectors().col(0)};
  }

 private:
  static constexpr int kVertexSamples = 1200;    // of the mesh's vertices that are tested; for time
  static constexpr double kRegionGap = 0.06;     // diameters; nearer samples are one region
  static constexpr int kPlaneAxes = 5;           // faces whose normals are tried as axes
  static constexpr double kSphereInside = 0.97;  // of the radius; sixteen facets around

  Eigen::Vector3d NormalOf(int triangle) const {
    const Eigen::Vector3i& t = mesh_.triangles[triangle];
    return (mesh_.vertices[t[1]] - mesh_.vertices[t[0]])
        .cross(mesh_.vertices[t[2]] - mesh_.vertices[t[0]])
        .normalized();
  }

  // Points evenly over the area in an order without pattern, and the vertices.
  void Draw() {
    const int vertex_count = static_cast<int>(mesh_.vertices.size());
    std::vector<double> until;
    std::vector<int> triangles;
    std::vector<char> used(mesh_.vertices.size(), 0);
    double area = 0.0;
    Eigen::Vector3d sum = Eigen::Vector3d::Zero();
    for (int t = 0; t < static_cast<int>(mesh_.triangles.size()); ++t) {
      const Eigen::Vector3i& v = mesh_.triangles[t];
      if (v.minCoeff() < 0 || v.maxCoeff() >= vertex_count) continue;
      const Eigen::Vector3d &a = mesh_.vertices[v[0]], &b = mesh_.vertices[v[1]],
                            &c = mesh_.vertices[v[2]];
      const double size = (b - a).cross(c - a).norm();
      if (!(size > 0.0)) continue;
      for (const int k : v) used[k] = 1;
      area += size;
      sum += size * (a + b + c) / 3.0;
      until.push_back(area);
      triangles.push_back(t);
    }
    if (!(area > 0.0) || !(diameter_ > 0.0)) return;
    center_ = sum / area;
    std::mt19937 random(20);
    const auto uniform = [&] { return (random() + 0.5) / 4294967296.0; };
    std::size_t at = 0;
    for (int i = 0; i < kAreaSamples; ++i) {
      const double want = (i + uniform()) / kAreaSamples * area;
      while (at + 1 < until.size() && until[at] < want) ++at;
      const Eigen::Vector3i& v = mesh_.triangles[triangles[at]];
      double r = uniform(), s = uniform();
      if (r + s > 1.0) r = 1.0 - r, s = 1.0 - s;
      area_.push_back({mesh_.vertices[v[0]] + r * (mesh_.vertices[v[1]] - mesh_.vertices[v[0]]) +
                           s * (mesh_.vertices[v[2]] - mesh_.vertices[v[0]]),
                       false});
    }
    for (std::size_t i = area_.size(); i > 1; --i) std::swap(area_[i - 1], area_[random() % i]);
    for (const SurfaceSample& s : area_)
      area_normals_.push_back(NormalOf(surface_.At(s.point).triangle));
    std::vector<int> vertices;
    for (int v = 0; v < vertex_count; ++v) {
      if (used[v]) vertices.push_back(v);
    }
    const std::size_t wanted = std::min<std::size_t>(kVertexSamples, vertices.size());
    for (std::size_t i = 0; i < wanted; ++i) {
      vertices_.push_back({mesh_.vertices[vertices[i * vertices.size() / wanted]], true});
    }
  }

  Eigen::AlignedBox3d LargestRegion(const std::vector<Eigen::Vector3d>& points) const {
    const double gap = kRegionGap * diameter_;
    std::vector<char> done(points.size(), 0);
    Eigen::AlignedBox3d best;
    std::size_t most = 0;
    for (std::size_t seed = 0; seed < points.size(); ++seed) {
      if (done[seed]) continue;
      std::vector<std::size_t> region{seed};
      done[seed] = 1;
      Eigen::AlignedBox3d box;
      for (std::size_t i = 0; i < region.size(); ++i) {
        box.extend(points[region[i]]);
        for (std::size_t k = 0; k < points.size(); ++k) {
          if (done[k] || (points[k] - points[region[i]]).norm() > gap) continue;
          done[k] = 1;
          region.push_back(k);
        }
      }
      if (region.size() <= most) continue;
      most = region.size();
      best = box;
    }
    return best;
  }

  // The axis of a motion that is nearly a turn; `like` gives its order and which way it points.
  SymmetryAxis AxisOf(const Rigid3& motion, const SymmetryAxis& like) const {
    const Eigen::AngleAxisd turn(motion.R);
    if (!(turn.angle() > 0.3)) return like;
    SymmetryAxis out = like;
    out.axis = turn.axis().dot(like.axis) < 0.0 ? Eigen::Vector3d(-turn.axis()) : turn.axis();
    const Eigen::Vector3d across = motion.t - out.axis * out.axis.dot(motion.t);
    const Eigen::Matrix3d A = Eigen::Matrix3d::Identity() - motion.R;
    const Eigen::Vector3d point = A.completeOrthogonalDecomposition().solve(across);
    // Of the axis the point nearest to the centre.
    out.point = point + out.axis * out.axis.dot(center_ - point);
    return out;
  }

  const TriangleMesh& mesh_;
  const MeshSymmetryOptions& options_;
  double diameter_;
  SurfaceDistance surface_;
  Eigen::Vector3d center_ = Eigen::Vector3d::Zero();
  std::vector<SurfaceSample> area_, vertices_;
  std::vector<Eigen::Vector3d> area_normals_;
};

}  // namespace horopter
