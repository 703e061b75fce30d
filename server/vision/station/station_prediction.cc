#include "server/vision/station/station_prediction.h"

#include <algorithm>

namespace horopter {
namespace {

// Of a place of which nothing is known, about where the images put it.
constexpr double kUnknownTurnSigma = 1.0;
constexpr double kUnknownShiftSigmaM = 3.0;

// Of a parameter of the evidence that the data leave open.
constexpr double kOpenTurn = 1.0, kOpenShiftM = 3.0, kOpenLogFocal = 1.0, kOpenCenterPx = 200.0,
                 kOpenK1 = 0.5;

bool AnyPosed(const StationState& state) {
  return std::any_of(
      state.cameras.begin(), state.cameras.end(), [](const auto& c) { return c.posed; });
}

void AddDrift(const StationOptions& o, StationState* state) {
  StationVector drift;
  drift << Eigen::Vector3d::Constant(o.drift_turn_rad), Eigen::Vector3d::Constant(o.drift_shift_m),
      o.drift_log_focal, o.drift_center_px, o.drift_center_px, o.drift_k1;
  for (std::size_t c = 0; c < state->cameras.size(); ++c) {
    const int at = kCam * static_cast<int>(c);
    auto diagonal = state->covariance.diagonal().segment<kCam>(at);
    if (state->cameras[c].posed) diagonal.head<6>() += drift.head<6>().cwiseAbs2();
    diagonal.tail<kLensSize>() += drift.tail<kLensSize>().cwiseAbs2();
  }
}

// The parameters, each place and lens of the state where it is known.
StationPrediction LayOut(const StationState& state,
                         const StationViews& views,
                         const CameraGroup& group,
                         const StationOptions& options) {
  const int cameras = static_cast<int>(state.cameras.size());
  const int n = static_cast<int>(group.views.size());
  StationPrediction out;
  std::vector<int> images(cameras, 0);
  for (const int v : group.views) {
    if (views[v] >= 0) ++images[views[v]];
  }
  for (const StationCamera& c : state.cameras) {
    out.cameras.push_back(c.camera);
    out.places.push_back(c.camera_from_rig);
  }
  int size = kCam * cameras;
  struct Block {
    int at;
    Eigen::VectorXd sigmas;
  };
  std::vector<Block> added;
  for (int i = 0; i < n; ++i) {
    const int c = views[group.views[i]];
    out.camera.push_back(c);
    const bool fixed = c >= 0 && !state.cameras[c].moving && images[c] == 1;
    out.was_posed.push_back(fixed && state.cameras[c].posed);
    out.learns_place.push_back(fixed);
    if (fixed) {
      out.place.push_back(c);
      out.place_at.push_back(kCam * c);
    } else {
      out.place.push_back(static_cast<int>(out.places.size()));
      out.places.push_back({});
      out.place_at.push_back(size);
      added.push_back({size, Eigen::VectorXd::Zero(6)});
      size += 6;
    }
    if (c >= 0) {
      out.lens_at.push_back(kCam * c + kLensAt);
    } else {
      out.lens_at.push_back(size);
      added.push_back({size, PopulationSigmas(group.cameras[i], options)});
      size += kLensSize;
    }
  }
  out.P = Eigen::MatrixXd::Zero(size, size);
  out.P.topLeftCorner(kCam * cameras, kCam * cameras) = state.covariance;
  for (const Block& b : added)
    out.P.diagonal().segment(b.at, b.sigmas.size()) = b.sigmas.cwiseAbs2();
  return out;
}

// Places of which nothing is known are taken from the evidence, seen from one that is.
void PlaceUnknown(const StationState& state, const CameraGroup& group, StationPrediction* out) {
  const int n = static_cast<int>(group.views.size());
  int known = -1;
  for (int i = 0; i < n && known < 0; ++i) {
    if (out->was_posed[i]) known = i;
  }
  const bool frame = known >= 0;
  if (!frame && !AnyPosed(state)) {  // the first fixed camera becomes the rig's frame
    for (int i = 0; i < n && known < 0; ++i) {
      if (out->learns_place[i]) known = i;
    }
  }
  if (known < 0) {  // of single images: any frame will do
    std::fill(out->learns_place.begin(), out->learns_place.end(), false);
    known = 0;
  }
  if (!frame && n > 0) out->places[out->place[known]] = Rigid3{};
  for (int i = 0; i < n; ++i) {
    if (i == known || out->was_posed[i]) continue;
    out->places[out->place[i]] = group.camera_from_anchor[i] *
                                 group.camera_from_anchor[known].Inverse() *
                                 out->places[out->place[known]];
    ClearRows(out->place_at[i], 6, &out->P);
    out->P.diagonal()
        .segment<3>(out->place_at[i])
        .setConstant(kUnknownTurnSigma * kUnknownTurnSigma);
    out->P.diagonal()
        .segment<3>(out->place_at[i] + 3)
        .setConstant(kUnknownShiftSigmaM * kUnknownShiftSigmaM);
  }
}

}  // namespace

void ForgetZooms(const StationOptions& options, StationState* state) {
  for (std::size_t c = 0; c < state->cameras.size(); ++c) {
    if (state->cameras[c].zooming) ForgetLens(static_cast<int>(c), options, state);
  }
}

StationState AtNextRequest(StationState state, const StationOptions& options) {
  AddDrift(options, &state);
  ForgetZooms(options, &state);
  return state;
}

Eigen::Vector4d PopulationSigmas(const PinholeCamera& camera, const StationOptions& o) {
  const double center = o.center_sigma * camera.width;
  return {o.focal_log_sigma, center, center, o.k1_sigma};
}

void ClearRows(int at, int count, Eigen::MatrixXd* P) {
  P->middleRows(at, count).setZero();
  P->middleCols(at, count).setZero();
}

void SetLensSigmas(int camera, const Eigen::Vector4d& sigmas, Eigen::MatrixXd* P) {
  ClearRows(kCam * camera + kLensAt, kLensSize, P);
  P->diagonal().segment<kLensSize>(kCam * camera + kLensAt) = sigmas.cwiseAbs2();
}

StationPrediction Predict(const StationState& state,
                          const StationViews& views,
                          const CameraGroup& group,
                          const StationOptions& options) {
  StationPrediction out = LayOut(state, views, group, options);
  PlaceUnknown(state, group, &out);
  return out;
}

std::vector<AdjustedView> ViewsOf(const StationPrediction& p, const CameraGroup& group) {
  const int last =
      group.views.empty() ? -1 : *std::max_element(group.views.begin(), group.views.end());
  std::vector<AdjustedView> out(last + 1);
  for (std::size_t i = 0; i < group.views.size(); ++i) {
    out[group.views[i]] = {
        true, p.camera[i] >= 0 ? p.cameras[p.camera[i]] : group.cameras[i], p.places[p.place[i]]};
  }
  return out;
}

Eigen::MatrixXd PredictionJacobian(const StationPrediction& p,
                                   const CameraGroup& group,
                                   const std::vector<AdjustedView>& views) {
  const Eigen::MatrixXd by_views = GroupJacobian(group, views);
  const int n = static_cast<int>(group.views.size());
  Eigen::MatrixXd J = Eigen::MatrixXd::Zero(kGroupParameters * n, p.P.rows());
  for (int i = 0; i < n; ++i) {
    J.middleCols<6>(p.place_at[i]) += by_views.middleCols<6>(kGroupParameters * i);
    J.middleCols<kLensSize>(p.lens_at[i]) +=
        by_views.middleCols<kLensSize>(kGroupParameters * i + 6);
  }
  return J;
}

Eigen::MatrixXd Closed(const CameraGroup& group, Eigen::MatrixXd information) {
  StationVector open;
  open << Eigen::Vector3d::Constant(kOpenTurn), Eigen::Vector3d::Constant(kOpenShiftM),
      kOpenLogFocal, kOpenCenterPx, kOpenCenterPx, kOpenK1;
  for (std::size_t i = 0; i < group.views.size(); ++i) {
    information.diagonal().segment<kGroupParameters>(kGroupParameters * static_cast<int>(i)) +=
        open.cwiseAbs2().cwiseInverse();
  }
  return information;
}

EquilibratedFactors::EquilibratedFactors(const Eigen::MatrixXd& A)
    : scale_(A.diagonal().cwiseSqrt().cwiseInverse()),
      factors_(scale_.asDiagonal() * A * scale_.asDiagonal()) {}

Eigen::VectorXd EquilibratedFactors::Solve(const Eigen::VectorXd& b) const {
  return scale_.cwiseProduct(factors_.solve(Eigen::VectorXd(scale_.cwiseProduct(b))));
}

Eigen::MatrixXd EquilibratedFactors::Inverse() const {
  const auto n = scale_.size();
  return scale_.asDiagonal() * factors_.solve(Eigen::MatrixXd::Identity(n, n)) *
         scale_.asDiagonal();
}

Eigen::VectorXd EquilibratedFactors::InverseDiagonal() const {
  const auto n = scale_.size();
  const Eigen::MatrixXd inverse = factors_.solve(Eigen::MatrixXd::Identity(n, n));
  return inverse.diagonal().cwiseProduct(scale_.cwiseAbs2());
}

}  // namespace horopter
