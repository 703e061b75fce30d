#include "server/vision/matching/plane_epipole.h"

#include <Eigen/Dense>
#include <algorithm>
#include <cmath>
#include <utility>
#include <vector>

#include "server/base/stop_scope.h"
#include "server/vision/geometry/plucker_line.h"

namespace horopter {
namespace {

constexpr int kRefinements = 3;  // fits to what the last one agrees with

size_t Draw(size_t n, std::mt19937* rng) {
  return static_cast<size_t>((*rng)()) % n;
}

// Of a point from the line through its plane image and the epipole, pixels.
double LineDistancePx(const PlaneParallax& v, const Eigen::Vector3d& e) {
  const Eigen::Vector3d l = e.cross(v.y);
  const double n = l.head<2>().norm();
  return n > 1e-12 ? kPlaneUnitPx * std::abs(l.dot(v.p)) / n : 1e9;
}

// Points off the plane all lie on the cameras' side of it.
bool LiesOnPositiveSide(const PlaneParallax& v, const Eigen::Vector3d& e) {
  return -v.p.cross(v.y).dot(v.p.cross(e)) > 0.0;
}

Eigen::Vector3d LeastSquaresEpipole(const Eigen::Matrix3d& H,
                                    std::span<const PlaneResectionSight> sights) {
  Eigen::Matrix3d A = Eigen::Matrix3d::Zero();
  Eigen::Vector3d g = Eigen::Vector3d::Zero();
  for (const PlaneResectionSight& s : sights) {
    const Eigen::Matrix3d C = CrossMatrix(s.p);
    A += s.X(3) * s.X(3) * C.transpose() * C;
    g -= s.X(3) * C.transpose() * (C * (H * s.X.head<3>()));
  }
  A.diagonal().array() += 1e-12 * A.trace() + 1e-300;
  return A.ldlt().solve(g);
}

}  // namespace

std::optional<Eigen::Vector3d> EpipoleFromParallax(std::span<const PlaneParallax> points,
                                                   const PlaneEpipoleOptions& options,
                                                   std::mt19937* rng) {
  if (points.size() < 3) return std::nullopt;
  Eigen::Vector3d best = Eigen::Vector3d::Zero();
  double best_score = 0.0;
  bool best_side = true;
  for (int h = 0; h < options.hypotheses; ++h) {
    LeaveIfStopped();
    const PlaneParallax& v = points[Draw(points.size(), rng)];
    const PlaneParallax& w = points[Draw(points.size(), rng)];
    Eigen::Vector3d e = v.y.cross(v.p).cross(w.y.cross(w.p));
    const double norm = e.norm();
    if (norm < 1e-12) continue;
    e /= norm;
    double score[2] = {0.0, 0.0};
    for (const PlaneParallax& x : points) {
      const double r = LineDistancePx(x, e) / options.inlier_px;
      if (r < 1.0) score[LiesOnPositiveSide(x, e)] += 1.0 - r * r;
    }
    if (std::max(score[0], score[1]) <= best_score) continue;
    best_score = std::max(score[0], score[1]);
    best_side = score[1] >= score[0];
    best = e;
  }
  if (best_score <= 0.0) return std::nullopt;
  return best_side ? best : Eigen::Vector3d(-best);
}

PlaneResection EpipoleFromPoints(const Eigen::Matrix3d& H,
                                 std::span<const PlaneResectionSight> sights,
                                 const PlaneEpipoleOptions& options,
                                 std::mt19937* rng) {
  ParallaxCamera trial{H};
  std::vector<PlaneResectionSight> inliers;
  const auto collect = [&](const Eigen::Vector3d& e) {
    trial.e = e;
    std::vector<PlaneResectionSight> near;
    for (const PlaneResectionSight& s : sights)
      if (ErrorPx(trial, s.X, s.p) < kOthersSlack * options.inlier_px) near.push_back(s);
    return near;
  };
  PlaneResection best;
  for (int h = 0; h < options.hypotheses; ++h) {
    LeaveIfStopped();
    const PlaneResectionSight& s = sights[Draw(sights.size(), rng)];
    const PlaneResectionSight& t = sights[Draw(sights.size(), rng)];
    const PlaneResectionSight sample[] = {s, t};
    const Eigen::Vector3d e = LeastSquaresEpipole(H, sample);
    if (!e.allFinite()) continue;
    std::vector<PlaneResectionSight> near = collect(e);
    if (near.size() <= inliers.size()) continue;
    inliers = std::move(near);
    best.e = e;
  }
  for (int round = 0; round < kRefinements && inliers.size() >= 3; ++round) {
    const Eigen::Vector3d e = LeastSquaresEpipole(H, inliers);
    std::vector<PlaneResectionSight> near = collect(e);
    if (near.size() < inliers.size()) break;
    inliers = std::move(near);
    best.e = e;
  }
  best.inliers = inliers.size();
  return best;
}

}  // namespace horopter
