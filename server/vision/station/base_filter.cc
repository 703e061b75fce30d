#include "server/vision/station/base_filter.h"

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>

namespace horopter {
namespace {

constexpr int kFreedoms = 6;
// What is said of a base is believed to this at the best: models and fixtures err by as much.
constexpr double kLeastSigmaRad = 2e-4;
constexpr double kLeastSigmaM = 1e-4;

double MeanSigma(const Eigen::Matrix3d& block) {
  return std::sqrt(std::max(0.0, block.trace() / 3.0));
}

// As it is believed at a request: what may have changed unnoticed is added.
CameraBase AtNextRequest(CameraBase known, const StationOptions& options) {
  known.rotation_sigma_rad = std::hypot(known.rotation_sigma_rad, options.drift_turn_rad);
  known.position_sigma_m = std::hypot(known.position_sigma_m, options.drift_shift_m);
  return known;
}

}  // namespace

CameraBase BaseSeen(const UncertainPose& base_from_camera, const StationOptions& options) {
  CameraBase out;
  out.base_from_camera = base_from_camera.pose;
  out.rotation_sigma_rad =
      std::max(kLeastSigmaRad,
               options.widening * MeanSigma(base_from_camera.covariance.topLeftCorner<3, 3>()));
  out.position_sigma_m =
      std::max(kLeastSigmaM,
               options.widening * MeanSigma(base_from_camera.covariance.bottomRightCorner<3, 3>()));
  out.learnt = true;
  out.requests = 1;
  return out;
}

BaseTest TestBase(const CameraBase& known, const CameraBase& seen, const StationOptions& options) {
  const CameraBase now = AtNextRequest(known, options);
  BaseTest out;
  out.turn_rad =
      Eigen::AngleAxisd(now.base_from_camera.R.transpose() * seen.base_from_camera.R).angle();
  out.shift_m = (now.base_from_camera.t - seen.base_from_camera.t).norm();
  const double turns = out.turn_rad / std::hypot(now.rotation_sigma_rad, seen.rotation_sigma_rad);
  const double shifts = out.shift_m / std::hypot(now.position_sigma_m, seen.position_sigma_m);
  out.squared = turns * turns + shifts * shifts;
  out.limit = ChiSquareLimit(kFreedoms, options.alarm_sigmas);
  out.agrees = out.squared <= out.limit ||
               (out.turn_rad <= kLeastBaseTurnRad && out.shift_m <= kLeastBaseShiftM);
  return out;
}

CameraBase ThroughRig(const StationState& state, const CameraBase& known, int from, int to) {
  CameraBase out = known;
  out.base_from_camera = known.base_from_camera * state.cameras[from].camera_from_rig *
                         state.cameras[to].camera_from_rig.Inverse();
  for (const int c : {from, to}) {
    const StationDeviations d = DeviationsOf(state, c);
    out.rotation_sigma_rad = std::hypot(out.rotation_sigma_rad, d.turn_rad);
    out.position_sigma_m = std::hypot(out.position_sigma_m, d.shift_m);
  }
  return out;
}

CameraBase UpdateBase(const CameraBase& known,
                      const CameraBase& seen,
                      const StationOptions& options) {
  if (!known.learnt) return known;
  CameraBase out = AtNextRequest(known, options);
  const auto information = [](double sigma) { return 1.0 / (sigma * sigma); };
  const double turn_known = options.remembered * information(out.rotation_sigma_rad),
               turn_seen = information(seen.rotation_sigma_rad);
  const double shift_known = options.remembered * information(out.position_sigma_m),
               shift_seen = information(seen.position_sigma_m);
  const double turn_share = turn_seen / (turn_known + turn_seen),
               shift_share = shift_seen / (shift_known + shift_seen);
  const Eigen::AngleAxisd turn(out.base_from_camera.R.transpose() * seen.base_from_camera.R);
  out.base_from_camera.R =
      out.base_from_camera.R *
      Eigen::AngleAxisd(turn_share * turn.angle(), turn.axis()).toRotationMatrix();
  out.base_from_camera.t += shift_share * (seen.base_from_camera.t - out.base_from_camera.t);
  out.rotation_sigma_rad = std::max(kLeastSigmaRad, 1.0 / std::sqrt(turn_known + turn_seen));
  out.position_sigma_m = std::max(kLeastSigmaM, 1.0 / std::sqrt(shift_known + shift_seen));
  ++out.requests;
  return out;
}

}  // namespace horopter
