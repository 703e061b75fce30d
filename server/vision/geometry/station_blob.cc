#include "server/vision/geometry/station_blob.h"

#include <algorithm>
#include <cmath>

#include "server/base/checked_blob.h"
#include "server/base/status_macros.h"

namespace horopter {
namespace {

constexpr std::string_view kMagic = "HSTA";                    // first bytes of the blob
constexpr int kVersion = 1;                                    // of the blob's layout
constexpr std::uint8_t kMoving = 1, kZooming = 2, kPosed = 4;  // bits of a camera's flags
constexpr double kRotationTolerance = 1e-6;  // largest entry of R R' - I; doubles were stored
constexpr int kMostPixels = 100'000;         // of a side; more is damage

bool IsCamera(const StationCamera& c) {
  const PinholeCamera& p = c.camera;
  return IsStationId(c.id) && p.width > 0 && p.width <= kMostPixels && p.height > 0 &&
         p.height <= kMostPixels && p.focal_px > 0.0 && std::isfinite(p.focal_px) &&
         std::isfinite(p.cx) && std::isfinite(p.cy) && std::isfinite(p.k1) &&
         c.camera_from_rig.t.allFinite() && c.requests >= 0 &&
         (c.camera_from_rig.R * c.camera_from_rig.R.transpose() - Eigen::Matrix3d::Identity())
                 .cwiseAbs()
                 .maxCoeff() <= kRotationTolerance;
}

StationCamera TakeCamera(BlobReader* in) {
  StationCamera c;
  c.id = std::string(in->TakeBytes(in->Take<std::uint8_t>()));
  const auto flags = in->Take<std::uint8_t>();
  c.moving = (flags & kMoving) != 0;
  c.zooming = (flags & kZooming) != 0;
  c.posed = (flags & kPosed) != 0;
  c.camera.width = in->Take<std::int32_t>();
  c.camera.height = in->Take<std::int32_t>();
  for (double* value : {&c.camera.focal_px, &c.camera.cx, &c.camera.cy, &c.camera.k1})
    *value = in->Take<double>();
  for (int i = 0; i < 9; ++i) c.camera_from_rig.R(i / 3, i % 3) = in->Take<double>();
  for (int i = 0; i < 3; ++i) c.camera_from_rig.t(i) = in->Take<double>();
  c.requests = in->Take<std::int64_t>();
  return c;
}

}  // namespace

bool IsStationId(std::string_view id) {
  return !id.empty() && id.size() <= 63 && std::all_of(id.begin(), id.end(), [](char c) {
    return (c >= 'a' && c <= 'z') || (c >= '0' && c <= '9') || c == '_' || c == '-';
  });
}

std::string EncodeStationState(const StationState& state) {
  std::string body;
  AppendNumber(body, state.requests);
  AppendNumber(body, static_cast<std::uint32_t>(state.cameras.size()));
  for (const StationCamera& c : state.cameras) {
    AppendNumber(body, static_cast<std::uint8_t>(c.id.size()));
    body += c.id;
    AppendNumber(body,
                 static_cast<std::uint8_t>((c.moving ? kMoving : 0) | (c.zooming ? kZooming : 0) |
                                           (c.posed ? kPosed : 0)));
    AppendNumber(body, static_cast<std::int32_t>(c.camera.width));
    AppendNumber(body, static_cast<std::int32_t>(c.camera.height));
    for (const double value : {c.camera.focal_px, c.camera.cx, c.camera.cy, c.camera.k1})
      AppendNumber(body, value);
    for (int i = 0; i < 9; ++i) AppendNumber(body, c.camera_from_rig.R(i / 3, i % 3));
    for (int i = 0; i < 3; ++i) AppendNumber(body, c.camera_from_rig.t(i));
    AppendNumber(body, c.requests);
  }
  for (Eigen::Index i = 0; i < state.covariance.rows(); ++i) {
    for (Eigen::Index j = 0; j <= i; ++j) AppendNumber(body, state.covariance(i, j));
  }
  return WithBlobHeader(kMagic, kVersion, 0, body);
}

absl::StatusOr<StationState> DecodeStationState(std::string_view bytes) {
  HOROPTER_RETURN_IF_ERROR(TakeBlobHeader("station state", kMagic, kVersion, &bytes).status());
  BlobReader in(bytes);
  StationState state;
  state.requests = in.Take<std::int64_t>();
  const auto cameras = in.Take<std::uint32_t>();
  if (cameras > kMostStationCameras || state.requests < 0)
    return absl::DataLossError("station state: no state has these numbers");
  for (std::uint32_t i = 0; i < cameras && in.ok(); ++i) state.cameras.push_back(TakeCamera(&in));
  const int n = kStationCameraParameters * static_cast<int>(cameras);
  state.covariance = Eigen::MatrixXd::Zero(n, n);
  for (int i = 0; i < n && in.ok(); ++i) {
    for (int j = 0; j <= i; ++j)
      state.covariance(i, j) = state.covariance(j, i) = in.Take<double>();
  }
  if (!in.ok() || in.left() > 0) return absl::DataLossError("station state: of a wrong length");
  // A lens is always known to some degree, and a covariance has no negative variance.
  bool valid = state.covariance.allFinite() &&
               std::all_of(state.cameras.begin(), state.cameras.end(), IsCamera);
  for (int i = 0; i < n && valid; ++i) {
    const bool lens = i % kStationCameraParameters >= kStationIntrinsics;
    valid = lens ? state.covariance(i, i) > 0.0 : state.covariance(i, i) >= 0.0;
  }
  if (!valid) return absl::DataLossError("station state: no state has these numbers");
  return state;
}

}  // namespace horopter
