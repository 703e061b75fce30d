#include "server/vision/geometry/grasp_check.h"

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <cstdio>
#include <functional>

#include "server/vision/geometry/grasp_kind.h"

namespace horopter {
namespace {

// A pre-grasp whose orientation or direction differs by more is none of a straight approach.
constexpr double kSameOrientation = 1e-2;
constexpr double kAside = 2e-2;

std::string Millimetres(double metres) {
  char text[32];
  std::snprintf(text, sizeof(text), "%.1f mm", metres * 1e3);
  return text;
}

// Parameters s in [0, length] at which the line from + s direction meets the mesh (Moeller,
// Trumbore 1997), ascending. Hits on an edge of two triangles come twice.
std::vector<double> Crossings(const TriangleMesh& mesh,
                              const Eigen::Vector3d& from,
                              const Eigen::Vector3d& direction,
                              double length) {
  constexpr double kAlongFace = 1e-12;  // sine of ray and triangle: they do not meet
  std::vector<double> crossings;
  for (const Eigen::Vector3i& t : mesh.triangles) {
    const Eigen::Vector3d& a = mesh.vertices[t(0)];
    const Eigen::Vector3d e1 = mesh.vertices[t(1)] - a, e2 = mesh.vertices[t(2)] - a;
    const Eigen::Vector3d p = direction.cross(e2);
    const double det = e1.dot(p);
    if (std::abs(det) < kAlongFace * e1.norm() * e2.norm()) continue;
    const Eigen::Vector3d s = from - a, q = s.cross(e1);
    const double u = s.dot(p) / det, v = direction.dot(q) / det, at = e2.dot(q) / det;
    if (u >= 0.0 && v >= 0.0 && u + v <= 1.0 && at >= 0.0 && at <= length) crossings.push_back(at);
  }
  std::sort(crossings.begin(), crossings.end());
  return crossings;
}

// The part must begin where the rim is, in its middle and all around it. Empty: it does.
std::string SuctionProblem(const ObjectModel& model, const Rigid3& pose, double cup_radius_m) {
  constexpr int kAround = 8;          // points of the cup's rim that must lie on the face
  constexpr double kSealShare = 0.1;  // of the radius: what a lip makes up for
  const double reach = std::max(cup_radius_m, 1e-3 * model.diameter_m);
  for (int i = -1; i < kAround; ++i) {
    const double angle = 2.0 * M_PI * (i + 0.5) / kAround;
    const Eigen::Vector3d rim =
        i < 0 ? Eigen::Vector3d(0.0, 0.0, -reach)
              : Eigen::Vector3d(
                    cup_radius_m * std::cos(angle), cup_radius_m * std::sin(angle), -reach);
    const std::vector<double> hits = Crossings(model.mesh, pose * rim, pose.R.col(2), 2.0 * reach);
    if (hits.empty() || std::abs(hits.front() - reach) > kSealShare * reach) {
      return "the cup does not meet the part all around";
    }
  }
  return "";
}

using Report = std::function<void(const std::string& what)>;

// From the pre-grasp to the grasp.
void CheckWay(const Rigid3& pose, const Rigid3& before, const Report& report) {
  const Eigen::Vector3d z = pose.R.col(2);
  const Eigen::Vector3d way = pose.t - before.t;
  if (!before.R.isApprox(pose.R, kSameOrientation)) report("the gripper turns after the pre-grasp");
  if (!(way.dot(z) > 0.0)) report("the pre-grasp is not before the part");
  if (way.cross(z).norm() > kAside * way.norm()) {
    report("the way from the pre-grasp is not along the approach axis");
  }
}

// Fingers and what is between them.
void CheckJaws(const ObjectModel& model,
               const Grasp& grasp,
               const GraspCheckOptions& options,
               const Report& report) {
  const Rigid3& pose = grasp.object_from_gripper;
  const Eigen::Vector3d x = pose.R.col(0), z = pose.R.col(2);
  if (grasp.grip_width_m > grasp.jaw_opening_m) {
    report("the part is wider (" + Millimetres(grasp.grip_width_m) + ") than the opening (" +
           Millimetres(grasp.jaw_opening_m) + ")");
  }
  // From the pre-grasp on, which may lie farther away than where a bare grasp's approach begins.
  double approach = options.approach_diameters * model.diameter_m;
  if (grasp.object_from_pregrasp) {
    approach = std::max(approach, (pose.t - grasp.object_from_pregrasp->t).norm());
  }
  const double half = 0.5 * grasp.jaw_opening_m;
  // Coordinates of a part are round numbers: a finger that slides along a face is moved off it by
  // nothing that matters.
  const double aside = 1e-7 * model.diameter_m;
  for (const double side : {-1.0, 1.0}) {
    const Eigen::Vector3d tip = pose * Eigen::Vector3d(side * half + side * aside, aside, aside);
    if (!Crossings(model.mesh, tip - approach * z, z, approach).empty()) {
      report("a finger passes through the part on its way");
      break;
    }
  }
  const Eigen::Vector3d start = pose * Eigen::Vector3d(-half, aside, aside);
  const std::vector<double> hits = Crossings(model.mesh, start, x, grasp.jaw_opening_m);
  if (hits.empty()) {
    report("nothing is between the fingers");
    return;
  }
  const double width = hits.back() - hits.front();
  if (grasp.grip_width_m > 0.0 &&
      std::abs(width - grasp.grip_width_m) > options.width_tolerance * grasp.jaw_opening_m) {
    report("the part is " + Millimetres(width) + " wide between the fingers, not " +
           Millimetres(grasp.grip_width_m));
  }
}

}  // namespace

std::vector<std::string> CheckGrasps(const ObjectModel& model, const GraspCheckOptions& options) {
  std::vector<std::string> problems;
  for (const Grasp& grasp : model.grasps) {
    const auto report = [&](const std::string& what) {
      problems.push_back(grasp.name + ": " + what);
    };
    if (grasp.object_from_pregrasp)
      CheckWay(grasp.object_from_gripper, *grasp.object_from_pregrasp, report);
    if (IsSuction(grasp)) {
      const std::string problem =
          SuctionProblem(model, grasp.object_from_gripper, CupRadius(grasp));
      if (!problem.empty()) report(problem);
    } else if (!(grasp.jaw_opening_m > 0.0)) {
      report("no jaw opening is given");
    } else {
      CheckJaws(model, grasp, options, report);
    }
  }
  return problems;
}

}  // namespace horopter
