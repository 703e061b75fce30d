#include <Eigen/Dense>
#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <numbers>

#include "server/base/constants.h"
#include "server/vision/geometry/mesh_symmetry.h"

namespace horopter {
namespace {

using Eigen::Vector3d;

bool Known(const std::vector<Eigen::Matrix3d>& list, const Eigen::Matrix3d& R) {
  // Frobenius, 2.4 degrees: measured axes are not exact; turns of order 120 differ by 3 degrees.
  constexpr double kSameRotation = 0.06;
  return std::any_of(
      list.begin(), list.end(), [&](const auto& k) { return (k - R).norm() < kSameRotation; });
}

// Products of the generators until nothing new comes.
std::vector<Eigen::Matrix3d> Closure(const std::vector<Eigen::Matrix3d>& generators, int most) {
  std::vector<Eigen::Matrix3d> group{Eigen::Matrix3d::Identity()};
  for (std::size_t i = 0; i < group.size(); ++i) {
    for (const Eigen::Matrix3d& g : generators) {
      if (static_cast<int>(group.size()) > most) return group;
      const Eigen::Matrix3d product = group[i] * g;
      if (!Known(group, product)) group.push_back(product);
    }
  }
  return group;
}

Eigen::Matrix3d Turn(double angle, const Vector3d& axis) {
  return Eigen::AngleAxisd(angle, axis.normalized()).toRotationMatrix();
}

}  // namespace

Rigid3 TurnAbout(const SymmetryAxis& axis, double angle_rad) {
  const Eigen::Matrix3d R = Turn(angle_rad, axis.axis);
  return {R, axis.point - R * axis.point};
}

std::vector<Rigid3> TurnsOf(const SymmetryAxis& axis, int steps) {
  const int count = axis.order == 0 ? steps : axis.order;
  std::vector<Rigid3> out;
  for (int k = 1; k < count; ++k) out.push_back(TurnAbout(axis, 2.0 * kPi * k / count));
  return out;
}

std::vector<Rigid3> SymmetryGroup(const MeshSymmetries& symmetries, int steps, int most) {
  std::vector<Eigen::Matrix3d> generators;
  if (symmetries.sphere) {
    const double golden = 0.5 * (1.0 + std::sqrt(5.0));
    generators = {Turn(2.0 * kPi / 5.0, {0.0, 1.0, golden}), Turn(kPi, Vector3d::UnitZ())};
  }
  for (const SymmetryAxis& a : symmetries.exact) {
    Vector3d axis = a.axis;
    // Measured axes are off by hundredths of a degree, which products would add up.
    const Vector3d& main = symmetries.exact.front().axis;
    if (std::abs(axis.dot(main)) < 0.03) axis -= main * axis.dot(main);
    generators.push_back(Turn(2.0 * kPi / (a.order == 0 ? steps : a.order), axis));
  }
  std::vector<Rigid3> out;
  for (const Eigen::Matrix3d& R : Closure(generators, most)) {
    if ((R - Eigen::Matrix3d::Identity()).norm() < 1e-6) continue;
    out.push_back({R, symmetries.center - R * symmetries.center});
  }
  return out;
}

}  // namespace horopter
