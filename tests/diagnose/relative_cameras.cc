#include "tests/diagnose/relative_cameras.h"

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>

namespace horopter {
namespace {

constexpr double kDegrees = 180.0 / M_PI;
constexpr double kLeastBaseline = 0.01;  // of the distance of the scene's frame

std::optional<double> MedianOf(std::vector<double> values) {
  if (values.empty()) return std::nullopt;
  std::sort(values.begin(), values.end());
  return 0.5 * (values[(values.size() - 1) / 2] + values[values.size() / 2]);
}

std::optional<double> LargestOf(const std::vector<double>& values) {
  if (values.empty()) return std::nullopt;
  return *std::max_element(values.begin(), values.end());
}

}  // namespace

std::optional<double> CameraErrors::MedianRotation() const {
  return MedianOf(rotations_deg);
}
std::optional<double> CameraErrors::WorstRotation() const {
  return LargestOf(rotations_deg);
}
std::optional<double> CameraErrors::MedianBaseline() const {
  return MedianOf(baselines_deg);
}
std::optional<double> CameraErrors::MedianFocal() const {
  return MedianOf(focal);
}
std::optional<double> CameraErrors::WorstFocal() const {
  return LargestOf(focal);
}

CameraErrors CompareRelative(const std::vector<std::optional<EstimatedCamera>>& views,
                             const BopScene& scene) {
  CameraErrors out;
  for (size_t a = 0; a < views.size() && a < scene.images.size(); ++a) {
    if (!views[a]) continue;
    ++out.registered;
    // K is of the file's pixels, the camera's focal length of those that were used.
    const BopImage& image = scene.images[a];
    const double aspect = image.K(0, 0) > 0.0 ? image.K(1, 1) / image.K(0, 0) : 1.0;
    const double ratio = views[a]->camera.focal_px / (0.5 * (1.0 + aspect) * image.camera.focal_px);
    out.focal.push_back(std::abs(ratio - 1.0));
    if (views[a]->focal_log_sigma > 0.0)
      out.focal_in_sigmas.push_back(std::abs(std::log(ratio)) / views[a]->focal_log_sigma);
    for (size_t b = a + 1; b < views.size() && b < scene.images.size(); ++b) {
      if (!views[b] || !image.has_pose || !scene.images[b].has_pose) continue;
      const Rigid3 truth = scene.images[b].camera_from_world * image.camera_from_world.Inverse();
      const Rigid3 found = views[b]->camera_from_world * views[a]->camera_from_world.Inverse();
      out.rotations_deg.push_back(kDegrees *
                                  Eigen::AngleAxisd(found.R.transpose() * truth.R).angle());
      const Eigen::Vector3d to_b = truth.Inverse().t, found_to_b = found.Inverse().t;
      if (to_b.norm() < kLeastBaseline * image.camera_from_world.t.norm()) continue;
      out.baselines_deg.push_back(kDegrees *
                                  std::atan2(to_b.cross(found_to_b).norm(), to_b.dot(found_to_b)));
    }
  }
  return out;
}

}  // namespace horopter
