#include "server/vision/recognition/scene/scene_refine.h"

#include <Eigen/Cholesky>
#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <optional>

#include "server/vision/geometry/plucker_line.h"
#include "server/vision/geometry/pose_perturbation.h"
#include "server/vision/recognition/scene/plane_points.h"
#include "server/vision/recognition/scoring/pose_refine.h"

namespace horopter {
namespace {

constexpr int kCameraSize = 7;     // pose and log f
constexpr int kObjectSize = 6;     // pose
constexpr double kDamping = 1e-3;  // relative, of the normal equations
constexpr double kMaxTurn = 0.5;   // radians per step; more means the system is not solved but lost

struct Layout {
  std::vector<int> camera;  // first parameter of a view, -1: not registered
  std::vector<int> object;  // first parameter of an object, -1: fixed
  int size = 0;
};

Layout MakeLayout(const SceneModel& scene) {
  Layout layout;
  for (const auto& view : scene.views) {
    layout.camera.push_back(view ? layout.size : -1);
    if (view) layout.size += kCameraSize;
  }
  for (std::size_t k = 0; k < scene.objects.size(); ++k) {
    layout.object.push_back(k == 0 ? -1 : layout.size);
    if (k > 0) layout.size += kObjectSize;
  }
  return layout;
}

struct NormalEquations {
  Eigen::MatrixXd A;
  Eigen::VectorXd b;

  void Add(const Eigen::Matrix<double, 13, 1>& J, double r, double w, int camera, int object) {
    const Eigen::Matrix<double, 7, 1> jc = J.head<7>();
    A.block<7, 7>(camera, camera).noalias() += w * jc * jc.transpose();
    b.segment<7>(camera) += w * r * jc;
    if (object < 0) return;
    const Eigen::Matrix<double, 6, 1> jo = J.tail<6>();
    A.block<6, 6>(object, object).noalias() += w * jo * jo.transpose();
    const Eigen::Matrix<double, 7, 6> cross = w * jc * jo.transpose();
    A.block<7, 6>(camera, object) += cross;
    A.block<6, 7>(object, camera) += cross.transpose();
    b.segment<6>(object) += w * r * jo;
  }
};

using CameraStep = Eigen::Matrix<double, kCameraSize, 1>;

// The camera turned about the pivot (scene frame), moved, and its focal length scaled.
CalibratedCamera Stepped(const CalibratedCamera& view,
                         const Eigen::Vector3d& pivot,
                         const CameraStep& d) {
  CalibratedCamera out = view;
  const Eigen::Vector3d pivot_in_camera = view.camera_from_scene * pivot;
  const Eigen::Matrix3d dR = RotationFromVector(d.head<3>());
  const Rigid3& T = view.camera_from_scene;
  out.camera_from_scene = {dR * T.R,
                           dR * (T.t - pivot_in_camera) + pivot_in_camera + d.segment<3>(3)};
  out.camera.focal_px *= std::exp(d(6));
  return out;
}

// Misfit of plane matches: where view b sees the point of the plane that view a sees, minus where
// it was matched.
class PlaneTerms {
 public:
  PlaneTerms(const PlanePoints& points, int most, double weight)
      : points_(points), weight_(weight) {
    step_ = std::max<std::size_t>(1, points.matches.size() / std::max(1, most));
  }

  bool empty() const { return points_.matches.empty(); }

  // at: first parameter of the plane.
  void Add(const SceneModel& scene,
           const Layout& layout,
           int at,
           const Eigen::Vector3d& pivot,
           NormalEquations* normal) const {
    for (std::size_t i = 0; i < points_.matches.size(); i += step_) {
      const PlanePoints::Match& m = points_.matches[i];
      if (!scene.views[m.view_a] || !scene.views[m.view_b]) continue;
      const CalibratedCamera &a = *scene.views[m.view_a], &b = *scene.views[m.view_b];
      const auto e = PlaneTransferError(a, b, points_, m);
      if (!e) continue;
      const Eigen::Matrix<double, 2, 17> J = Derivatives(a, b, m, pivot);
      if (!J.allFinite()) continue;
      const double w = weight_ / (1.0 + e->squaredNorm() / (kCauchyPx * kCauchyPx));
      const int starts[3] = {layout.camera[m.view_a], layout.camera[m.view_b], at};
      const int columns[3] = {0, 7, 14}, sizes[3] = {7, 7, 3};
      for (int p = 0; p < 3; ++p) {
        const auto Jp = J.middleCols(columns[p], sizes[p]);
        normal->b.segment(starts[p], sizes[p]) += w * Jp.transpose() * *e;
        for (int q = 0; q < 3; ++q) {
          normal->A.block(starts[p], starts[q], sizes[p], sizes[q]) +=
              w * Jp.transpose() * J.middleCols(columns[q], sizes[q]);
        }
      }
    }
  }

