// Grasps of the recognised objects that a gripper can reach, surest first (thesis 5.4).
#pragma once

#include <Eigen/Core>
#include <limits>
#include <map>
#include <optional>
#include <string>
#include <vector>

#include "server/vision/euclidean/supporting_plane_search.h"
#include "server/vision/geometry/object_model.h"
#include "server/vision/geometry/pose_perturbation.h"

namespace horopter {

// A grasp of a recognised object in the scene frame.
struct SceneGrasp {
  std::string name;
  int symmetry = 0;  // 0: identity, k: ObjectModel::symmetries[k-1]
  Rigid3 scene_from_gripper;
  double jaw_opening_m = 0.0;
  double grip_width_m = 0.0;
  double quality = 0.0;        // as enrolled
  Rigid3 scene_from_pregrasp;  // as enrolled, or approach_m back along the approach axis
  // Probability that the open fingers pass beside the part and close within the tolerances, or that
  // the cup meets its place within them, by the pose's covariance alone: in the frame the robot
  // works in, and in the scene.
  double success = 1.0;
  double scene_success = 1.0;
  bool suction = false;  // a cup of this radius instead of two fingers
  double cup_radius_m = 0.0;
};

// Two fingers, boxes of these sizes: length along z behind the tip, width along y, thickness along
// x outside the opening.
struct GripperShape {
  double finger_length_m = 0.060;
  double finger_width_m = 0.014;
  double finger_thickness_m = 0.008;
  double max_opening_m = std::numeric_limits<double>::infinity();
};

// A cup on its holder: a square box behind the rim, as wide as the wider of the two.
struct SuctionShape {
  double length_m = 0.060;
  double holder_radius_m = 0.0;
};

struct GraspOptions {
  // Empty: the robot has no such gripper.
  std::optional<GripperShape> parallel_jaw = GripperShape();
  std::optional<SuctionShape> suction = SuctionShape();
  double approach_m = 0.060;  // from the pre-grasp to the grasp, along z
  // Free space wanted beside the way, towards plane and other objects; the part's uncertainty
  // against them comes on top with `clearance_sigmas`.
  double clearance_m = 0.0005;
  double clearance_sigmas = 1.0;
  // Tolerances of a closed grasp along the fingers' faces and about their axes; of a cup's place
  // and tilt.
  double tolerance_m = 0.002;
  double tolerance_rad = 0.035;
  double least_success = 0.8;  // grasps less sure than this in the scene are not offered
};

// Objects with the covariances of their poses in the scene (perturbation of scene_from_object). How
// the robot's base lies in the scene is common to all of them and to the plane: it moves a grasp
// off its part, and brings nothing nearer to anything else.
struct GraspScene {
  struct Object {
    const ObjectModel* model = nullptr;
    Rigid3 scene_from_object;
    Matrix6d covariance = Matrix6d::Zero();
    // In the frame the robot works in, turned into scene axes; empty: it works in the scene.
    std::optional<Matrix6d> covariance_in_base = {};
  };
  std::vector<Object> objects;
  // Of all objects, six rows each; empty: they are independent.
  Eigen::MatrixXd joint_covariance = {};
  std::optional<SupportingPlane> plane;
};

// Why grasps of an object were not offered.
struct GraspCounts {
  int considered = 0;
  int too_narrow = 0;     // the opening does not pass the part's width
  int other_gripper = 0;  // the robot's gripper is of another kind, or opens less
  int below_plane = 0;
  int blocked = 0;  // by another object
  int unsure = 0;
};

// Every grasp of every symmetry, whether it can be done or not, in catalog order.
std::vector<SceneGrasp> GraspsInScene(const ObjectModel& model,
                                      const Rigid3& scene_from_object,
                                      double approach_m);

// The grasps of scene.objects[object] that can be reached, by falling quality * success.
std::vector<SceneGrasp> PlanGrasps(const GraspScene& scene,
                                   int object,
                                   const GraspOptions& options,
                                   GraspCounts* counts = nullptr);

// Whether a box {center + R diag(half) [-1, 1]^3} and a triangle meet (separating axes, Akenine-
// Moeller 2001).
bool BoxMeetsTriangle(const Eigen::Vector3d& center,
                      const Eigen::Matrix3d& R,
                      const Eigen::Vector3d& half,
                      const Eigen::Vector3d& a,
                      const Eigen::Vector3d& b,
                      const Eigen::Vector3d& c);

}  // namespace horopter
