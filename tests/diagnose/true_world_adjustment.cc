#include "tests/diagnose/true_world_adjustment.h"

#include <ceres/ceres.h>
#include <ceres/rotation.h>

#include <Eigen/Geometry>
#include <algorithm>
#include <array>
#include <cmath>

namespace horopter {
namespace {

using Corners = std::array<Eigen::Vector3d, 8>;
using Pose = std::array<double, 6>;  // rotation vector, translation [m]

constexpr double kLossPx = 3.0;     // of one part in one image: about what annotations err by
constexpr double kAgreesPx = 10.0;  // what is further off is not noise

Pose ToPose(const Rigid3& rigid) {
  const Eigen::AngleAxisd turn(rigid.R);
  const Eigen::Vector3d w = turn.angle() * turn.axis();
  return {w.x(), w.y(), w.z(), rigid.t.x(), rigid.t.y(), rigid.t.z()};
}

Rigid3 FromPose(const Pose& pose) {
  const Eigen::Vector3d w(pose[0], pose[1], pose[2]);
  Rigid3 rigid;
  if (w.norm() > 0.0) rigid.R = Eigen::AngleAxisd(w.norm(), w.normalized()).toRotationMatrix();
  rigid.t = {pose[3], pose[4], pose[5]};
  return rigid;
}

Corners BoxCorners(const ObjectModel& model) {
  Eigen::AlignedBox3d box;
  for (const Eigen::Vector3d& v : model.mesh.vertices) box.extend(v);
  Corners corners;
  for (int k = 0; k < 8; ++k) {
    corners[k] = box.corner(static_cast<Eigen::AlignedBox3d::CornerType>(k));
  }
  return corners;
}

// Mean distance of the corners in the image, pixels; far behind the camera: large.
double CornerDistance(const BopImage& image,
                      const Corners& corners,
                      const Rigid3& a,
                      const Rigid3& b) {
  double sum = 0.0;
  for (const Eigen::Vector3d& x : corners) {
    const Eigen::Vector3d in_a = a * x, in_b = b * x;
    if (in_a.z() <= 1e-3 || in_b.z() <= 1e-3) return 1e6;
    sum += (Project(image.camera, in_a) - Project(image.camera, in_b)).norm();
  }
  return sum / static_cast<double>(corners.size());
}

// The annotated pose, or that times the symmetry that is nearest to where the part is.
Rigid3 NearestSymmetric(const BopImage& image,
                        const ObjectModel& model,
                        const Corners& corners,
                        const Rigid3& annotated,
                        const Rigid3& expected) {
  Rigid3 best = annotated;
  double least = CornerDistance(image, corners, annotated, expected);
  for (const Rigid3& symmetry : model.symmetries) {
    const Rigid3 other = annotated * symmetry;
    const double distance = CornerDistance(image, corners, other, expected);
    if (distance >= least) continue;
    least = distance;
    best = other;
  }
  return best;
}

// Differences of the corners' pixels, 16 numbers.
struct CornerError {
  double focal_px;
  Corners corners;
  Corners seen;  // in the camera, as annotated

  template <typename T>
  bool operator()(const T* camera, const T* part, T* residual) const {
    for (int k = 0; k < 8; ++k) {
      const T x[3] = {T(corners[k].x()), T(corners[k].y()), T(corners[k].z())};
      T in_world[3], in_camera[3];
      ceres::AngleAxisRotatePoint(part, x, in_world);
      for (int i = 0; i < 3; ++i) in_world[i] += part[3 + i];
      ceres::AngleAxisRotatePoint(camera, in_world, in_camera);
      for (int i = 0; i < 3; ++i) in_camera[i] += camera[3 + i];
      if (in_camera[2] < T(1e-3)) return false;
      residual[2 * k] = T(focal_px) * (in_camera[0] / in_camera[2] - T(seen[k].x() / seen[k].z()));
      residual[2 * k + 1] =
          T(focal_px) * (in_camera[1] / in_camera[2] - T(seen[k].y() / seen[k].z()));
    }
    return true;
  }
};

// Fills median_px.
WorldAgreement Measure(const std::vector<BopImage>& images, std::vector<AnnotatedPart>* parts) {
  WorldAgreement out;
  double squares = 0.0;
  int count = 0;
  for (AnnotatedPart& part : *parts) {
    const Corners corners = BoxCorners(*part.model);
    std::vector<double> off;
    for (size_t v = 0; v < images.size(); ++v) {
      if (!part.camera_from_object[v]) continue;
      const Rigid3 here = images[v].camera_from_world * part.world_from_object;
      const Rigid3 seen =
          NearestSymmetric(images[v], *part.model, corners, *part.camera_from_object[v], here);
      off.push_back(CornerDistance(images[v], corners, seen, here));
      out.cost += std::min(off.back(), kAgreesPx);
      if (off.back() > kAgreesPx) continue;
      squares += off.back() * off.back();
      ++count;
    }
    if (off.empty()) continue;
    std::nth_element(off.begin(), off.begin() + static_cast<long>(off.size() / 2), off.end());
    part.median_px = off[off.size() / 2];
  }
  if (count > 0) out.rms_px = std::sqrt(squares / count);
  return out;
}

}  // namespace

WorldAgreement AdjustTrueWorld(const std::vector<bool>& given,
                               std::vector<BopImage>* images,
                               std::vector<AnnotatedPart>* parts) {
  std::vector<Pose> cameras, placed;
  for (const BopImage& image : *images) cameras.push_back(ToPose(image.camera_from_world));
  for (const AnnotatedPart& part : *parts) placed.push_back(ToPose(part.world_from_object));
  ceres::Problem problem;
  for (size_t k = 0; k < parts->size(); ++k) {
    const AnnotatedPart& part = (*parts)[k];
    const Corners corners = BoxCorners(*part.model);
    for (size_t v = 0; v < images->size(); ++v) {
      const BopImage& image = (*images)[v];
      if (!part.camera_from_object[v]) continue;
      const Rigid3 seen = NearestSymmetric(image,
                                           *part.model,
                                           corners,
                                           *part.camera_from_object[v],
                                           image.camera_from_world * part.world_from_object);
      auto* error = new CornerError{image.camera.focal_px, corners, corners};
      bool in_front = true;
      for (Eigen::Vector3d& x : error->seen) {
        x = seen * x;
        in_front &= x.z() > 1e-3;
      }
      auto* cost = new ceres::AutoDiffCostFunction<CornerError, 16, 6, 6>(error);
      if (!in_front) {
        delete cost;
        continue;
      }
      problem.AddResidualBlock(
          cost, new ceres::CauchyLoss(kLossPx * 4.0), cameras[v].data(), placed[k].data());
    }
  }
  const bool any_given = std::find(given.begin(), given.end(), true) != given.end();
  bool held = any_given;
  for (size_t v = 0; v < images->size(); ++v) {
    if (!problem.HasParameterBlock(cameras[v].data())) continue;
    if (given[v] || !held) problem.SetParameterBlockConstant(cameras[v].data());
    held = true;
  }
  ceres::Solver::Options options;
  options.max_num_iterations = 50;
  options.logging_type = ceres::SILENT;
  ceres::Solver::Summary summary;
  ceres::Solve(options, &problem, &summary);
  if (summary.IsSolutionUsable()) {
    for (size_t v = 0; v < images->size(); ++v) {
      if ((*images)[v].has_pose && !given[v]) (*images)[v].camera_from_world = FromPose(cameras[v]);
    }
    for (size_t k = 0; k < parts->size(); ++k) (*parts)[k].world_from_object = FromPose(placed[k]);
  }
  return Measure(*images, parts);
}

}  // namespace horopter