  void Move(const Eigen::Vector3d& step) { points_.plane += step; }

 private:
  // Of the misfit after the steps of camera a and b (Stepped: turn, shift, log focal length) and of
  // the plane. With C the centre of a and r = R_a^T q the ray of its pixel, the plane's point is
  // P = C + s r, s = (-1 - n.(C - anchor)) / (n.r). k1 is taken as zero in the derivatives.
  Eigen::Matrix<double, 2, 17> Derivatives(const CalibratedCamera& a,
                                           const CalibratedCamera& b,
                                           const PlanePoints::Match& m,
                                           const Eigen::Vector3d& pivot) const {
    const Eigen::Vector3d& n = points_.plane;
    const Eigen::Matrix3d Rt = a.camera_from_scene.R.transpose();
    const Eigen::Vector3d C = -(Rt * a.camera_from_scene.t);
    const Eigen::Vector3d q = NormalizedPoint(a.camera, m.pixel_a).homogeneous();
    const Eigen::Vector3d r = Rt * q;
    const double nr = n.dot(r), s = (-1.0 - n.dot(C - points_.anchor)) / nr;
    const Eigen::Vector3d P = C + s * r;
    const Eigen::Vector3d p = b.camera_from_scene * P;
    const double fz = b.camera.focal_px / p.z();
    Eigen::Matrix<double, 2, 3> by_p;  // of the pixel in b by the point in its frame
    by_p << fz, 0, -fz * p.x() / p.z(), 0, fz, -fz * p.y() / p.z();
    // A move dC of the centre and dr of the ray shift the point by (I - r n^T / (n.r)) (dC + s dr).
    const Eigen::Matrix<double, 2, 3> by_move =
        by_p * b.camera_from_scene.R * (Eigen::Matrix3d::Identity() - r * n.transpose() / nr);
    const Eigen::Vector3d pivot_in_a = a.camera_from_scene * pivot;
    const Eigen::Vector3d arm_in_b = p - b.camera_from_scene * pivot;
    Eigen::Matrix<double, 2, 17> J;
    J.middleCols<3>(0) = by_move * Rt * CrossMatrix(s * q - pivot_in_a);
    J.middleCols<3>(3) = -by_move * Rt;
    J.col(6) = by_move * (Rt * Eigen::Vector3d(-s * q.x(), -s * q.y(), 0.0));
    J.middleCols<3>(7) = -by_p * CrossMatrix(arm_in_b);
    J.middleCols<3>(10) = by_p;
    J.col(13) = fz * p.head<2>();
    J.middleCols<3>(14) =
        by_p * b.camera_from_scene.R * r * (-(P - points_.anchor) / nr).transpose();
    return J;
  }

