#include "server/pipeline/station.h"

#include <algorithm>
#include <utility>

#include "server/pipeline/scene.h"

namespace horopter {
namespace {

// Lenses known worse are no hint.
constexpr double kWorstFocalLogSigma = 0.08;
constexpr double kWorstCenter = 0.005;  // of the width
constexpr double kWorstK1 = 0.01;
// Deviations that hints are given at least: recognition's images are not exact.
constexpr double kLeastFocalLogSigma = 0.004;
constexpr double kLeastTurnRad = 0.002;
constexpr double kLeastShiftM = 0.002;

CameraHint HintOf(const StationState& state, int camera) {
  const StationDeviations d = DeviationsOf(state, camera);
  const PinholeCamera& c = state.cameras[camera].camera;
  CameraHint hint;
  if (state.cameras[camera].zooming || d.log_focal > kWorstFocalLogSigma) return hint;
  hint.focal_px = c.focal_px;
  hint.focal_log_sigma = std::max(kLeastFocalLogSigma, d.log_focal);
  if (d.center_px <= kWorstCenter * c.width) hint.principal_point = Eigen::Vector2d(c.cx, c.cy);
  if (d.k1 <= kWorstK1) hint.k1 = c.k1;
  return hint;
}

// Whether the view's camera has a place of its own in the rig.
bool HasPlace(const StationRequest& station, std::size_t view) {
  const int c = station.views[view];
  return c >= 0 && station.state.cameras[c].posed && !station.state.cameras[c].moving &&
         std::count(station.views.begin(), station.views.end(), c) == 1;
}

// A camera whose place in the base is known best: what people said goes before what was learnt.
struct Surest {
  int camera = -1;
  CameraBase base;
};
std::optional<Surest> SurestBase(const StationRequest& station, const StationTest& test) {
  std::optional<Surest> out;
  const std::size_t cameras = std::min(station.state.cameras.size(), station.bases.size());
  for (std::size_t c = 0; c < cameras; ++c) {
    const StationCamera& camera = station.state.cameras[c];
    if (!station.bases[c] || !camera.posed || camera.moving || HasMoved(test, static_cast<int>(c)))
      continue;
    const CameraBase& base = *station.bases[c];
    if (out && std::pair(out->base.learnt, out->base.position_sigma_m) <=
                   std::pair(base.learnt, base.position_sigma_m))
      continue;
    out = Surest{static_cast<int>(c), base};
  }
  return out;
}

}  // namespace

bool IsSwapped(const StationTest& test) {
  return std::any_of(test.changes.begin(), test.changes.end(), [](const StationChange& change) {
    return change.kind == StationChangeKind::kSwapped;
  });
}

bool HasMoved(const StationTest& test, int camera) {
  return std::any_of(test.changes.begin(), test.changes.end(), [&](const StationChange& change) {
    return change.kind == StationChangeKind::kMoved &&
           std::find(change.cameras.begin(), change.cameras.end(), camera) != change.cameras.end();
  });
}

SceneRequest WithStationHints(const SceneRequest& request) {
  SceneRequest out = request;
  const StationRequest& station = *request.station;
  const std::size_t n = request.images.size();
  out.hints.resize(n);
  bool any = !request.hints.empty();
  for (std::size_t v = 0; v < n; ++v) {
    CameraHint& hint = out.hints[v];
    if (station.views[v] < 0 || hint.focal_px || hint.principal_point || hint.k1) continue;
    hint = HintOf(station.state, station.views[v]);
    any = any || hint.focal_px;
  }
  if (!any) out.hints.clear();
  // The reconstruction's world is the rig's: the metric stage ties the answer to the robot's base.
  if (!request.camera_poses.empty()) return out;
  std::vector<std::optional<CameraPoseHint>> places(n);
  int posed = 0;
  for (std::size_t v = 0; v < n; ++v) {
    if (!HasPlace(station, v)) continue;
    const StationDeviations d = DeviationsOf(station.state, station.views[v]);
    places[v] = CameraPoseHint{station.state.cameras[station.views[v]].camera_from_rig,
                               std::max(kLeastTurnRad, d.turn_rad),
                               std::max(kLeastShiftM, d.shift_m)};
    ++posed;
  }
  if (posed > 1) out.camera_poses = std::move(places);
  return out;
}

SceneRequest WithStationBase(const SceneRequest& request, const StationTest& test) {
  const StationRequest& station = *request.station;
  if (!request.camera_poses.empty() || IsSwapped(test)) return request;
  const std::optional<Surest> surest = SurestBase(station, test);
  SceneRequest out = request;
  std::vector<std::optional<CameraPoseHint>> poses(request.images.size());
  bool any = false;
  for (std::size_t v = 0; v < poses.size(); ++v) {
    const int c = station.views[v];
    if (c < 0 || c >= static_cast<int>(station.bases.size()) || station.state.cameras[c].moving)
      continue;
    if (HasMoved(test, c)) continue;
    std::optional<CameraBase> base = station.bases[c];
    if (!base && surest && HasPlace(station, v))
      base = ThroughRig(station.state, surest->base, surest->camera, c);
    if (!base) continue;
    poses[v] = CameraPoseHint{base->base_from_camera.Inverse(),
                              std::max(kLeastTurnRad, base->rotation_sigma_rad),
                              std::max(kLeastShiftM, base->position_sigma_m)};
    any = true;
  }
  if (any) out.camera_poses = std::move(poses);
  return out;
}

std::optional<BaseChange> BaseMoved(const StationRequest& station,
                                    const StationOutcome& outcome,
                                    const StationOptions& options) {
  std::optional<BaseChange> out;
  if (IsSwapped(outcome.test)) return out;
  for (std::size_t v = 0; v < std::min(station.views.size(), outcome.bases_seen.size()); ++v) {
    const int c = station.views[v];
    if (c < 0 || c >= static_cast<int>(station.bases.size()) || !station.bases[c] ||
        !outcome.bases_seen[v] || station.state.cameras[c].moving || HasMoved(outcome.test, c))
      continue;
    const BaseTest test = TestBase(*station.bases[c], *outcome.bases_seen[v], options);
    if (test.agrees) continue;
    if (!out) out = BaseChange{{}, test.turn_rad, test.shift_m, false};
    out->cameras.push_back(c);
    out->given = out->given || !station.bases[c]->learnt;
  }
  return out;
}

}  // namespace horopter
