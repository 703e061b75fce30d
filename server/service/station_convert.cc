#include "server/service/station_convert.h"

#include <google/protobuf/util/time_util.h>

#include <algorithm>
#include <array>
#include <cmath>

#include "absl/strings/str_cat.h"
#include "horopter/v1/station.pb.h"
#include "horopter/v1/types.pb.h"
#include "server/base/status_macros.h"
#include "server/service/convert.h"
#include "server/service/hint_convert.h"
#include "server/service/rpc_status.h"
#include "server/vision/geometry/intrinsics_check.h"

namespace horopter {
namespace {

constexpr int kMostPixels = 100'000;
constexpr double kMostAspect = 1.01;  // of fx and fy
constexpr double kMostDistortion = 10.0;

void TimeToProto(const std::string& time, google::protobuf::Timestamp* proto) {
  if (!time.empty()) google::protobuf::util::TimeUtil::FromString(time, proto);
}

absl::Status CheckSigma(bool set, double value, double most, const std::string& field) {
  if (!set || (value > 0.0 && value <= most)) return absl::OkStatus();
  return InvalidField(field, absl::StrCat(value, " is outside 0..", most));
}

}  // namespace

void CalibrationToProto(const StationState& state, int camera, v1::CameraCalibration* proto) {
  const PinholeCamera& c = state.cameras[camera].camera;
  const StationDeviations d = DeviationsOf(state, camera);
  proto->set_image_width_px(c.width);
  proto->set_image_height_px(c.height);
  for (const double k : {c.focal_px, 0.0, c.cx, 0.0, c.focal_px, c.cy, 0.0, 0.0, 1.0})
    proto->add_k(k);
  for (const double k : {c.k1, 0.0, 0.0, 0.0, 0.0}) proto->add_d(k);
  proto->set_focal_log_sigma(d.log_focal);
  proto->set_principal_point_sigma_px(d.center_px);
  proto->set_k1_sigma(d.k1);
}

absl::StatusOr<KnownLens> LensFromCalibration(const v1::CameraCalibration& proto,
                                              const std::string& field) {
  KnownLens lens;
  PinholeCamera& c = lens.camera;
  c.width = proto.image_width_px();
  c.height = proto.image_height_px();
  for (const auto& [size, name] :
       {std::pair{c.width, ".image_width_px"}, std::pair{c.height, ".image_height_px"}}) {
    if (size < 1 || size > kMostPixels)
      return InvalidField(field + name, absl::StrCat(size, " is outside 1..", kMostPixels));
  }
  if (proto.k_size() != 9) return InvalidField(field + ".k", "9 numbers are needed");
  std::array<double, 9> K;
  std::copy(proto.k().begin(), proto.k().end(), K.begin());
  if (const auto fault = FaultOfCameraMatrix(K)) return InvalidField(field + ".k", *fault);
  if (K[1] != 0.0) return InvalidField(field + ".k", "skew: not fx 0 cx, 0 fy cy, 0 0 1");
  if (!(K[0] / K[4] < kMostAspect && K[4] / K[0] < kMostAspect))
    return InvalidField(field + ".k", "pixels are not square");
  c.focal_px = std::sqrt(K[0] * K[4]);
  c.cx = K[2];
  c.cy = K[5];
  for (int i = 0; i < proto.d_size(); ++i) {
    const std::string at = absl::StrCat(field, ".d[", i, "]");
    if (!(std::abs(proto.d(i)) <= kMostDistortion)) return InvalidField(at, "out of range");
    if (i > 0 && proto.d(i) != 0.0)
      return InvalidField(at, "a lens beyond k1 is given with each image (camera_hint)");
  }
  if (proto.d_size() > 0) c.k1 = proto.d(0);
  LensModel model;
  model.fx = model.fy = c.focal_px;
  model.cx = c.cx;
  model.cy = c.cy;
  model.coefficients[0] = c.k1;
  if (const auto fault = FaultOfLens(model, c.width, c.height, false)) {
    return InvalidField(field + (fault->part == LensPart::kCoefficients ? ".d" : ".k"),
                        fault->detail);
  }
  HOROPTER_RETURN_IF_ERROR(CheckSigma(
      proto.has_focal_log_sigma(), proto.focal_log_sigma(), 2.0, field + ".focal_log_sigma"));
  HOROPTER_RETURN_IF_ERROR(CheckSigma(proto.has_principal_point_sigma_px(),
                                      proto.principal_point_sigma_px(),
                                      kMostPixels,
                                      field + ".principal_point_sigma_px"));
  HOROPTER_RETURN_IF_ERROR(
      CheckSigma(proto.has_k1_sigma(), proto.k1_sigma(), 1.0, field + ".k1_sigma"));
  lens.focal_log_sigma = proto.has_focal_log_sigma() ? proto.focal_log_sigma() : 0.003;
  lens.center_sigma_px =
      proto.has_principal_point_sigma_px() ? proto.principal_point_sigma_px() : 2.0;
  lens.k1_sigma = proto.has_k1_sigma() ? proto.k1_sigma() : 0.005;
  return lens;
}

namespace {

void BaseToProto(const CameraBase& base, v1::StationCamera* proto) {
  RigidToProto(base.base_from_camera, proto->mutable_base_from_camera());
  proto->set_base_source(base.learnt ? v1::StationCamera::BASE_SOURCE_LEARNT
                                     : v1::StationCamera::BASE_SOURCE_GIVEN);
  proto->set_base_rotation_sigma_rad(base.rotation_sigma_rad);
  proto->set_base_position_sigma_m(base.position_sigma_m);
  proto->set_base_request_count(base.requests);
}

}  // namespace

absl::StatusOr<CameraBase> BaseFromProto(const v1::StationCamera& proto, const std::string& field) {
  CameraBase base;
  HOROPTER_ASSIGN_OR_RETURN(base.base_from_camera,
                            RigidFromProto(proto.base_from_camera(), field + ".base_from_camera"));
  HOROPTER_RETURN_IF_ERROR(CheckSigma(proto.has_base_rotation_sigma_rad(),
                                      proto.base_rotation_sigma_rad(),
                                      kMaxRotationSigmaRad,
                                      field + ".base_rotation_sigma_rad"));
  HOROPTER_RETURN_IF_ERROR(CheckSigma(proto.has_base_position_sigma_m(),
                                      proto.base_position_sigma_m(),
                                      kMaxPositionSigmaM,
                                      field + ".base_position_sigma_m"));
  if (proto.has_base_rotation_sigma_rad())
    base.rotation_sigma_rad = proto.base_rotation_sigma_rad();
  if (proto.has_base_position_sigma_m()) base.position_sigma_m = proto.base_position_sigma_m();
  return base;
}

void StationToProto(const StationRecord& record,
                    const std::vector<StationEventRecord>& events,
                    v1::Station* proto) {
  proto->set_name(StationName(record.id));
  proto->set_display_name(record.display_name);
  TimeToProto(record.create_time, proto->mutable_create_time());
  TimeToProto(record.update_time, proto->mutable_update_time());
  for (size_t c = 0; c < record.state.cameras.size(); ++c) {
    const StationCamera& camera = record.state.cameras[c];
    v1::StationCamera* out = proto->add_cameras();
    out->set_name(StationCameraName(record.id, camera.id));
    out->set_motion(camera.moving    ? v1::StationCamera::MOTION_MOVING
                    : camera.zooming ? v1::StationCamera::MOTION_ZOOMING
                                     : v1::StationCamera::MOTION_FIXED);
    if (const auto base = record.bases.find(camera.id); base != record.bases.end())
      BaseToProto(base->second, out);
    out->set_request_count(camera.requests);
    if (camera.camera.width > 1) {
      CalibrationToProto(record.state, static_cast<int>(c), out->mutable_calibration());
    }
    if (!camera.posed) continue;
    const StationDeviations d = DeviationsOf(record.state, static_cast<int>(c));
    RigidToProto(camera.camera_from_rig, out->mutable_camera_from_rig());
    out->set_rotation_sigma_rad(d.turn_rad);
    out->set_translation_sigma_m(d.shift_m);
  }
  proto->set_request_count(record.state.requests);
  proto->set_etag(EtagOf(record));
  for (const StationEventRecord& event : events) {
    v1::StationEvent* out = proto->add_events();
    out->set_kind(static_cast<v1::StationEvent::Kind>(event.kind));
    TimeToProto(event.time, out->mutable_time());
    out->set_request_id(event.request_id);
    for (const std::string& camera : event.camera_ids)
      out->add_cameras(StationCameraName(record.id, camera));
    out->set_detail(event.detail);
  }
}

void StationReportToProto(const StationStart& start,
                          const StationOutcome& outcome,
                          bool learnt,
                          v1::StationReport* proto) {
  proto->set_station(StationName(start.id));
  proto->set_prior_used(outcome.prior_used);
  proto->set_learnt(learnt);
  proto->set_read_only(!start.learns);
  if (std::isfinite(outcome.test.limit) && outcome.test.limit > 0.0) {
    proto->set_distance_squared(outcome.test.squared);
    proto->set_distance_limit(outcome.test.limit);
  }
  const auto add = [&](int kind) {
    v1::StationFinding* finding = proto->add_findings();
    finding->set_kind(static_cast<v1::StationFinding::Kind>(kind));
    finding->set_last_agreeing_request_id(start.agreed_request_id);
    if (!start.agreed_time.empty())
      TimeToProto(start.agreed_time, finding->mutable_last_agreeing_time());
    return finding;
  };
  for (const std::string& camera : start.resized) {
    v1::StationFinding* finding = add(v1::StationFinding::KIND_IMAGE_SIZE_CHANGED);
    finding->add_cameras(StationCameraName(start.id, camera));
    finding->set_detail(
        absl::StrCat("images of camera ", camera, " have another size than before"));
  }
  for (const StationChange& change : outcome.test.changes) {
    v1::StationFinding* finding = add(KindOf(change));
    for (const int c : change.cameras)
      finding->add_cameras(StationCameraName(start.id, start.request.state.cameras[c].id));
    finding->set_rotation_rad(change.turn_rad);
    finding->set_translation_m(change.shift_m);
    finding->set_focal_log_ratio(change.log_focal);
    finding->set_principal_point_x_shift_px(change.center_px.x());
    finding->set_principal_point_y_shift_px(change.center_px.y());
    finding->set_k1_change(change.k1);
    finding->set_detail(DescribeChange(start.request.state, change));
  }
  if (const auto moved = BaseMoved(start.request, outcome, StationOptions())) {
    v1::StationFinding* finding = add(v1::StationFinding::KIND_BASE_MOVED);
    for (const int c : moved->cameras)
      finding->add_cameras(StationCameraName(start.id, start.request.state.cameras[c].id));
    finding->set_rotation_rad(moved->turn_rad);
    finding->set_translation_m(moved->shift_m);
    finding->set_detail(DescribeBaseChange(*moved));
  }
}

}  // namespace horopter
