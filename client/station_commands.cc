#include <google/protobuf/util/json_util.h>
#include <google/protobuf/util/time_util.h>

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <cstdio>
#include <nlohmann/json.hpp>

#include "absl/strings/numbers.h"
#include "absl/strings/str_cat.h"
#include "absl/strings/str_format.h"
#include "client/bop_results.h"
#include "client/camera_file.h"
#include "client/commands.h"
#include "client/convert.h"
#include "client/output.h"
#include "client/scene_request.h"
#include "server/base/status_macros.h"

namespace horopter {
namespace {

std::string CameraName(const std::string& id, const std::string& camera) {
  return absl::StrCat("stations/", id, "/cameras/", camera);
}

std::string LastPart(const std::string& name) {
  return name.substr(name.rfind('/') + 1);
}

const char* MotionOf(const v1::StationCamera& camera) {
  switch (camera.motion()) {
    case v1::StationCamera::MOTION_MOVING:
      return "moving";
    case v1::StationCamera::MOTION_ZOOMING:
      return "zooming";
    default:
      return "fixed";
  }
}

std::string BaseText(const v1::StationCamera& camera) {
  const v1::Vector3& t = camera.base_from_camera().translation_m();
  const bool learnt = camera.base_source() == v1::StationCamera::BASE_SOURCE_LEARNT;
  return absl::StrFormat(
      "in the robot base, %s: %.4f %.4f %.4f m (%.2f mm, %.3f degrees)",
      learnt ? absl::StrCat("learnt from ", camera.base_request_count(), " requests") : "given",
      t.x(),
      t.y(),
      t.z(),
      1000.0 * camera.base_position_sigma_m(),
      180.0 / M_PI * camera.base_rotation_sigma_rad());
}

void SayCamera(const v1::StationCamera& camera) {
  constexpr double kDegrees = 180.0 / M_PI;
  Say("camera %s: %s, %lld requests\n",
      LastPart(camera.name()).c_str(),
      MotionOf(camera),
      static_cast<long long>(camera.request_count()));
  if (camera.has_base_from_camera()) Say("  %s\n", BaseText(camera).c_str());
  if (!camera.has_calibration()) return Say("  nothing is known yet\n");
  const v1::CameraCalibration& c = camera.calibration();
  Say("  images %d x %d; focal length %.2f px (%.2f %%), principal point %.2f %.2f px (%.2f px), "
      "k1 %.4f (%.4f)\n",
      c.image_width_px(),
      c.image_height_px(),
      c.k(0),
      100.0 * c.focal_log_sigma(),
      c.k(2),
      c.k(5),
      c.principal_point_sigma_px(),
      c.d(0),
      c.k1_sigma());
  if (!camera.has_camera_from_rig()) return;
  const v1::Vector3& t = camera.camera_from_rig().translation_m();
  Say("  in the rig: %.4f %.4f %.4f m (%.2f mm, %.3f degrees)\n",
      t.x(),
      t.y(),
      t.z(),
      1000.0 * camera.translation_sigma_m(),
      kDegrees * camera.rotation_sigma_rad());
}

absl::Status AddCameras(const std::string& id,
                        const std::vector<std::string>& cameras,
                        v1::StationCamera::Motion motion,
                        v1::Station* station) {
  for (const std::string& camera : cameras) {
    v1::StationCamera* out = station->add_cameras();
    out->set_name(CameraName(id, camera));
    out->set_motion(motion);
  }
  return absl::OkStatus();
}

constexpr size_t kPoseWords = 8;

absl::Status AddCameraPoses(const StationSetArguments& a, v1::Station* station) {
  if (a.camera_pose.size() % kPoseWords != 0) {
    return absl::InvalidArgumentError(
        "--camera-pose takes a camera and its pose in the base: x y z qw qx qy qz");
  }
  if (!a.camera_pose_sigma.empty() && a.camera_pose.empty())
    return absl::InvalidArgumentError("--camera-pose-sigma: only with --camera-pose");
  for (size_t first = 0; first < a.camera_pose.size(); first += kPoseWords) {
    double n[7] = {};
    for (size_t i = 0; i < 7; ++i) {
      const std::string& word = a.camera_pose[first + i + 1];
      if (!absl::SimpleAtod(word, &n[i]))
        return absl::InvalidArgumentError(absl::StrCat("--camera-pose: not a number: ", word));
    }
    const Eigen::Quaterniond q(n[3], n[4], n[5], n[6]);
    if (!(std::abs(q.norm() - 1.0) < 0.01))
      return absl::InvalidArgumentError("--camera-pose: the quaternion's norm is not 1");
    v1::StationCamera* camera = station->add_cameras();
    camera->set_name(CameraName(a.id, a.camera_pose[first]));
    *camera->mutable_base_from_camera() =
        ToProto(Rigid3{q.normalized().toRotationMatrix(), {n[0], n[1], n[2]}});
    if (a.camera_pose_sigma.empty()) continue;
    camera->set_base_rotation_sigma_rad(a.camera_pose_sigma[0]);
    camera->set_base_position_sigma_m(a.camera_pose_sigma[1]);
  }
  return absl::OkStatus();
}

}  // namespace

absl::Status StationList(HoropterClient& client) {
  HOROPTER_ASSIGN_OR_RETURN(const std::vector<v1::Station> stations, client.ListStations());
  Say("%-24s %8s %9s  %s\n", "station", "cameras", "requests", "name");
  for (const v1::Station& s : stations) {
    Say("%-24s %8d %9lld  %s\n",
        LastPart(s.name()).c_str(),
        s.cameras_size(),
        static_cast<long long>(s.request_count()),
        s.display_name().c_str());
    if (JsonOutput()) HOROPTER_RETURN_IF_ERROR(SayMessage(s));
  }
  return absl::OkStatus();
}

absl::Status StationShow(HoropterClient& client, const std::string& id) {
  HOROPTER_ASSIGN_OR_RETURN(const v1::Station station, client.GetStation(id));
  if (JsonOutput()) return SayMessage(station);
  Say("station %s%s%s: %lld requests since %s\n",
      id.c_str(),
      station.display_name().empty() ? "" : ", ",
      station.display_name().c_str(),
      static_cast<long long>(station.request_count()),
      google::protobuf::util::TimeUtil::ToString(station.create_time()).c_str());
  for (const v1::StationCamera& camera : station.cameras()) SayCamera(camera);
  for (const v1::StationEvent& event : station.events()) {
    std::string cameras;
    for (const std::string& c : event.cameras())
      absl::StrAppend(&cameras, cameras.empty() ? "" : ",", LastPart(c));
    Say("%s  %s  %s%s%s\n",
        google::protobuf::util::TimeUtil::ToString(event.time()).c_str(),
        cameras.c_str(),
        event.detail().c_str(),
        event.request_id().empty() ? "" : ", request ",
        event.request_id().c_str());
  }
  return absl::OkStatus();
}

absl::Status StationSet(HoropterClient& client, const StationSetArguments& a) {
  v1::UpdateStationRequest request;
  v1::Station& station = *request.mutable_station();
  station.set_name("stations/" + a.id);
  request.set_allow_missing(true);
  if (a.display_name) station.set_display_name(*a.display_name);
  HOROPTER_RETURN_IF_ERROR(AddCameras(a.id, a.moving, v1::StationCamera::MOTION_MOVING, &station));
  HOROPTER_RETURN_IF_ERROR(
      AddCameras(a.id, a.zooming, v1::StationCamera::MOTION_ZOOMING, &station));
  HOROPTER_RETURN_IF_ERROR(AddCameras(a.id, a.fixed, v1::StationCamera::MOTION_FIXED, &station));
  HOROPTER_RETURN_IF_ERROR(AddCameraPoses(a, &station));
  HOROPTER_ASSIGN_OR_RETURN(const v1::Station written, client.UpdateStation(request));
  Say("station %s has %d cameras\n", a.id.c_str(), written.cameras_size());
  return JsonOutput() ? SayMessage(written) : absl::OkStatus();
}

absl::Status StationRemove(HoropterClient& client, const std::string& id) {
  HOROPTER_RETURN_IF_ERROR(client.DeleteStation(id));
  Say("station %s removed\n", id.c_str());
  SayJson({{"removed", id}});
  return absl::OkStatus();
}

absl::Status StationReset(HoropterClient& client,
                          const std::string& id,
                          const std::string& camera,
                          bool keep_base) {
  HOROPTER_ASSIGN_OR_RETURN(
      const v1::Station station,
      client.ResetStation(camera.empty() ? "stations/" + id : CameraName(id, camera), keep_base));
  Say("%s of station %s is learnt from the next request on\n",
      camera.empty() ? "every camera" : ("camera " + camera).c_str(),
      id.c_str());
  return JsonOutput() ? SayMessage(station) : absl::OkStatus();
}

absl::Status StationImport(HoropterClient& client,
                           const std::string& id,
                           const std::string& camera,
                           const std::string& path) {
  HOROPTER_ASSIGN_OR_RETURN(const CameraFile whole, ReadCameraFile(path));
  const absl::StatusOr<CameraFile> described = ForDescribedImages(whole);
  if (!described.ok()) {
    return absl::Status(described.status().code(),
                        absl::StrCat(path, ": ", std::string(described.status().message())));
  }
  const CameraFile& file = *described;
  if (file.lens) {
    return absl::InvalidArgumentError(absl::StrCat(
        path, ": a lens beyond k1 and square pixels is given with each image: recognize --camera"));
  }
  for (const std::string& w : file.warnings) std::fprintf(stderr, "warning: %s\n", w.c_str());
  v1::CameraCalibration calibration;
  calibration.set_image_width_px(file.width);
  calibration.set_image_height_px(file.height);
  for (const double k : {file.focal_px, 0.0, file.cx, 0.0, file.focal_px, file.cy, 0.0, 0.0, 1.0})
    calibration.add_k(k);
  calibration.add_d(file.k1);
  HOROPTER_ASSIGN_OR_RETURN(const v1::Station station,
                            client.ImportCalibration(CameraName(id, camera), calibration));
  Say("camera %s of station %s: calibration taken over\n", camera.c_str(), id.c_str());
  return JsonOutput() ? SayMessage(station) : absl::OkStatus();
}

absl::Status StationExport(HoropterClient& client,
                           const std::string& id,
                           const std::string& camera,
                           const std::string& path) {
  HOROPTER_ASSIGN_OR_RETURN(const v1::CameraCalibration c,
                            client.ExportCalibration(CameraName(id, camera)));
  const auto list = [](const auto& numbers) {
    std::string out;
    for (const double n : numbers)
      absl::StrAppendFormat(&out, "%s%.12g", out.empty() ? "" : ", ", n);
    return out;
  };
  const double f = c.k(0), cx = c.k(2), cy = c.k(5);
  const std::string yaml = absl::StrFormat(
      "image_width: %d\nimage_height: %d\ncamera_name: %s\n"
      "camera_matrix:\n  rows: 3\n  cols: 3\n  data: [%s]\n"
      "distortion_model: plumb_bob\n"
      "distortion_coefficients:\n  rows: 1\n  cols: 5\n  data: [%s]\n"
      "rectification_matrix:\n  rows: 3\n  cols: 3\n  data: [1, 0, 0, 0, 1, 0, 0, 0, 1]\n"
      "projection_matrix:\n  rows: 3\n  cols: 4\n"
      "  data: [%.12g, 0, %.12g, 0, 0, %.12g, %.12g, 0, 0, 0, 1, 0]\n"
      "# standard deviations: focal length %.4f %%, principal point %.3f px, k1 %.5f\n",
      c.image_width_px(),
      c.image_height_px(),
      camera,
      list(c.k()),
      list(c.d()),
      f,
      cx,
      f,
      cy,
      100.0 * c.focal_log_sigma(),
      c.principal_point_sigma_px(),
      c.k1_sigma());
  HOROPTER_RETURN_IF_ERROR(WriteFileAtomically(path, yaml));
  Say("%s\n", path.c_str());
  return JsonOutput() ? SayMessage(c) : absl::OkStatus();
}

}  // namespace horopter
