#include "server/pipeline/given_cameras.h"

#include <algorithm>
#include <opencv2/core.hpp>
#include <utility>

#include "server/vision/station/station_filter.h"

namespace horopter {
namespace {

// Parts are looked for under cameras known at least so well: edges are then within a few pixels of
// where they are searched (640 pixels, half a metre). Turn and principal point are mostly known
// better together than each alone.
constexpr double kMostLogFocal = 0.02;
constexpr double kMostTurnRad = 0.008;
constexpr double kMostShiftM = 0.004;
// Of cameras that a request places: as texture's, and the defaults of CameraPoseHint are within.
constexpr double kMostGivenTurnRad = 0.012;
constexpr double kMostGivenShiftM = 0.006;
constexpr int kLeastViews = 2;  // one view tells nothing that it did not give

// Nothing where two cameras are not known apart from each other. The frame's origin may be
// anywhere: what is seen is about as far away as cameras are apart.
KnownCameras WithPositionSigma(double shift_m, KnownCameras known) {
  double apart_m = 0.0;
  for (const auto& a : known.views) {
    for (const auto& b : known.views) {
      if (!a || !b) continue;
      apart_m = std::max(
          apart_m, (a->camera_from_scene.Inverse().t - b->camera_from_scene.Inverse().t).norm());
    }
  }
  if (known.known() < kLeastViews || !(apart_m > shift_m)) return {};
  known.position_sigma = shift_m / apart_m;
  return known;
}

}  // namespace

KnownCameras CamerasOfStation(const StationRequest& station) {
  KnownCameras known;
  known.scale_known = true;
  double shift_m = 0.0;
  for (const int c : station.views) {
    if (c < 0 || std::count(station.views.begin(), station.views.end(), c) > 1) return {};
    const StationCamera& camera = station.state.cameras[c];
    const StationDeviations d = DeviationsOf(station.state, c);
    if (!camera.posed || camera.moving || camera.zooming || d.log_focal > kMostLogFocal ||
        d.turn_rad > kMostTurnRad || d.shift_m > kMostShiftM) {
      return {};
    }
    CalibratedView view;
    view.camera = camera.camera;
    view.camera_from_scene = camera.camera_from_rig;
    view.focal_log_sigma = d.log_focal;
    known.views.push_back(view);
    known.rotation_sigma_rad = std::max(known.rotation_sigma_rad, d.turn_rad);
    shift_m = std::max(shift_m, d.shift_m);
  }
  return WithPositionSigma(shift_m, std::move(known));
}

KnownCameras CamerasOfRequest(const SceneRequest& request) {
  const std::size_t n = request.images.size();
  if (request.camera_poses.size() != n || request.hints.size() != n) return {};
  KnownCameras known;
  known.scale_known = true;
  double shift_m = 0.0;
  for (std::size_t v = 0; v < n; ++v) {
    const CameraHint& hint = request.hints[v];
    const std::optional<CameraPoseHint>& pose = request.camera_poses[v];
    if (!pose || !hint.focal_px || FocalLogSigma(hint) > kMostLogFocal ||
        pose->rotation_sigma_rad > kMostGivenTurnRad || pose->position_sigma_m > kMostGivenShiftM) {
      return {};
    }
    const cv::Mat& image = request.images[v];
    CalibratedView view;
    view.camera = CenteredCamera(image.cols, image.rows, *hint.focal_px);
    if (hint.principal_point) {
      view.camera.cx = hint.principal_point->x();
      view.camera.cy = hint.principal_point->y();
    }
    view.camera.k1 = hint.k1.value_or(0.0);
    view.camera_from_scene = pose->camera_from_base;
    view.focal_log_sigma = FocalLogSigma(hint);
    known.views.push_back(view);
    known.rotation_sigma_rad = std::max(known.rotation_sigma_rad, pose->rotation_sigma_rad);
    shift_m = std::max(shift_m, pose->position_sigma_m);
  }
  return WithPositionSigma(shift_m, std::move(known));
}

}  // namespace horopter
