#include "server/vision/euclidean/representative.h"

#include <Eigen/Geometry>
#include <cmath>
#include <vector>

namespace horopter {
namespace {

constexpr double kSameAxis = 0.999;  // cosine

}  // namespace

std::optional<RevolutionAxis> FindRevolutionAxis(const ObjectModel& model) {
  std::vector<std::pair<Eigen::Vector3d, int>> axes;
  for (const Rigid3& S : model.symmetries) {
    const Eigen::AngleAxisd turn(S.R);
    if (turn.angle() < 1e-6) continue;
    bool known = false;
    for (auto& [axis, count] : axes) {
      if (std::abs(axis.dot(turn.axis())) < kSameAxis) continue;
      known = true;
      if (++count < kRevolutionSteps) break;
      // (I - R) p = t has the axis' points as solutions; the pseudo-inverse gives the nearest one.
      const Eigen::Matrix3d A = Eigen::Matrix3d::Identity() - S.R;
      return RevolutionAxis{axis, A.completeOrthogonalDecomposition().solve(S.t)};
    }
    if (!known) axes.push_back({turn.axis(), 1});
  }
  return std::nullopt;
}

Rigid3 RepresentativePose(const ObjectModel& model, const Rigid3& camera_from_object) {
  if (model.symmetries.empty()) return camera_from_object;
  // No multiple of a turn by 1/2, 1/3, 1/4 .. about no axis of a box.
  const Eigen::Matrix3d preferred =
      Eigen::AngleAxisd(1.047 * 1.1, Eigen::Vector3d(0.31, -0.87, 0.38).normalized())
          .toRotationMatrix();
  const auto revolution = FindRevolutionAxis(model);
  Rigid3 best = camera_from_object;
  double best_trace = -4.0;
  for (std::size_t s = 0; s <= model.symmetries.size(); ++s) {
    Rigid3 pose = s == 0 ? camera_from_object : camera_from_object * model.symmetries[s - 1];
    if (revolution) {
      // trace(preferred' R A(angle)) = c + a cos + b sin: Rodrigues' formula.
      const Eigen::Matrix3d Q = preferred.transpose() * pose.R;
      const Eigen::Vector3d& k = revolution->axis;
      const double along = k.dot(Q * k);
      const double a = Q.trace() - along;
      const Eigen::Vector3d vee(Q(2, 1) - Q(1, 2), Q(0, 2) - Q(2, 0), Q(1, 0) - Q(0, 1));
      const Eigen::Matrix3d A = Eigen::AngleAxisd(std::atan2(-vee.dot(k), a), k).toRotationMatrix();
      pose = pose * Rigid3{A, revolution->point - A * revolution->point};
    }
    const double trace = (preferred.transpose() * pose.R).trace();
    if (trace > best_trace + 1e-9) {
      best_trace = trace;
      best = pose;
    }
  }
  return best;
}

}  // namespace horopter
