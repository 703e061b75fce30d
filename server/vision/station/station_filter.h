// Cameras that calibrate themselves by working: what is known of a cell's cameras is tested against
// what a request's images say of them, used where both agree, and corrected by it (an information
// filter, ADR 30). All functions are pure.
#pragma once

#include <Eigen/Core>
#include <span>
#include <string>
#include <vector>

#include "absl/status/status.h"
#include "server/vision/euclidean/camera_group.h"
#include "server/vision/geometry/station_state.h"

namespace horopter {

struct StationOptions {
  // Weight of what was learnt before a request, at that request. Lower: drift is followed sooner,
  // less is known: about 1 / (1 - weight) requests are remembered.
  double remembered = 0.99;
  // What may change between two requests without being a finding, and what CAD models err by in
  // common; added at each use. Higher: less is made of a long history.
  double drift_turn_rad = 2e-4;
  double drift_shift_m = 1e-4;
  double drift_log_focal = 4e-4;
  double drift_center_px = 0.25;
  double drift_k1 = 3e-4;
  // A scene of cameras that are not known yet is adjusted as far from the truth as its focal
  // lengths are unsure, and what it says is linear only that near: beyond this deviation of log f
  // it counts ever less. Higher: stations learn from weaker scenes, and more wrongly.
  double linear_log_focal = 0.01;
  double near_log_focal = 0.04;  // better known focal lengths keep the scene near the truth
  // Of any camera, before anything is known of it: as EuclideanOptions has them.
  double focal_widths = 1.5;
  double focal_log_sigma = 0.35;
  double center_sigma = 0.01;  // of the width
  double k1_sigma = 0.03;
  // Of a lens that was refocused, zoomed or exchanged.
  double changed_log_focal = 0.2;
  double changed_center = 0.002;  // of the width: a turn moves the image further
  double changed_k1 = 0.03;
  // Evidence is taken for this many times less sure than it says: real parts are not quite their
  // models. Higher: fewer false alarms, small changes are seen later.
  double widening = 1.1;
  // Of the normal distribution: the distance of prior and evidence beyond which they differ is that
  // of chi^2 where the normal has this many deviations; 4.5: once in 300 000.
  double alarm_sigmas = 4.5;
  // A camera's place is known when it is known this well.
  double posed_turn_rad = 0.1;
  double posed_shift_m = 0.2;
};
absl::Status Validate(const StationOptions& options);

// Index in the state's cameras of the camera that took each image of a request, -1: of none.
using StationViews = std::vector<int>;

// Appends a camera of which nothing is known but the size of its images; its index.
int AddStationCamera(const std::string& id,
                     int width,
                     int height,
                     const StationOptions& options,
                     StationState* state);

// What is known of a camera is forgotten: its lens, its place in the rig, or both. The rest stays.
void ForgetLens(int camera, const StationOptions& options, StationState* state);
void ForgetPlace(int camera, StationState* state);

// Intrinsics with independent deviations (an imported calibration) take the place of what was
// known.
struct KnownLens {
  PinholeCamera camera;
  double focal_log_sigma = 0.002;
  double center_sigma_px = 1.0;
  double k1_sigma = 0.002;
};
void SetLens(int camera, const KnownLens& lens, StationState* state);

// What is known of the cameras of a request, the drift since included, as a prior of its
// adjustment. known: whether recognition recovered the view. Places count for fixed cameras with
// one image in the request.
CameraGroupPrior PriorOfRequest(const StationState& state,
                                const StationViews& views,
                                const std::vector<bool>& known,
                                const StationOptions& options);

enum class StationChangeKind { kMoved, kLens, kSwapped };
struct StationChange {
  StationChangeKind kind = StationChangeKind::kMoved;
  std::vector<int> cameras;  // one; more: one of them, which cannot be told; kSwapped: all of them
  // How much; of the first camera.
  double turn_rad = 0.0;
  double shift_m = 0.0;
  double log_focal = 0.0;  // log of the new focal length over the old
  Eigen::Vector2d center_px = Eigen::Vector2d::Zero();
  double k1 = 0.0;
};

struct StationTest {
  bool agrees = true;
  double squared = 0.0;  // Mahalanobis distance
  int freedoms = 0;      // of the numbers compared
  double limit = 0.0;    // that it must not exceed
  std::vector<StationChange> changes;
};

// Whether the images agree with what is known; if not, the change that explains them best.
StationTest TestStation(const StationState& state,
                        const StationViews& views,
                        const CameraEvidence& evidence,
                        const StationOptions& options);

// The state after the request: what changed (test.changes) is forgotten, then the evidence is
// added, the less the further it is from what was expected. Of swapped cameras, and of empty
// evidence, nothing is learnt.
StationState UpdateStation(StationState state,
                           const StationViews& views,
                           const CameraEvidence& evidence,
                           const StationTest& test,
                           const StationOptions& options);

// Standard deviations of a camera: turn about each axis and shift (root mean square), log f,
// principal point (root mean square), k1. Those of a place that is not known are 0.
struct StationDeviations {
  double turn_rad = 0.0;
  double shift_m = 0.0;
  double log_focal = 0.0;
  double center_px = 0.0;
  double k1 = 0.0;
};
StationDeviations DeviationsOf(const StationState& state, int camera);

// Largest value that chi^2 with `freedoms` degrees takes where the normal distribution has `sigmas`
// deviations (Wilson and Hilferty 1931).
double ChiSquareLimit(int freedoms, double sigmas);

}  // namespace horopter
