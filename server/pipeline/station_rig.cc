#include "server/pipeline/station_rig.h"

#include <algorithm>

namespace horopter {
namespace {

// Parts are looked for under cameras known at least so well: edges are then within a few pixels of
// where they are searched (640 pixels, half a metre). Turn and principal point are mostly known
// better together than each alone.
constexpr double kMostLogFocal = 0.02;
constexpr double kMostTurnRad = 0.008;
constexpr double kMostShiftM = 0.004;
constexpr std::size_t kLeastViews = 2;  // one view tells nothing that it did not give

}  // namespace

std::vector<CalibratedCamera> KnownRig(const StationRequest& station) {
  std::vector<CalibratedCamera> rig;
  for (const int c : station.views) {
    if (c < 0 || std::count(station.views.begin(), station.views.end(), c) > 1) return {};
    const StationCamera& camera = station.state.cameras[c];
    const StationDeviations d = DeviationsOf(station.state, c);
    if (!camera.posed || camera.moving || camera.zooming || d.log_focal > kMostLogFocal ||
        d.turn_rad > kMostTurnRad || d.shift_m > kMostShiftM) {
      return {};
    }
    rig.push_back({camera.camera, camera.camera_from_rig});
  }
  if (rig.size() < kLeastViews) rig.clear();
  return rig;
}

}  // namespace horopter
