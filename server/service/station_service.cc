#include "server/service/station_service.h"

#include <algorithm>
#include <utility>

#include "absl/strings/str_cat.h"
#include "google/protobuf/empty.pb.h"
#include "server/base/status_macros.h"
#include "server/service/convert.h"
#include "server/service/page_sizes.h"
#include "server/service/rpc_status.h"
#include "server/service/station_convert.h"
#include "server/vision/geometry/station_blob.h"

namespace horopter {
namespace {

constexpr std::size_t kMaxNameBytes = 200;
constexpr std::string_view kStationTokenPrefix = "s1.";

absl::Status CheckStationEtag(const std::string& if_match, const StationRecord& record) {
  if (if_match.empty() || if_match == EtagOf(record)) return absl::OkStatus();
  return FieldError(absl::StatusCode::kAborted,
                    "if_match",
                    absl::StrCat("the station has etag ", EtagOf(record)));
}

absl::StatusOr<std::string> LastStationOf(const std::string& token) {
  if (token.empty()) return std::string();
  const std::string id = token.substr(std::min(kStationTokenPrefix.size(), token.size()));
  if (token.substr(0, kStationTokenPrefix.size()) != kStationTokenPrefix || !IsStationId(id))
    return InvalidField("page_token", "not a token of this method");
  return id;
}

absl::Status NotThere(const std::string& id) {
  return FieldError(
      absl::StatusCode::kNotFound, "name", absl::StrCat("'", StationName(id), "' is not known"));
}

int CameraIndex(const StationState& state, const std::string& id) {
  const auto at = std::find_if(
      state.cameras.begin(), state.cameras.end(), [&](const auto& c) { return c.id == id; });
  return at == state.cameras.end() ? -1 : static_cast<int>(at - state.cameras.begin());
}

// A camera of which not even the size of its images is known.
constexpr int kUnknownSide = 1;

absl::StatusOr<int> CameraOf(const std::string& id, const std::string& field, StationState* state) {
  if (const int c = CameraIndex(*state, id); c >= 0) return c;
  if (static_cast<int>(state->cameras.size()) >= kMostStationCameras)
    return InvalidField(field, absl::StrCat("more than ", kMostStationCameras, " cameras"));
  return AddStationCamera(id, kUnknownSide, kUnknownSide, {}, state);
}

// What requests taught of a camera; where people say that it is in the robot's base stays.
void ForgetLearnt(int camera, bool keep_base, StationRecord* record) {
  ForgetLens(camera, {}, &record->state);
  ForgetPlace(camera, &record->state);
  const auto base = record->bases.find(record->state.cameras[camera].id);
  if (!keep_base && base != record->bases.end() && base->second.learnt) record->bases.erase(base);
}

struct WrittenFields {
  bool display_name = false;
  bool cameras = false;
};

absl::StatusOr<WrittenFields> FieldsOf(const v1::UpdateStationRequest& request) {
  WrittenFields out;
  if (!request.has_update_mask() || request.update_mask().paths_size() == 0) {
    out.display_name = !request.station().display_name().empty();
    out.cameras = request.station().cameras_size() > 0;
    return out;
  }
  for (const std::string& path : request.update_mask().paths()) {
    if (path == "display_name") {
      out.display_name = true;
    } else if (path == "cameras") {
      out.cameras = true;
    } else {
      return InvalidField("update_mask", absl::StrCat("'", path, "' cannot be written"));
    }
  }
  return out;
}

// What people say of a camera.
absl::Status WriteCamera(const v1::StationCamera& in,
                         const std::string& field,
                         StationRecord* record) {
  HOROPTER_ASSIGN_OR_RETURN(const StationCameraId name,
                            StationCameraFromName(in.name(), field + ".name"));
  if (name.station != record->id) return InvalidField(field + ".name", "of another station");
  if (!v1::StationCamera::Motion_IsValid(in.motion()))
    return InvalidField(field + ".motion", "unknown value");
  HOROPTER_ASSIGN_OR_RETURN(const int c, CameraOf(name.camera, field, &record->state));
  StationCamera& camera = record->state.cameras[c];
  if (in.motion() != v1::StationCamera::MOTION_UNSPECIFIED) {
    camera.moving = in.motion() == v1::StationCamera::MOTION_MOVING;
    camera.zooming = in.motion() == v1::StationCamera::MOTION_ZOOMING;
    if (camera.moving) ForgetPlace(c, &record->state);
    if (camera.zooming) ForgetLens(c, {}, &record->state);
  }
  if (!in.has_base_from_camera()) {
    if (in.has_base_rotation_sigma_rad() || in.has_base_position_sigma_m())
      return InvalidField(field + ".base_from_camera", "missing; its deviations are set");
    return absl::OkStatus();
  }
  HOROPTER_ASSIGN_OR_RETURN(record->bases[name.camera], BaseFromProto(in, field));
  return absl::OkStatus();
}

absl::Status Answer(Catalog& catalog, const StationRecord& record, v1::Station* response) {
  HOROPTER_ASSIGN_OR_RETURN(const auto events, catalog.StationEvents(record.id));
  StationToProto(record, events, response);
  return absl::OkStatus();
}

absl::Status Update(Catalog& catalog,
                    const v1::UpdateStationRequest& request,
                    v1::Station* response) {
  HOROPTER_ASSIGN_OR_RETURN(const std::string id,
                            StationIdFromName(request.station().name(), "station.name"));
  HOROPTER_ASSIGN_OR_RETURN(const WrittenFields fields, FieldsOf(request));
  if (request.station().display_name().size() > kMaxNameBytes)
    return InvalidField("station.display_name", "longer than 200 bytes");
  const auto change = [&](const StationRecord* current,
                          std::vector<StationEventRecord>*) -> absl::StatusOr<StationRecord> {
    StationRecord next;
    if (current != nullptr) {
      HOROPTER_RETURN_IF_ERROR(CheckStationEtag(request.if_match(), *current));
      next = *current;
    } else if (!request.allow_missing() || !request.if_match().empty()) {
      return NotThere(id);
    } else {
      next.id = id;
      next.create_time = StationTime();
    }
    next.update_time = StationTime();
    if (fields.display_name) next.display_name = request.station().display_name();
    for (int i = 0; fields.cameras && i < request.station().cameras_size(); ++i) {
      HOROPTER_RETURN_IF_ERROR(WriteCamera(
          request.station().cameras(i), absl::StrCat("station.cameras[", i, "]"), &next));
    }
    return next;
  };
  HOROPTER_ASSIGN_OR_RETURN(const StationRecord written, catalog.WriteStation(id, change));
  return Answer(catalog, written, response);
}

absl::Status Reset(Catalog& catalog,
                   const v1::ResetStationRequest& request,
                   v1::Station* response) {
  StationCameraId name;
  if (absl::StatusOr<std::string> id = StationIdFromName(request.name(), "name"); id.ok()) {
    name.station = *id;
  } else {
    HOROPTER_ASSIGN_OR_RETURN(name, StationCameraFromName(request.name(), "name"));
  }
  const auto change =
      [&](const StationRecord* current,
          std::vector<StationEventRecord>* events) -> absl::StatusOr<StationRecord> {
    if (current == nullptr) return NotThere(name.station);
    HOROPTER_RETURN_IF_ERROR(CheckStationEtag(request.if_match(), *current));
    StationRecord next = *current;
    next.update_time = StationTime();
    events->push_back({v1::StationEvent::KIND_RESET, next.update_time, "", {}, "reset by hand"});
    if (!name.camera.empty()) {
      const int c = CameraIndex(next.state, name.camera);
      if (c < 0) return NotThere(name.station + "/cameras/" + name.camera);
      ForgetLearnt(c, request.keep_base(), &next);
      events->back().camera_ids.push_back(name.camera);
      return next;
    }
    next.state.requests = 0;
    next.agreed_request_id.clear();
    next.agreed_time.clear();
    for (size_t c = 0; c < next.state.cameras.size(); ++c) {
      ForgetLearnt(static_cast<int>(c), request.keep_base(), &next);
      events->back().camera_ids.push_back(next.state.cameras[c].id);
    }
    return next;
  };
  HOROPTER_ASSIGN_OR_RETURN(const StationRecord written,
                            catalog.WriteStation(name.station, change));
  return Answer(catalog, written, response);
}

absl::Status Import(Catalog& catalog,
                    const v1::ImportCalibrationRequest& request,
                    v1::Station* response) {
  HOROPTER_ASSIGN_OR_RETURN(const StationCameraId name,
                            StationCameraFromName(request.name(), "name"));
  if (!request.has_calibration()) return InvalidField("calibration", "missing");
  HOROPTER_ASSIGN_OR_RETURN(const KnownLens lens,
                            LensFromCalibration(request.calibration(), "calibration"));
  const auto change =
      [&](const StationRecord* current,
          std::vector<StationEventRecord>* events) -> absl::StatusOr<StationRecord> {
    if (current == nullptr) return NotThere(name.station);
    HOROPTER_RETURN_IF_ERROR(CheckStationEtag(request.if_match(), *current));
    StationRecord next = *current;
    next.update_time = StationTime();
    HOROPTER_ASSIGN_OR_RETURN(const int c, CameraOf(name.camera, "name", &next.state));
    SetLens(c, lens, &next.state);
    // Says, as a request would, that something is known.
    next.state.cameras[c].requests = std::max<std::int64_t>(1, next.state.cameras[c].requests);
    events->push_back({v1::StationEvent::KIND_CALIBRATION_IMPORTED,
                       next.update_time,
                       "",
                       {name.camera},
                       "calibration imported"});
    return next;
  };
  HOROPTER_ASSIGN_OR_RETURN(const StationRecord written,
                            catalog.WriteStation(name.station, change));
  return Answer(catalog, written, response);
}

absl::Status Export(Catalog& catalog,
                    const v1::ExportCalibrationRequest& request,
                    v1::CameraCalibration* response) {
  HOROPTER_ASSIGN_OR_RETURN(const StationCameraId name,
                            StationCameraFromName(request.name(), "name"));
  HOROPTER_ASSIGN_OR_RETURN(const StationRecord record, catalog.GetStation(name.station));
  const int c = CameraIndex(record.state, name.camera);
  if (c < 0) return NotThere(name.station + "/cameras/" + name.camera);
  if (record.state.cameras[c].requests == 0)
    return absl::FailedPreconditionError("nothing is known of the camera yet");
  CalibrationToProto(record.state, c, response);
  return absl::OkStatus();
}

absl::Status List(Catalog& catalog,
                  const v1::ListStationsRequest& request,
                  v1::ListStationsResponse* response) {
  if (request.page_size() < 0) return InvalidField("page_size", "negative");
  HOROPTER_ASSIGN_OR_RETURN(const std::string after, LastStationOf(request.page_token()));
  const int page =
      request.page_size() == 0 ? kDefaultPageSize : std::min(request.page_size(), kMaxPageSize);
  HOROPTER_ASSIGN_OR_RETURN(std::vector<StationRecord> found,
                            catalog.ListStations(after, page + 1));
  const bool more = static_cast<int>(found.size()) > page;
  if (more) found.pop_back();
  for (const StationRecord& record : found) StationToProto(record, {}, response->add_stations());
  if (more) {
    response->set_next_page_token(absl::StrCat(std::string(kStationTokenPrefix), found.back().id));
  }
  return absl::OkStatus();
}

}  // namespace

grpc::ServerUnaryReactor* StationService::GetStation(grpc::CallbackServerContext* context,
                                                     const grpc::ByteBuffer* bytes,
                                                     grpc::ByteBuffer* answer) {
  return RunUnaryCall<v1::GetStationRequest, v1::Station>(
      gate_,
      context,
      bytes,
      answer,
      {{.name = "GetStation", .needs = Role::kRobot},
       [this](const v1::GetStationRequest& request, const CallInfo&, v1::Station* response)
           -> absl::Status {
         HOROPTER_ASSIGN_OR_RETURN(const std::string id, StationIdFromName(request.name(), "name"));
         HOROPTER_ASSIGN_OR_RETURN(const StationRecord record, catalog_.GetStation(id));
         return Answer(catalog_, record, response);
       }});
}

grpc::ServerUnaryReactor* StationService::ListStations(grpc::CallbackServerContext* context,
                                                       const grpc::ByteBuffer* bytes,
                                                       grpc::ByteBuffer* answer) {
  return RunUnaryCall<v1::ListStationsRequest, v1::ListStationsResponse>(
      gate_,
      context,
      bytes,
      answer,
      {{.name = "ListStations", .needs = Role::kRobot},
       [this](const auto& request, const CallInfo&, auto* response) {
         return List(catalog_, request, response);
       }});
}

grpc::ServerUnaryReactor* StationService::UpdateStation(grpc::CallbackServerContext* context,
                                                        const grpc::ByteBuffer* bytes,
                                                        grpc::ByteBuffer* answer) {
  return RunUnaryCall<v1::UpdateStationRequest, v1::Station>(
      gate_,
      context,
      bytes,
      answer,
      {{.name = "UpdateStation"}, [this](const auto& request, const CallInfo&, auto* response) {
         return Update(catalog_, request, response);
       }});
}

grpc::ServerUnaryReactor* StationService::DeleteStation(grpc::CallbackServerContext* context,
                                                        const grpc::ByteBuffer* bytes,
                                                        grpc::ByteBuffer* answer) {
  return RunUnaryCall<v1::DeleteStationRequest, google::protobuf::Empty>(
      gate_,
      context,
      bytes,
      answer,
      {{.name = "DeleteStation"},
       [this](const v1::DeleteStationRequest& request, const CallInfo&, google::protobuf::Empty*)
           -> absl::Status {
         HOROPTER_ASSIGN_OR_RETURN(const std::string id, StationIdFromName(request.name(), "name"));
         if (request.if_match().empty()) return catalog_.DeleteStation(id);
         return catalog_.DeleteStation(id, [&](const StationRecord& current) {
           return CheckStationEtag(request.if_match(), current);
         });
       }});
}

grpc::ServerUnaryReactor* StationService::ResetStation(grpc::CallbackServerContext* context,
                                                       const grpc::ByteBuffer* bytes,
                                                       grpc::ByteBuffer* answer) {
  return RunUnaryCall<v1::ResetStationRequest, v1::Station>(
      gate_,
      context,
      bytes,
      answer,
      {{.name = "ResetStation"}, [this](const auto& request, const CallInfo&, auto* response) {
         return Reset(catalog_, request, response);
       }});
}

grpc::ServerUnaryReactor* StationService::ImportCalibration(grpc::CallbackServerContext* context,
                                                            const grpc::ByteBuffer* bytes,
                                                            grpc::ByteBuffer* answer) {
  return RunUnaryCall<v1::ImportCalibrationRequest, v1::Station>(
      gate_,
      context,
      bytes,
      answer,
      {{.name = "ImportCalibration"}, [this](const auto& request, const CallInfo&, auto* response) {
         return Import(catalog_, request, response);
       }});
}

grpc::ServerUnaryReactor* StationService::ExportCalibration(grpc::CallbackServerContext* context,
                                                            const grpc::ByteBuffer* bytes,
                                                            grpc::ByteBuffer* answer) {
  return RunUnaryCall<v1::ExportCalibrationRequest, v1::CameraCalibration>(
      gate_,
      context,
      bytes,
      answer,
      {{.name = "ExportCalibration", .needs = Role::kRobot},
       [this](const auto& request, const CallInfo&, auto* response) {
         return Export(catalog_, request, response);
       }});
}

}  // namespace horopter
