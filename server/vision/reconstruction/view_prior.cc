#include "server/vision/reconstruction/view_prior.h"

#include <Eigen/LU>
#include <cmath>
#include <string>

namespace horopter {
namespace {

// Frobenius norm of R R' - I: a caller's matrix may be rounded.
constexpr double kRotationTolerance = 1e-3;

bool IsPositive(double x) {
  return x > 0.0 && std::isfinite(x);
}

bool IsRotation(const Eigen::Matrix3d& R) {
  return R.allFinite() &&
         (R * R.transpose() - Eigen::Matrix3d::Identity()).norm() < kRotationTolerance &&
         R.determinant() > 0.0;
}

// What is wrong with it; nullptr: nothing.
const char* Fault(const ViewPrior& p) {
  if (p.focal_px && !IsPositive(*p.focal_px)) return "focal_px: need a positive length";
  if (!IsPositive(p.focal_log_sigma)) return "focal_log_sigma: need a positive deviation";
  if (p.principal_point_px && !p.principal_point_px->allFinite()) {
    return "principal_point_px: not finite";
  }
  if (!IsPositive(p.principal_point_sigma_px)) {
    return "principal_point_sigma_px: need a positive deviation";
  }
  if (p.k1 && !std::isfinite(*p.k1)) return "k1: not finite";
  if (!IsPositive(p.k1_sigma)) return "k1_sigma: need a positive deviation";
  if (!IsPositive(p.rotation_sigma_rad) || !IsPositive(p.position_sigma_m)) {
    return "camera_from_world: need positive deviations";
  }
  if (p.camera_from_world &&
      !(IsRotation(p.camera_from_world->R) && p.camera_from_world->t.allFinite())) {
    return "camera_from_world: not a rotation and a finite translation";
  }
  return nullptr;
}

}  // namespace

absl::Status Validate(std::span<const ViewPrior> priors, std::size_t views) {
  if (!priors.empty() && priors.size() != views) {
    return absl::InvalidArgumentError("priors: one per view or none");
  }
  for (std::size_t v = 0; v < priors.size(); ++v) {
    if (const char* fault = Fault(priors[v])) {
      return absl::InvalidArgumentError("priors[" + std::to_string(v) + "]." + fault);
    }
  }
  return absl::OkStatus();
}

}  // namespace horopter
