#include "server/vision/recognition/scoring/pose_refine.h"

#include <Eigen/Cholesky>
#include <Eigen/Geometry>
#include <algorithm>
#include <bit>
#include <cmath>

#include "server/vision/geometry/pose_perturbation.h"

namespace horopter {
namespace {

constexpr double kMinDepth = 1e-3;  // metres; nearer nothing is projected
constexpr int kMinAssociated = 8;   // residuals: one over a pose with its focal length
constexpr double kDamping = 1e-3;   // of the normal matrix's diagonal

double Reach(const RefineOptions& options, int iteration) {
  if (options.iterations <= 1) return options.end_reach_px;
  const double s = static_cast<double>(iteration) / (options.iterations - 1);
  return options.start_reach_px * std::pow(options.end_reach_px / options.start_reach_px, s);
}

}  // namespace

std::vector<EdgeResidual> AssociateEdges(const PreparedObject& object,
                                         const EdgeMaps& maps,
                                         const PinholeCamera& camera,
                                         const Rigid3& camera_from_object,
                                         double reach_px) {
  std::vector<EdgeResidual> out;
  const Eigen::Vector3d to_camera =
      camera_from_object.R.transpose() * -camera_from_object.t - object.center;
  const std::uint64_t* bits = object.VisibleBits(AspectIndex(to_camera.cast<float>()));
  const double scale = maps.working_from_image;
  const double focal = camera.focal_px * scale;
  const std::size_t cells = static_cast<std::size_t>(maps.width) * maps.height;
  out.reserve(object.samples.size());
  for (int w = 0; w < object.words; ++w) {
    for (std::uint64_t word = bits[w]; word != 0; word &= word - 1) {
      const EdgeSample& s = object.samples[w * 64 + std::countr_zero(word)];
      const Eigen::Vector3d p = camera_from_object * s.point.cast<double>();
      if (p.z() < kMinDepth) return {};
      const Eigen::Vector2d u = Project(camera, p) * scale;
      const int cx = static_cast<int>(std::lround(u.x()));
      const int cy = static_cast<int>(std::lround(u.y()));
      if (cx < 0 || cy < 0 || cx >= maps.width || cy >= maps.height) continue;
      const Eigen::Vector3d q = camera_from_object.R * s.tangent.cast<double>();
      Eigen::Vector2d along(q.x() * p.z() - p.x() * q.z(), q.y() * p.z() - p.y() * q.z());
      const double along_norm = along.norm();
      if (along_norm < 1e-9 * p.z()) continue;  // seen end-on
      along /= along_norm;
      const int bin = OrientationBin(static_cast<float>(along.x()), static_cast<float>(along.y()));
      const std::int32_t nearest = maps.nearest[cells * bin + maps.Cell(cx, cy)];
      if (nearest < 0) continue;
      const Eigen::Vector2d n(-along.y(), along.x());
      const Eigen::Vector2d off = u - maps.points[nearest].point.cast<double>() * scale;
      if (off.norm() > reach_px) continue;
      EdgeResidual r;
      r.point_in_camera = p;
      r.residual = n.dot(off);
      const double fz = focal / p.z();
      r.g = Eigen::Vector3d(fz * n.x(), fz * n.y(), -fz * (n.x() * p.x() + n.y() * p.y()) / p.z());
      r.d_log_focal = fz * (n.x() * p.x() + n.y() * p.y());
      const double t = r.residual / reach_px;
      r.weight = (1 - t * t) * (1 - t * t);
      out.push_back(r);
    }
  }
  return out;
}

std::optional<RefinedPose> RefineInView(const PreparedObject& object,
                                        const EdgeMaps& maps,
                                        const PinholeCamera& camera,
                                        const Rigid3& camera_from_object,
                                        const RefineOptions& options) {
  RefinedPose pose{camera, camera_from_object, 0.0, 0};
  const bool focal_free = options.focal_log_sigma > 0;
  const double prior_focal = options.focal_prior_px > 0 ? options.focal_prior_px : camera.focal_px;
  using Vector7d = Eigen::Matrix<double, 7, 1>;
  using Matrix7d = Eigen::Matrix<double, 7, 7>;
  for (int iteration = 0; iteration < options.iterations; ++iteration) {
    const std::vector<EdgeResidual> residuals = AssociateEdges(
        object, maps, pose.camera, pose.camera_from_object, Reach(options, iteration));
    if (static_cast<int>(residuals.size()) < kMinAssociated) return std::nullopt;
    const Eigen::Vector3d center = pose.camera_from_object * object.center;
    Matrix7d A = Matrix7d::Zero();
    Vector7d b = Vector7d::Zero();
    double squares = 0.0, weights = 0.0;
    for (const EdgeResidual& r : residuals) {
      Vector7d J;
      J << (r.point_in_camera - center).cross(r.g), r.g, focal_free ? r.d_log_focal : 0.0;
      A.noalias() += r.weight * J * J.transpose();
      b.noalias() += r.weight * r.residual * J;
      squares += r.weight * r.residual * r.residual;
      weights += r.weight;
    }
    pose.rms_px = std::sqrt(squares / std::max(weights, 1e-9));
    pose.associated = static_cast<int>(residuals.size());
    if (focal_free) {
      const double inverse = 1.0 / (options.focal_log_sigma * options.focal_log_sigma);
      A(6, 6) += inverse;
      b(6) += inverse * std::log(pose.camera.focal_px / prior_focal);
    } else {
      A(6, 6) += 1.0;
    }
    A.diagonal() *= 1.0 + kDamping;
    A.diagonal().array() += 1e-9;
    const Vector7d step = -A.ldlt().solve(b);
    if (!step.allFinite() || step.head<3>().norm() > 1.0 || std::abs(step(6)) > 1.0)
      return std::nullopt;
    const Eigen::Matrix3d dR = RotationFromVector(step.head<3>());
    Rigid3& T = pose.camera_from_object;
    T = {dR * T.R, dR * (T.t - center) + center + step.segment<3>(3)};
    pose.camera.focal_px *= std::exp(step(6));
    if ((T * object.center).z() < kMinDepth) return std::nullopt;
  }
  return pose;
}

std::optional<Rigid3> RefineInScene(const PreparedObject& object,
                                    std::span<const KnownView> views,
                                    const Rigid3& scene_from_object,
                                    const RefineOptions& options) {
  Rigid3 pose = scene_from_object;
  for (int iteration = 0; iteration < options.iterations; ++iteration) {
    Matrix6d A = Matrix6d::Zero();
    Vector6d b = Vector6d::Zero();
    int count = 0;
    const Eigen::Vector3d center = pose * object.center;
    for (const KnownView& view : views) {
      const Rigid3 camera_from_object = view.camera_from_scene * pose;
      const Eigen::Matrix3d Rt = view.camera_from_scene.R.transpose();
      for (const EdgeResidual& r : AssociateEdges(
               object, *view.maps, view.camera, camera_from_object, Reach(options, iteration))) {
        const Eigen::Vector3d g = Rt * r.g;
        const Eigen::Vector3d arm = Rt * (r.point_in_camera - view.camera_from_scene.t) - center;
        Vector6d J;
        J << arm.cross(g), g;
        A.noalias() += r.weight * J * J.transpose();
        b.noalias() += r.weight * r.residual * J;
        ++count;
      }
    }
    if (count < kMinAssociated) return std::nullopt;
    A.diagonal() *= 1.0 + kDamping;
    A.diagonal().array() += 1e-9;
    const Vector6d step = -A.ldlt().solve(b);
    if (!step.allFinite() || step.head<3>().norm() > 1.0) return std::nullopt;
    const Eigen::Matrix3d dR = RotationFromVector(step.head<3>());
    pose = {dR * pose.R, dR * (pose.t - center) + center + step.tail<3>()};
  }
  return pose;
}

}  // namespace horopter
