// What a request's images are expected to say of a station's cameras; internal to this folder.
#pragma once

#include <Eigen/Cholesky>
#include <Eigen/Core>
#include <vector>

#include "server/vision/station/station_filter.h"

namespace horopter {

inline constexpr int kCam = kStationCameraParameters;  // of a camera's block in the state
inline constexpr int kLensAt = kStationIntrinsics;     // focal length, principal point and k1 in it
inline constexpr int kLensSize = kCam - kLensAt;       // how many these are
using StationVector = Eigen::Matrix<double, kCam, 1>;

// Deviations of log f, cx, cy, k1 of any camera.
Eigen::Vector4d PopulationSigmas(const PinholeCamera& camera, const StationOptions& options);

void ClearRows(int at, int count, Eigen::MatrixXd* P);
void SetLensSigmas(int camera, const Eigen::Vector4d& sigmas, Eigen::MatrixXd* P);

// A lens that is declared to change is forgotten before each request.
void ForgetZooms(const StationOptions& options, StationState* state);

// The state as it is believed at a request: what may have changed unnoticed is added, lenses that
// are declared to change are forgotten.
StationState AtNextRequest(StationState state, const StationOptions& options);

// The parameters that a request has to do with: those of the state, and a place of their own for
// images of cameras that have none in the rig.
struct StationPrediction {
  std::vector<PinholeCamera> cameras;  // of the state
  std::vector<Rigid3> places;          // of the state's cameras, then of single views
  Eigen::MatrixXd P;
  std::vector<int> camera;         // per view of the evidence: of the state, -1: none
  std::vector<int> place_at;       // per view: column of its place
  std::vector<int> place;          // per view: index into places
  std::vector<int> lens_at;        // per view: column of its lens
  std::vector<bool> was_posed;     // per view
  std::vector<bool> learns_place;  // per view: its place is to be the camera's
};

// views: of the request; group: of its evidence. The parameters of an image that no camera of the
// station took stand behind those of the state. Places that are not known are taken from the group,
// seen from one that is.
StationPrediction Predict(const StationState& state,
                          const StationViews& views,
                          const CameraGroup& group,
                          const StationOptions& options);

// The cameras of the group as predicted, to be compared with it.
std::vector<AdjustedView> ViewsOf(const StationPrediction& p, const CameraGroup& group);

// Derivative of the group's parameters by those of the prediction.
Eigen::MatrixXd PredictionJacobian(const StationPrediction& p,
                                   const CameraGroup& group,
                                   const std::vector<AdjustedView>& views);

// The information of the evidence, with a little for parameters that the data leave open, so that
// it can be inverted.
Eigen::MatrixXd Closed(const CameraGroup& group, Eigen::MatrixXd information);

// A positive matrix factored after its diagonal was scaled to one: radians, metres and pixels
// alike.
class EquilibratedFactors {
 public:
  explicit EquilibratedFactors(const Eigen::MatrixXd& A);
  Eigen::VectorXd Solve(const Eigen::VectorXd& b) const;
  Eigen::MatrixXd Inverse() const;
  Eigen::VectorXd InverseDiagonal() const;

 private:
  Eigen::VectorXd scale_;
  Eigen::LDLT<Eigen::MatrixXd> factors_;
};

}  // namespace horopter
