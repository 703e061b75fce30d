// The calls of StationService.
#include "absl/strings/str_cat.h"
#include "client/api_stubs.h"
#include "server/base/status_macros.h"

namespace horopter {
namespace {

std::string StationNameOf(const std::string& id) {
  return absl::StrCat("stations/", id);
}

}  // namespace

absl::StatusOr<v1::Station> HoropterClient::GetStation(const std::string& id) {
  v1::GetStationRequest request;
  request.set_name(StationNameOf(id));
  v1::Station response;
  HOROPTER_RETURN_IF_ERROR(Call([&](grpc::ClientContext* context, Done done) {
    stubs_->stations->async()->GetStation(context, &request, &response, std::move(done));
  }));
  return response;
}

absl::StatusOr<std::vector<v1::Station>> HoropterClient::ListStations() {
  std::vector<v1::Station> stations;
  v1::ListStationsRequest request;
  request.set_page_size(kPageSize);
  do {
    v1::ListStationsResponse response;
    HOROPTER_RETURN_IF_ERROR(Call([&](grpc::ClientContext* context, Done done) {
      stubs_->stations->async()->ListStations(context, &request, &response, std::move(done));
    }));
    for (v1::Station& s : *response.mutable_stations()) stations.push_back(std::move(s));
    request.set_page_token(response.next_page_token());
  } while (!request.page_token().empty());
  return stations;
}

absl::StatusOr<v1::Station> HoropterClient::UpdateStation(const v1::UpdateStationRequest& request) {
  v1::Station response;
  HOROPTER_RETURN_IF_ERROR(Call([&](grpc::ClientContext* context, Done done) {
    stubs_->stations->async()->UpdateStation(context, &request, &response, std::move(done));
  }));
  return response;
}

absl::Status HoropterClient::DeleteStation(const std::string& id) {
  v1::DeleteStationRequest request;
  request.set_name(StationNameOf(id));
  google::protobuf::Empty response;
  return Call([&](grpc::ClientContext* context, Done done) {
    stubs_->stations->async()->DeleteStation(context, &request, &response, std::move(done));
  });
}

absl::StatusOr<v1::Station> HoropterClient::ResetStation(const std::string& name, bool keep_base) {
  v1::ResetStationRequest request;
  request.set_keep_base(keep_base);
  request.set_name(name);
  v1::Station response;
  HOROPTER_RETURN_IF_ERROR(Call([&](grpc::ClientContext* context, Done done) {
    stubs_->stations->async()->ResetStation(context, &request, &response, std::move(done));
  }));
  return response;
}

absl::StatusOr<v1::Station> HoropterClient::ImportCalibration(
    const std::string& camera_name, const v1::CameraCalibration& calibration) {
  v1::ImportCalibrationRequest request;
  request.set_name(camera_name);
  *request.mutable_calibration() = calibration;
  v1::Station response;
  HOROPTER_RETURN_IF_ERROR(Call([&](grpc::ClientContext* context, Done done) {
    stubs_->stations->async()->ImportCalibration(context, &request, &response, std::move(done));
  }));
  return response;
}

absl::StatusOr<v1::CameraCalibration> HoropterClient::ExportCalibration(
    const std::string& camera_name) {
  v1::ExportCalibrationRequest request;
  request.set_name(camera_name);
  v1::CameraCalibration response;
  HOROPTER_RETURN_IF_ERROR(Call([&](grpc::ClientContext* context, Done done) {
    stubs_->stations->async()->ExportCalibration(context, &request, &response, std::move(done));
  }));
  return response;
}

}  // namespace horopter
