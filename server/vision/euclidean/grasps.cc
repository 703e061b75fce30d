#include "server/vision/euclidean/grasps.h"

#include <Eigen/Eigenvalues>
#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>

#include "server/vision/geometry/grasp_kind.h"

namespace horopter {
namespace {

// A finger or a cup on its whole way from the pre-grasp: a box in the scene frame.
struct SweptBox {
  Eigen::Vector3d center;
  Eigen::Matrix3d R;
  Eigen::Vector3d half;
};

std::vector<SweptBox> SweptFingers(const SceneGrasp& grasp,
                                   const GripperShape& gripper,
                                   const GraspOptions& options,
                                   double margin_m) {
  std::vector<SweptBox> out;
  const double length = gripper.finger_length_m + options.approach_m;
  for (const double side : {-1.0, 1.0}) {
    const double x = side * 0.5 * (grasp.jaw_opening_m + gripper.finger_thickness_m);
    out.push_back({grasp.scene_from_gripper * Eigen::Vector3d(x, 0.0, -0.5 * length),
                   grasp.scene_from_gripper.R,
                   Eigen::Vector3d(0.5 * gripper.finger_thickness_m + margin_m,
                                   0.5 * gripper.finger_width_m + margin_m,
                                   0.5 * length + margin_m)});
  }
  return out;
}

// The rim ends at the part: no margin ahead of it.
std::vector<SweptBox> SweptCup(const SceneGrasp& grasp,
                               const SuctionShape& suction,
                               const GraspOptions& options,
                               double margin_m) {
  const double length = suction.length_m + options.approach_m + margin_m;
  const double half = std::max(grasp.cup_radius_m, suction.holder_radius_m) + margin_m;
  return {{grasp.scene_from_gripper * Eigen::Vector3d(0.0, 0.0, -0.5 * length),
           grasp.scene_from_gripper.R,
           Eigen::Vector3d(half, half, 0.5 * length)}};
}

double LowestOfFinger(const SweptBox& f, const Eigen::Vector3d& normal) {
  return normal.dot(f.center) - (f.R.transpose() * normal).cwiseAbs().dot(f.half);
}

bool MeetsMesh(const SweptBox& f, const GraspScene::Object& object) {
  const Rigid3 object_from_scene = object.scene_from_object.Inverse();
  const Eigen::Vector3d center = object_from_scene * f.center;
  const Eigen::Matrix3d R = object_from_scene.R * f.R;
  const TriangleMesh& mesh = object.model->mesh;
  const double reach = f.half.norm();
  for (const Eigen::Vector3i& t : mesh.triangles) {
    const Eigen::Vector3d &a = mesh.vertices[t(0)], &b = mesh.vertices[t(1)],
                          &c = mesh.vertices[t(2)];
    const Eigen::Vector3d low = a.cwiseMin(b).cwiseMin(c), high = a.cwiseMax(b).cwiseMax(c);
    if (((low - center).array() > reach).any() || ((center - high).array() > reach).any()) continue;
    if (BoxMeetsTriangle(center, R, f.half, a, b, c)) return true;
  }
  return false;
}

// P(|error| < limit) of a centred normal error.
double Within(double limit, double sigma) {
  if (limit <= 0.0) return 0.0;
  return sigma < 1e-12 ? 1.0 : std::erf(limit / (std::sqrt(2.0) * sigma));
}

// Standard deviations of the gripper's place against the part's (gripper axes): position, rotation.
struct GripperSigmas {
  Eigen::Vector3d place, turn;
};
GripperSigmas SigmasOf(const GraspScene::Object& object,
                       const Matrix6d& covariance,
                       const Rigid3& object_from_gripper) {
  const Matrix6d J = FirstInProduct(object.scene_from_object, object_from_gripper);
  const Matrix6d C = J * covariance * J.transpose();
  const Eigen::Matrix3d R = object.scene_from_object.R * object_from_gripper.R;
  const auto sigmas = [&](const Eigen::Matrix3d& block) {
    return Eigen::Vector3d((R.transpose() * block * R).diagonal().cwiseMax(0.0).cwiseSqrt());
  };
  return {sigmas(C.bottomRightCorner<3, 3>()), sigmas(C.topLeftCorner<3, 3>())};
}

using PointJacobian = Eigen::Matrix<double, 3, 6>;

// Of a point fixed to the object by the perturbation of its pose.
PointJacobian MotionOfPoint(const GraspScene::Object& object, const Eigen::Vector3d& point) {
  const Eigen::Vector3d r = point - object.scene_from_object.t;
  PointJacobian J;
  J << 0.0, r.z(), -r.y(), 1.0, 0.0, 0.0,  //
      -r.z(), 0.0, r.x(), 0.0, 1.0, 0.0,   //
      r.y(), -r.x(), 0.0, 0.0, 0.0, 1.0;
  return J;
}

// Standard deviation, in the direction where it is largest, of a point fixed to object i against
// object k.
double RelativeSigma(const GraspScene& scene, int i, int k, const Eigen::Vector3d& point) {
  const PointJacobian Ji = MotionOfPoint(scene.objects[i], point),
                      Jk = MotionOfPoint(scene.objects[k], point);
  Eigen::Matrix3d C = Ji * scene.objects[i].covariance * Ji.transpose() +
                      Jk * scene.objects[k].covariance * Jk.transpose();
  if (scene.joint_covariance.size() > 0) {
    const Eigen::Matrix3d cross =
        Ji * scene.joint_covariance.block<6, 6>(6 * i, 6 * k) * Jk.transpose();
    C -= cross + cross.transpose();
  }
  const Eigen::SelfAdjointEigenSolver<Eigen::Matrix3d> solver(C, Eigen::EigenvaluesOnly);
  return std::sqrt(std::max(0.0, solver.eigenvalues().maxCoeff()));
}

bool GripperCan(const SceneGrasp& grasp, const GraspOptions& options) {
  if (grasp.suction) return options.suction.has_value();
  return options.parallel_jaw && grasp.jaw_opening_m <= options.parallel_jaw->max_opening_m;
}

// Half the room between open fingers and the part; nothing of a cup passes the part.
double PlayOf(const SceneGrasp& grasp) {
  return 0.5 * (grasp.jaw_opening_m - grasp.grip_width_m);
}

double SuccessOf(const SceneGrasp& grasp,
                 const GripperSigmas& sigmas,
                 const GraspOptions& options) {
  if (grasp.suction) {  // turns about its own axis are free
    return Within(options.tolerance_m, sigmas.place.x()) *
           Within(options.tolerance_m, sigmas.place.y()) *
           Within(options.tolerance_m, sigmas.place.z()) *
           Within(options.tolerance_rad, sigmas.turn.x()) *
           Within(options.tolerance_rad, sigmas.turn.y());
  }
  return Within(PlayOf(grasp), sigmas.place.x()) * Within(options.tolerance_m, sigmas.place.y()) *
         Within(options.tolerance_m, sigmas.place.z()) *
         Within(options.tolerance_rad, sigmas.turn.y()) *
         Within(options.tolerance_rad, sigmas.turn.z());
}

// The gripper on its way with free space beside it, `sigma_m` the part's uncertainty.
std::vector<SweptBox> SweptGripper(const SceneGrasp& grasp,
                                   double sigma_m,
                                   const GraspOptions& options) {
  const double margin = options.clearance_m + options.clearance_sigmas * sigma_m;
  return grasp.suction ? SweptCup(grasp, *options.suction, options, margin)
                       : SweptFingers(grasp, *options.parallel_jaw, options, margin);
}

bool MeetsPlane(const GraspScene& scene,
                const SceneGrasp& grasp,
                double sigma_m,
                const GraspOptions& options) {
  if (!scene.plane) return false;
  const std::vector<SweptBox> boxes = SweptGripper(grasp, sigma_m, options);
  return std::any_of(boxes.begin(), boxes.end(), [&](const SweptBox& f) {
    return LowestOfFinger(f, scene.plane->normal) < scene.plane->offset_m;
  });
}

bool MeetsOthers(const GraspScene& scene,
                 int object,
                 const SceneGrasp& grasp,
                 const GraspOptions& options) {
  for (int k = 0; k < static_cast<int>(scene.objects.size()); ++k) {
    if (k == object) continue;
    const double sigma = RelativeSigma(scene, object, k, grasp.scene_from_gripper.t);
    const std::vector<SweptBox> boxes = SweptGripper(grasp, sigma, options);
    if (std::any_of(boxes.begin(), boxes.end(), [&](const SweptBox& f) {
          return MeetsMesh(f, scene.objects[k]);
        }))
      return true;
  }
  return false;
}

}  // namespace

bool BoxMeetsTriangle(const Eigen::Vector3d& center,
                      const Eigen::Matrix3d& R,
                      const Eigen::Vector3d& half,
                      const Eigen::Vector3d& a,
                      const Eigen::Vector3d& b,
                      const Eigen::Vector3d& c) {
  const Eigen::Vector3d v[3] = {
      R.transpose() * (a - center), R.transpose() * (b - center), R.transpose() * (c - center)};
  const auto separates = [&](const Eigen::Vector3d& axis) {
    const double p[3] = {axis.dot(v[0]), axis.dot(v[1]), axis.dot(v[2])};
    const double r = axis.cwiseAbs().dot(half);
    return std::min({p[0], p[1], p[2]}) > r || std::max({p[0], p[1], p[2]}) < -r;
  };
  const Eigen::Vector3d edges[3] = {v[1] - v[0], v[2] - v[1], v[0] - v[2]};
  for (int i = 0; i < 3; ++i) {
    if (separates(Eigen::Vector3d::Unit(i))) return false;
  }
  if (separates(edges[0].cross(edges[1]))) return false;
  for (const Eigen::Vector3d& e : edges) {
    for (int i = 0; i < 3; ++i) {
      if (separates(Eigen::Vector3d::Unit(i).cross(e))) return false;
    }
  }
  return true;
}

std::vector<SceneGrasp> GraspsInScene(const ObjectModel& model,
                                      const Rigid3& scene_from_object,
                                      double approach_m) {
  std::vector<SceneGrasp> out;
  for (int s = 0; s <= static_cast<int>(model.symmetries.size()); ++s) {
    const Rigid3 symmetry = s == 0 ? Rigid3{} : model.symmetries[s - 1];
    for (const Grasp& g : model.grasps) {
      SceneGrasp grasp;
      grasp.name = g.name;
      grasp.symmetry = s;
      grasp.scene_from_gripper = scene_from_object * symmetry * g.object_from_gripper;
      if (g.object_from_pregrasp) {
        grasp.scene_from_pregrasp = scene_from_object * symmetry * *g.object_from_pregrasp;
      } else {
        grasp.scene_from_pregrasp = grasp.scene_from_gripper;
        grasp.scene_from_pregrasp.t -= approach_m * grasp.scene_from_gripper.R.col(2);
      }
      grasp.suction = IsSuction(g);
      if (grasp.suction) {
        grasp.cup_radius_m = CupRadius(g);
      } else {
        grasp.jaw_opening_m = g.jaw_opening_m;
        grasp.grip_width_m = g.grip_width_m;
      }
      grasp.quality = g.quality;
      out.push_back(grasp);
    }
  }
  return out;
}

std::vector<SceneGrasp> PlanGrasps(const GraspScene& scene,
                                   int object,
                                   const GraspOptions& options,
                                   GraspCounts* counts) {
  const GraspScene::Object& target = scene.objects[object];
  GraspCounts local;
  std::vector<SceneGrasp> out;
  for (SceneGrasp& grasp :
       GraspsInScene(*target.model, target.scene_from_object, options.approach_m)) {
    ++local.considered;
    if (!GripperCan(grasp, options)) {
      ++local.other_gripper;
      continue;
    }
    if (!grasp.suction && !(PlayOf(grasp) > 0.0)) {
      ++local.too_narrow;
      continue;
    }
    const Rigid3 object_from_gripper =
        target.scene_from_object.Inverse() * grasp.scene_from_gripper;
    const GripperSigmas sigmas = SigmasOf(target, target.covariance, object_from_gripper);
    if (MeetsPlane(scene, grasp, sigmas.place.maxCoeff(), options)) {
      ++local.below_plane;
      continue;
    }
    if (MeetsOthers(scene, object, grasp, options)) {
      ++local.blocked;
      continue;
    }
    grasp.scene_success = SuccessOf(grasp, sigmas, options);
    if (grasp.scene_success < options.least_success) {
      ++local.unsure;
      continue;
    }
    grasp.success =
        target.covariance_in_base
            ? SuccessOf(
                  grasp, SigmasOf(target, *target.covariance_in_base, object_from_gripper), options)
            : grasp.scene_success;
    out.push_back(std::move(grasp));
  }
  std::stable_sort(out.begin(), out.end(), [](const SceneGrasp& a, const SceneGrasp& b) {
    return a.quality * a.success > b.quality * b.success;
  });
  if (counts != nullptr) *counts = local;
  return out;
}

}  // namespace horopter