  static constexpr double kCauchyPx = 1.0;  // of the robust loss, image px
  PlanePoints points_;
  double weight_;
  std::size_t step_;
};

double ReachAt(const SceneRefineOptions& options, int iteration) {
  const double s =
      options.iterations > 1 ? static_cast<double>(iteration) / (options.iterations - 1) : 1.0;
  return options.start_reach_px * std::pow(options.end_reach_px / options.start_reach_px, s);
}

// What the edges that a view sees of all objects, and its focal length, say of the step.
void AddView(const JointContext& context,
             const SceneModel& scene,
             std::size_t v,
             const Layout& layout,
             const Eigen::Vector3d& pivot,
             double reach,
             NormalEquations* normal) {
  const CalibratedCamera& view = *scene.views[v];
  const Eigen::Matrix3d Rt = view.camera_from_scene.R.transpose();
  const Eigen::Vector3d pivot_in_camera = view.camera_from_scene * pivot;
  for (std::size_t k = 0; k < scene.objects.size(); ++k) {
    const PreparedObject& object = *context.objects[scene.objects[k].object];
    const Rigid3& pose = scene.objects[k].scene_from_object;
    const Eigen::Vector3d center = pose * object.center;
    for (const EdgeResidual& r : AssociateEdges(
             object, context.views[v].maps, view.camera, view.camera_from_scene * pose, reach)) {
      const Eigen::Vector3d g = Rt * r.g;
      const Eigen::Vector3d arm = Rt * (r.point_in_camera - view.camera_from_scene.t) - center;
      Eigen::Matrix<double, 13, 1> J;
      J << (r.point_in_camera - pivot_in_camera).cross(r.g), r.g, r.d_log_focal, arm.cross(g), g;
      normal->Add(J, r.residual, r.weight, layout.camera[v], layout.object[k]);
    }
  }
  const double prior = 1.0 / (context.focal_log_sigma[v] * context.focal_log_sigma[v]);
  const int f = layout.camera[v] + 6;
  normal->A(f, f) += prior;
  normal->b(f) += prior * std::log(view.camera.focal_px / context.start_cameras[v].focal_px);
}

// False where the step turns or zooms too far: the scene is lost.
bool MoveScene(const JointContext& context,
               const Layout& layout,
               const Eigen::Vector3d& pivot,
               const Eigen::VectorXd& step,
               SceneModel* scene) {
  for (std::size_t v = 0; v < scene->views.size(); ++v) {
    if (!scene->views[v]) continue;
    const auto d = step.segment<7>(layout.camera[v]);
    if (d.head<3>().norm() > kMaxTurn || std::abs(d(6)) > 1.0) return false;
    scene->views[v] = Stepped(*scene->views[v], pivot, d);
  }
  for (std::size_t k = 1; k < scene->objects.size(); ++k) {
    const auto d = step.segment<6>(layout.object[k]);
    if (d.head<3>().norm() > kMaxTurn) return false;
    Rigid3& T = scene->objects[k].scene_from_object;
    const Eigen::Vector3d center = T * context.objects[scene->objects[k].object]->center;
    const Eigen::Matrix3d dR = RotationFromVector(d.head<3>());
    T = {dR * T.R, dR * (T.t - center) + center + d.tail<3>()};
  }
  return true;
}

}  // namespace

bool RefineScene(const JointContext& context,
                 const SceneRefineOptions& options,
                 SceneModel* scene) {
  if (scene->objects.empty()) return false;
  SceneModel trial = *scene;
  Layout layout = MakeLayout(trial);
  PlaneTerms plane(
      FindPlanePoints(*context.matching, trial.views), options.plane_matches, options.plane_weight);
  const int plane_at = layout.size;
  if (!plane.empty()) layout.size += 3;
  for (int iteration = 0; iteration < options.iterations; ++iteration) {
    const double reach = ReachAt(options, iteration);
    Eigen::Vector3d pivot = Eigen::Vector3d::Zero();  // scene frame
    for (const PlacedObject& o : trial.objects) {
      pivot += o.scene_from_object * context.objects[o.object]->center /
               static_cast<double>(trial.objects.size());
    }
    NormalEquations normal{Eigen::MatrixXd::Zero(layout.size, layout.size),
                           Eigen::VectorXd::Zero(layout.size)};
    for (std::size_t v = 0; v < trial.views.size(); ++v) {
      if (trial.views[v]) AddView(context, trial, v, layout, pivot, reach, &normal);
    }
    if (!plane.empty()) plane.Add(trial, layout, plane_at, pivot, &normal);
    normal.A.diagonal() *= 1.0 + kDamping;
    normal.A.diagonal().array() += 1e-9;
    const Eigen::VectorXd step = -normal.A.ldlt().solve(normal.b);
    if (!step.allFinite()) return false;
    if (!MoveScene(context, layout, pivot, step, &trial)) return false;
    if (!plane.empty()) plane.Move(step.segment<3>(plane_at));
  }
  *scene = std::move(trial);
  return true;
}

bool RefineScene(const JointContext& context, SceneModel* scene) {
  return RefineScene(context, context.options.search.scene_refine, scene);
}

}  // namespace horopter
