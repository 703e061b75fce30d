#include "server/vision/reconstruction/chirality.h"

#include <Eigen/Dense>
#include <algorithm>
#include <cmath>

#include "server/base/stop_scope.h"
#include "server/vision/geometry/collineation.h"

namespace horopter {
namespace {

constexpr int kMajorityRounds = 20;  // of votes of points and views at most
constexpr int kGilbertSteps = 3000;  // towards the nearest point of the hull; for time
constexpr int kStepsPerLook = 16;    // at the stop flag: a millisecond with a thousand points

struct Signs {
  std::vector<int> camera, point;  // +-1; 0 unknown
};

// s_i t_j (P_i X_j)_3 > 0 for as many observations as possible: votes, back and forth.
Signs PropagateSigns(const MultiviewTracks& tracks, const ProjectiveScene& scene) {
  Signs signs;
  signs.camera.assign(scene.cameras.size(), 0);
  signs.point.assign(scene.points.size(), 0);
  for (size_t v = 0; v < scene.cameras.size(); ++v) {
    if (scene.cameras[v]) {
      signs.camera[v] = 1;  // a start; one camera's sign is free
      break;
    }
  }
  for (int round = 0; round < kMajorityRounds; ++round) {
    std::vector<int> votes(scene.points.size(), 0);
    const auto depth_sign = [&](const PointObservation& o) {
      return scene.cameras[o.view]->row(2).dot(*scene.points[o.point]) < 0.0 ? -1 : 1;
    };
    const auto usable = [&](size_t k) {
      const PointObservation& o = tracks.point_observations[k];
      return scene.point_inlier[k] && scene.cameras[o.view] && scene.points[o.point];
    };
    for (size_t k = 0; k < tracks.point_observations.size(); ++k) {
      if (!usable(k)) continue;
      const PointObservation& o = tracks.point_observations[k];
      votes[o.point] += signs.camera[o.view] * depth_sign(o);
    }
    std::vector<int> camera_votes(scene.cameras.size(), 0);
    for (size_t j = 0; j < votes.size(); ++j) {
      if (votes[j] != 0) signs.point[j] = votes[j] > 0 ? 1 : -1;
    }
    for (size_t k = 0; k < tracks.point_observations.size(); ++k) {
      if (!usable(k)) continue;
      const PointObservation& o = tracks.point_observations[k];
      camera_votes[o.view] += signs.point[o.point] * depth_sign(o);
    }
    bool changed = false;
    for (size_t v = 0; v < camera_votes.size(); ++v) {
      const int sign = camera_votes[v] > 0 ? 1 : camera_votes[v] < 0 ? -1 : signs.camera[v];
      changed = changed || sign != signs.camera[v];
      signs.camera[v] = sign;
    }
    if (!changed) break;
  }
  return signs;
}

// Point of the hull nearest to the origin (Gilbert); its direction separates with largest slack.
std::optional<Eigen::Vector4d> Separate(const std::vector<Eigen::Vector4d>& a, double* margin) {
  Eigen::Vector4d w = Eigen::Vector4d::Zero();
  for (const Eigen::Vector4d& x : a) w += x / static_cast<double>(a.size());
  *margin = -1.0;
  std::optional<Eigen::Vector4d> best;
  StopPacer pacer(kStepsPerLook);
  for (int step = 0; step < kGilbertSteps; ++step) {
    pacer.Step();
    const double norm = w.norm();
    if (!(norm > 1e-12)) break;
    const auto worst = std::min_element(
        a.begin(), a.end(), [&](const auto& x, const auto& y) { return x.dot(w) < y.dot(w); });
    const double slack = worst->dot(w) / norm;
    if (slack > *margin) {
      *margin = slack;
      best = w / norm;
    }
    if (norm - slack < 1e-3 * norm) break;  // the bound of the optimum is reached
    const Eigen::Vector4d d = *worst - w;
    w += std::clamp(-w.dot(d) / d.squaredNorm(), 0.0, 1.0) * d;
  }
  return *margin > 0.0 ? best : std::nullopt;
}

struct Separation {
  Eigen::Vector4d v;
  double margin = -1.0;
  int delta = 1;
};

std::optional<Separation> SeparateAll(const std::vector<Eigen::Vector4d>& points,
                                      const std::vector<Eigen::Vector4d>& centers,
                                      int without) {
  std::optional<Separation> best;
  for (const int delta : {1, -1}) {
    std::vector<Eigen::Vector4d> all = points;
    for (size_t i = 0; i < centers.size(); ++i) {
      if (static_cast<int>(i) != without) all.push_back(delta * centers[i]);
    }
    double margin = 0.0;
    const auto v = Separate(all, &margin);
    if (v && (!best || margin > best->margin)) best = Separation{*v, margin, delta};
  }
  return best;
}

// Orthonormal rows, the last v, determinant of sign delta.
Eigen::Matrix4d CompleteFrame(const Eigen::Vector4d& v, int delta) {
  const Eigen::HouseholderQR<Eigen::Vector4d> qr(v);
  const Eigen::Matrix4d Q = qr.householderQ();
  Eigen::Matrix4d H;
  H.topRows<3>() = Q.rightCols<3>().transpose();
  H.row(3) = v.transpose();
  if (H.determinant() * delta < 0.0) H.row(0) *= -1.0;
  return H;
}

}  // namespace

std::optional<QuasiAffineFrame> FindQuasiAffineFrame(const MultiviewTracks& tracks,
                                                     const ProjectiveScene& scene) {
  const Signs signs = PropagateSigns(tracks, scene);
  QuasiAffineFrame frame;
  frame.camera_consistent.assign(scene.cameras.size(), false);
  frame.point_consistent.assign(scene.points.size(), false);
  std::vector<Eigen::Vector4d> points, centers;
  std::vector<int> views;
  for (size_t j = 0; j < scene.points.size(); ++j) {
    if (!scene.points[j] || signs.point[j] == 0) continue;
    points.push_back(signs.point[j] * scene.points[j]->normalized());
    frame.point_consistent[j] = true;
  }
  for (size_t k = 0; k < tracks.point_observations.size(); ++k) {
    const PointObservation& o = tracks.point_observations[k];
    if (!scene.point_inlier[k] || !scene.cameras[o.view] || !scene.points[o.point]) continue;
    const double depth = scene.cameras[o.view]->row(2).dot(*scene.points[o.point]);
    if (signs.camera[o.view] * signs.point[o.point] * depth <= 0.0) {
      frame.point_consistent[o.point] = false;
    }
  }
  for (size_t v = 0; v < scene.cameras.size(); ++v) {
    if (!scene.cameras[v] || signs.camera[v] == 0) continue;
    // A centre goes with the cube of the camera's sign.
    centers.push_back(signs.camera[v] * CameraCenter(*scene.cameras[v]).normalized());
    views.push_back(static_cast<int>(v));
  }
  if (points.empty() || views.size() < 2) return std::nullopt;

  std::optional<Separation> found = SeparateAll(points, centers, -1);
  while (!found && views.size() > 2) {
    int drop = -1;
    for (size_t i = 0; i < centers.size(); ++i) {
      const auto without = SeparateAll(points, centers, static_cast<int>(i));
      if (without && (!found || without->margin > found->margin)) {
        found = without;
        drop = static_cast<int>(i);
      }
    }
    // Several contradict: leave out one after the other, those that contradict the most first.
    if (drop < 0) {
      const auto by_points = SeparateAll(points, {}, -1);
      if (!by_points) return std::nullopt;
      int positive = 0;
      for (const Eigen::Vector4d& C : centers) positive += C.dot(by_points->v) > 0.0;
      const bool majority = 2 * positive >= static_cast<int>(centers.size());
      const auto odd = std::find_if(centers.begin(), centers.end(), [&](const auto& C) {
        return (C.dot(by_points->v) > 0.0) != majority;
      });
      if (odd == centers.end()) return std::nullopt;
      drop = static_cast<int>(odd - centers.begin());
    }
    centers.erase(centers.begin() + drop);
    views.erase(views.begin() + drop);
  }
  if (!found) return std::nullopt;
  for (const int v : views) frame.camera_consistent[v] = true;
  frame.margin = found->margin;
  frame.H = CompleteFrame(found->v, found->delta);
  return frame;
}

ProjectiveScene MapScene(const Eigen::Matrix4d& H, const ProjectiveScene& scene) {
  ProjectiveScene out = scene;
  const Eigen::Matrix4d inverse = H.inverse();
  for (auto& P : out.cameras) {
    if (!P) continue;
    const CameraMatrix moved = *P * inverse;
    P = moved / moved.norm();
  }
  for (auto& X : out.points) {
    if (X) X = MapPoint(H, *X).normalized();
  }
  for (auto& L : out.lines) {
    if (L) L = MapLine(H, *L).normalized();
  }
  return out;
}

}  // namespace horopter
