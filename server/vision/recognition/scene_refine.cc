#include "server/vision/recognition/scene_refine.h"

#include <Eigen/Cholesky>
#include <Eigen/Geometry>
#include <cmath>

#include "server/vision/recognition/pose_refine.h"

namespace horopter {
namespace {

constexpr int kCameraSize = 7;
constexpr int kObjectSize = 6;
constexpr double kDamping = 1e-3;
constexpr double kMaxTurn = 0.5;  // radians per step; more means the system is not solved but lost

struct Layout {
  std::vector<int> camera;  // first parameter of a view, -1: not registered
  std::vector<int> object;  // first parameter of an object, -1: held
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

}  // namespace

bool RefineScene(const JointContext& context,
                 const SceneRefineOptions& options,
                 SceneModel* scene) {
  if (scene->objects.empty()) return false;
  SceneModel trial = *scene;
  const Layout layout = MakeLayout(trial);
  for (int iteration = 0; iteration < options.iterations; ++iteration) {
    const double s =
        options.iterations > 1 ? static_cast<double>(iteration) / (options.iterations - 1) : 1.0;
    const double reach =
        options.start_reach_px * std::pow(options.end_reach_px / options.start_reach_px, s);
    Eigen::Vector3d pivot = Eigen::Vector3d::Zero();  // scene frame
    for (const PlacedObject& o : trial.objects) {
      pivot += o.scene_from_object * context.objects[o.object]->center /
               static_cast<double>(trial.objects.size());
    }
    NormalEquations normal{Eigen::MatrixXd::Zero(layout.size, layout.size),
                           Eigen::VectorXd::Zero(layout.size)};
    for (std::size_t v = 0; v < trial.views.size(); ++v) {
      if (!trial.views[v]) continue;
      const RecognizedView& view = *trial.views[v];
      const Eigen::Matrix3d Rt = view.camera_from_scene.R.transpose();
      const Eigen::Vector3d pivot_in_camera = view.camera_from_scene * pivot;
      for (std::size_t k = 0; k < trial.objects.size(); ++k) {
        const PreparedObject& object = *context.objects[trial.objects[k].object];
        const Rigid3& pose = trial.objects[k].scene_from_object;
        const Eigen::Vector3d center = pose * object.center;
        for (const EdgeResidual& r : AssociateEdges(object,
                                                    context.views[v].maps,
                                                    view.camera,
                                                    view.camera_from_scene * pose,
                                                    reach)) {
          const Eigen::Vector3d g = Rt * r.g;
          const Eigen::Vector3d arm = Rt * (r.point_in_camera - view.camera_from_scene.t) - center;
          Eigen::Matrix<double, 13, 1> J;
          J << (r.point_in_camera - pivot_in_camera).cross(r.g), r.g, r.d_log_focal, arm.cross(g),
              g;
          normal.Add(J, r.residual, r.weight, layout.camera[v], layout.object[k]);
        }
      }
      const double prior = 1.0 / (context.focal_log_sigma[v] * context.focal_log_sigma[v]);
      const int f = layout.camera[v] + 6;
      normal.A(f, f) += prior;
      normal.b(f) += prior * std::log(view.camera.focal_px / context.start_cameras[v].focal_px);
    }
    normal.A.diagonal() *= 1.0 + kDamping;
    normal.A.diagonal().array() += 1e-9;
    const Eigen::VectorXd step = -normal.A.ldlt().solve(normal.b);
    if (!step.allFinite()) return false;
    for (std::size_t v = 0; v < trial.views.size(); ++v) {
      if (!trial.views[v]) continue;
      const auto d = step.segment<7>(layout.camera[v]);
      if (d.head<3>().norm() > kMaxTurn || std::abs(d(6)) > 1.0) return false;
      RecognizedView& view = *trial.views[v];
      const Eigen::Vector3d pivot_in_camera = view.camera_from_scene * pivot;
      const Eigen::Matrix3d dR = RotationFromVector(d.head<3>());
      Rigid3& T = view.camera_from_scene;
      T = {dR * T.R, dR * (T.t - pivot_in_camera) + pivot_in_camera + d.segment<3>(3)};
      view.camera.focal_px *= std::exp(d(6));
    }
    for (std::size_t k = 1; k < trial.objects.size(); ++k) {
      const auto d = step.segment<6>(layout.object[k]);
      if (d.head<3>().norm() > kMaxTurn) return false;
      Rigid3& T = trial.objects[k].scene_from_object;
      const Eigen::Vector3d center = T * context.objects[trial.objects[k].object]->center;
      const Eigen::Matrix3d dR = RotationFromVector(d.head<3>());
      T = {dR * T.R, dR * (T.t - center) + center + d.tail<3>()};
    }
  }
  *scene = std::move(trial);
  return true;
}

}  // namespace horopter
