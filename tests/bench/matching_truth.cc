#include "tests/bench/matching_truth.h"

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <vector>

#include "server/vision/matching/homography.h"
#include "server/vision/reconstruction/bundle_adjustment.h"

namespace horopter {
namespace {

Eigen::Vector2d ProjectWorld(const BopImage& view, const Eigen::Vector3d& point_in_world) {
  return Project(view.camera, view.camera_from_world * point_in_world);
}

bool InImage(const BopImage& view, const Eigen::Vector3d& point_in_camera) {
  if (point_in_camera.z() <= 0.0) return false;
  const Eigen::Vector2d p = Project(view.camera, point_in_camera);
  return p.x() >= 0 && p.y() >= 0 && p.x() <= view.camera.width - 1 &&
         p.y() <= view.camera.height - 1;
}

double LineDistance(const Eigen::Vector3d& line, const Eigen::Vector2d& x) {
  return std::abs(line.dot(x.homogeneous())) / line.head<2>().norm();
}

// Larger distance (px) of the two points of a match from their epipolar lines.
double EpipolarDistance(const Eigen::Matrix3d& F,
                        const Eigen::Vector2d& a,
                        const Eigen::Vector2d& b) {
  const double in_b = LineDistance(F * a.homogeneous(), b);
  const double in_a = LineDistance(F.transpose() * b.homogeneous(), a);
  return std::max(in_a, in_b);
}

}  // namespace

std::pair<double, double> PlaneError(const BopImage& a,
                                     const BopImage& b,
                                     const Eigen::Matrix3d& b_from_a) {
  std::vector<double> errors;
  for (int x = -10; x <= 10; ++x) {
    for (int y = -10; y <= 10; ++y) {
      const Eigen::Vector3d p(0.02 * x, 0.02 * y, 0);
      if (!InImage(a, a.camera_from_world * p) || !InImage(b, b.camera_from_world * p)) continue;
      const double e = (Transfer(b_from_a, ProjectWorld(a, p)) - ProjectWorld(b, p)).norm();
      errors.push_back(std::isfinite(e) ? e : 1e9);
    }
  }
  if (errors.empty()) return {-1, -1};
  std::sort(errors.begin(), errors.end());
  return {errors[errors.size() / 2], errors[errors.size() * 9 / 10]};
}

std::pair<double, double> FundamentalQuality(const TrueModels& models,
                                             const BopImage& a,
                                             const BopImage& b,
                                             const Eigen::Matrix3d& F) {
  std::vector<double> distances;
  for (size_t k = 0; k < std::min(a.instances.size(), b.instances.size()); ++k) {
    if (a.instances[k].visib_fract < 0.1 || b.instances[k].visib_fract < 0.1) continue;
    const auto model = models.find(a.instances[k].obj_id);
    if (model == models.end()) continue;
    for (const Eigen::Vector3d& v : model->second.vertices) {
      const Eigen::Vector3d in_a = a.instances[k].camera_from_object * v;
      const Eigen::Vector3d in_b = b.instances[k].camera_from_object * v;
      if (!InImage(a, in_a) || !InImage(b, in_b)) continue;
      distances.push_back(EpipolarDistance(F, Project(a.camera, in_a), Project(b.camera, in_b)));
    }
  }
  if (distances.empty()) return {0, -1};
  std::sort(distances.begin(), distances.end());
  const auto within = std::lower_bound(distances.begin(), distances.end(), 2.0) - distances.begin();
  return {static_cast<double>(within) / static_cast<double>(distances.size()),
          distances[distances.size() * 95 / 100]};
}

double VertexReprojection(const TrueModels& models,
                          const BopScene& scene,
                          const Reconstruction& reconstruction) {
  Bundle bundle;
  std::vector<int> views;
  for (size_t v = 0; v < reconstruction.views.size(); ++v) {
    if (!reconstruction.views[v]) continue;
    const CalibratedView& r = *reconstruction.views[v];
    BundleView view;
    view.size = {r.camera.width, r.camera.height};
    view.focal_px = r.camera.focal_px;
    view.k1 = r.camera.k1;
    view.camera_from_world = r.camera_from_scene;
    view.prior.principal_point_px = Eigen::Vector2d(r.camera.cx, r.camera.cy);
    bundle.views.push_back(view);
    views.push_back(static_cast<int>(v));
  }
  std::vector<double> errors;
  const size_t instances = scene.images.front().instances.size();
  for (size_t k = 0; k < instances; ++k) {
    const auto model = models.find(scene.images.front().instances[k].obj_id);
    if (model == models.end()) continue;
    for (const Eigen::Vector3d& vertex : model->second.vertices) {
      Track track;
      for (size_t i = 0; i < views.size(); ++i) {
        const BopImage& image = scene.images[views[i]];
        const Eigen::Vector3d c = image.instances[k].camera_from_object * vertex;
        if (InImage(image, c))
          track.observations.push_back({static_cast<int>(i), -1, Project(image.camera, c)});
      }
      if (track.observations.size() < 2) continue;
      const auto x = Triangulate(bundle, track, 0.0);
      errors.push_back(x ? WorstReprojection(bundle, {track, *x, false}) : 1e9);
    }
  }
  if (errors.empty()) return -1.0;
  std::sort(errors.begin(), errors.end());
  return errors[errors.size() * 95 / 100];
}

}  // namespace horopter
