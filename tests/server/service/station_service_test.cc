#include "server/service/station_service.h"

#include <gmock/gmock.h>
#include <grpcpp/grpcpp.h>
#include <gtest/gtest.h>

#include <cmath>
#include <filesystem>
#include <fstream>
#include <thread>

#include "server/base/recording_file.h"
#include "server/base/sha256.h"
#include "server/service/rpc_status.h"
#include "server/vision/geometry/station_blob.h"
#include "tests/server/service/station_service_fixture.h"
#include "tests/support/scratch_dir.h"

namespace horopter {
namespace {

TEST_F(StationServiceTest, RequestsTeachTheStationTheyName) {
  ASSERT_TRUE(Make("cell").ok());
  const std::string etag = station_.etag();
  for (int i = 0; i < 6; ++i) {
    ASSERT_TRUE(Recognize(Request("cell", {"left", "right"})).ok());
    EXPECT_EQ(answer_.station().station(), "stations/cell");
    EXPECT_TRUE(answer_.station().learnt());
    EXPECT_EQ(answer_.station().findings_size(), 0);
  }
  EXPECT_TRUE(answer_.station().prior_used());
  EXPECT_GT(answer_.station().distance_limit(), answer_.station().distance_squared());
  const v1::Station station = Get("cell");
  EXPECT_NE(station.etag(), etag);
  EXPECT_EQ(station.request_count(), 6);
  ASSERT_EQ(station.cameras_size(), 2);
  EXPECT_EQ(station.cameras(0).name(), "stations/cell/cameras/left");
  EXPECT_EQ(station.cameras(0).request_count(), 6);
  EXPECT_NEAR(station.cameras(0).calibration().k(0),
              scene_.rig.cameras[0].focal_px,
              0.01 * scene_.rig.cameras[0].focal_px);
  EXPECT_LT(station.cameras(0).calibration().focal_log_sigma(), 0.005);
  EXPECT_TRUE(station.cameras(1).has_camera_from_rig());
  // What is known reaches the pipeline.
  ASSERT_TRUE(scene_.Seen().has_value());
  EXPECT_EQ(scene_.Seen()->state.requests, 5);
}

TEST_F(StationServiceTest, RequestsThatNameNoneAreNotTouched) {
  ASSERT_TRUE(Recognize(Request("", {"Any label", ""})).ok());
  EXPECT_FALSE(answer_.has_station());
  EXPECT_FALSE(scene_.Seen().has_value());
}

TEST_F(StationServiceTest, AMovedCameraIsReportedWithTheLastRequestThatAgreed) {
  ASSERT_TRUE(Make("cell").ok());
  std::string last;
  for (int i = 0; i < 8; ++i) {
    ASSERT_TRUE(Recognize(Request("cell", {"left", "right"})).ok());
    last = answer_.request_id();
  }
  scene_.ShiftCamera(1, 0.05);
  ASSERT_TRUE(Recognize(Request("cell", {"left", "right"})).ok());
  EXPECT_FALSE(answer_.station().prior_used());
  ASSERT_EQ(answer_.station().findings_size(), 1);
  const v1::StationFinding& finding = answer_.station().findings(0);
  EXPECT_EQ(finding.kind(), v1::StationFinding::KIND_CAMERA_MOVED);
  EXPECT_EQ(finding.cameras_size(), 2);  // one of the two
  EXPECT_EQ(finding.last_agreeing_request_id(), last);
  EXPECT_TRUE(finding.has_last_agreeing_time());
  const v1::Station station = Get("cell");
  EXPECT_EQ(station.events(0).kind(), v1::StationEvent::KIND_CAMERA_MOVED);
  EXPECT_EQ(station.events(0).request_id(), answer_.request_id());
  // It is learnt from the start again.
  ASSERT_TRUE(Recognize(Request("cell", {"left", "right"})).ok());
  EXPECT_EQ(answer_.station().findings_size(), 0);
}

TEST_F(StationServiceTest, AReferenceTeachesTheBaseAndAMovedCameraLosesIt) {
  scene_.SetRig(SmallRig(3));
  const auto base_from = [&](int camera) { return scene_.rig.poses[camera].Inverse(); };
  const v1::RecognizeSceneRequest request = Request("cell", {"left", "right", "top"});
  ASSERT_TRUE(Make("cell").ok());
  for (int i = 0; i < 8; ++i) ASSERT_TRUE(Recognize(request).ok());
  scene_.RefersTo({base_from(0), base_from(1), std::nullopt});
  ASSERT_TRUE(Recognize(request).ok());
  v1::Station station = Get("cell");
  ASSERT_TRUE(station.cameras(0).has_base_from_camera());
  ASSERT_TRUE(station.cameras(1).has_base_from_camera());
  EXPECT_FALSE(station.cameras(2).has_base_from_camera());
  EXPECT_EQ(station.events(0).kind(), v1::StationEvent::KIND_BASE_LEARNT);
  EXPECT_EQ(station.events(0).cameras_size(), 2);
  EXPECT_EQ(station.cameras(0).base_source(), v1::StationCamera::BASE_SOURCE_LEARNT);
  EXPECT_EQ(station.cameras(0).base_request_count(), 1);
  EXPECT_EQ(station.cameras(2).base_source(), v1::StationCamera::BASE_SOURCE_UNSPECIFIED);
  EXPECT_FALSE(station.cameras(2).has_base_position_sigma_m());

  scene_.RefersTo({});
  scene_.ShiftCamera(1, 0.05);
  ASSERT_TRUE(Recognize(request).ok());
  ASSERT_EQ(answer_.station().findings_size(), 1);
  ASSERT_EQ(answer_.station().findings(0).cameras_size(), 1);
  station = Get("cell");
  EXPECT_TRUE(station.cameras(0).has_base_from_camera());
  EXPECT_FALSE(station.cameras(1).has_base_from_camera());
  // The third has it through the rig as it was.
  ASSERT_TRUE(station.cameras(2).has_base_from_camera());
  EXPECT_NEAR(station.cameras(2).base_from_camera().translation_m().z(), base_from(2).t.z(), 0.01);
}

TEST_F(StationServiceTest, ImagesOfAnotherSizeAreAFinding) {
  ASSERT_TRUE(Make("cell").ok());
  ASSERT_TRUE(Recognize(Request("cell", {"left", "right"})).ok());
  v1::RecognizeSceneRequest request = Request("cell", {"left", "right"});
  request.mutable_images(1)->set_content(Png(48, 64));
  ASSERT_TRUE(Recognize(request).ok());
  ASSERT_GE(answer_.station().findings_size(), 1);
  EXPECT_EQ(answer_.station().findings(0).kind(), v1::StationFinding::KIND_IMAGE_SIZE_CHANGED);
  EXPECT_EQ(answer_.station().findings(0).cameras(0), "stations/cell/cameras/right");
}

TEST_F(StationServiceTest, BadRequestsNameTheField) {
  EXPECT_EQ(Recognize(Request("cell", {"left"})).error_code(), grpc::StatusCode::NOT_FOUND);
  EXPECT_EQ(field_, "station");
  ASSERT_TRUE(Make("cell").ok());
  EXPECT_EQ(Recognize(Request("cell", {"left", ""})).error_code(),
            grpc::StatusCode::INVALID_ARGUMENT);
  EXPECT_EQ(field_, "images[1].camera_id");
  v1::RecognizeSceneRequest request = Request("", {"left"});
  request.set_station("cell");
  EXPECT_EQ(Recognize(request).error_code(), grpc::StatusCode::INVALID_ARGUMENT);
  EXPECT_EQ(field_, "station");
  request = Request("cell", {"left"});
  request.set_station_state("nonsense");
  EXPECT_EQ(Recognize(request).error_code(), grpc::StatusCode::INVALID_ARGUMENT);
  EXPECT_EQ(field_, "station_state");
  request.clear_station();
  EXPECT_EQ(Recognize(request).error_code(), grpc::StatusCode::INVALID_ARGUMENT);
  EXPECT_EQ(field_, "station_state");
  std::vector<std::string> many;
  for (int i = 0; i < 17; ++i) many.push_back("c" + std::to_string(i));
  EXPECT_EQ(Recognize(Request("cell", many)).error_code(), grpc::StatusCode::INVALID_ARGUMENT);
  EXPECT_EQ(field_, "images[16].camera_id");
  EXPECT_EQ(Make("Cell").error_code(), grpc::StatusCode::INVALID_ARGUMENT);
  EXPECT_EQ(field_, "station.name");
  EXPECT_EQ(Get("cell").request_count(), 0);
}

TEST_F(StationServiceTest, ChangesAreGuardedByTheEtag) {
  ASSERT_TRUE(Make("cell").ok());
  v1::UpdateStationRequest update;
  update.mutable_station()->set_name("stations/cell");
  update.mutable_station()->set_display_name("press 4");
  update.set_if_match("0123456789abcdef");
  EXPECT_EQ(Update(update).error_code(), grpc::StatusCode::ABORTED);
  update.set_if_match(station_.etag().empty() ? Get("cell").etag() : station_.etag());
  ASSERT_TRUE(Update(update).ok());
  EXPECT_EQ(station_.display_name(), "press 4");
  EXPECT_EQ(Update(update).error_code(), grpc::StatusCode::ABORTED);  // changed since
  grpc::ClientContext context;
  v1::DeleteStationRequest remove;
  remove.set_name("stations/cell");
  remove.set_if_match("x");
  google::protobuf::Empty nothing;
  EXPECT_EQ(stations_->DeleteStation(&context, remove, &nothing).error_code(),
            grpc::StatusCode::ABORTED);
  grpc::ClientContext again;
  remove.clear_if_match();
  EXPECT_TRUE(stations_->DeleteStation(&again, remove, &nothing).ok());
}

TEST_F(StationServiceTest, MotionAndHandEyeAreWrittenAndReachThePipeline) {
  ASSERT_TRUE(Make("cell").ok());
  v1::UpdateStationRequest update;
  update.mutable_station()->set_name("stations/cell");
  v1::StationCamera* camera = update.mutable_station()->add_cameras();
  camera->set_name("stations/cell/cameras/left");
  camera->set_motion(v1::StationCamera::MOTION_MOVING);
  camera->mutable_base_from_camera()->mutable_rotation()->set_w(1.0);
  camera->mutable_base_from_camera()->mutable_translation_m()->set_z(0.5);
  ASSERT_TRUE(Update(update).ok());
  EXPECT_EQ(station_.cameras(0).motion(), v1::StationCamera::MOTION_MOVING);
  EXPECT_FALSE(station_.cameras(0).has_calibration());
  ASSERT_TRUE(Recognize(Request("cell", {"left", "right"})).ok());
  EXPECT_TRUE(scene_.Seen()->state.cameras[0].moving);
  ASSERT_TRUE(scene_.Seen()->bases[0].has_value());
  EXPECT_EQ(scene_.Seen()->bases[0]->base_from_camera.t.z(), 0.5);
  EXPECT_EQ(scene_.Seen()->bases[0]->position_sigma_m, 0.005);
  EXPECT_EQ(station_.cameras(0).base_source(), v1::StationCamera::BASE_SOURCE_GIVEN);
  EXPECT_FALSE(Get("cell").cameras(0).has_camera_from_rig());
  camera->set_name("stations/other/cameras/left");
  EXPECT_EQ(Update(update).error_code(), grpc::StatusCode::INVALID_ARGUMENT);
  EXPECT_EQ(field_, "station.cameras[0].name");
}

TEST_F(StationServiceTest, CalibrationsComeAndGo) {
  ASSERT_TRUE(Make("cell").ok());
  v1::ImportCalibrationRequest import_;
  import_.set_name("stations/cell/cameras/left");
  v1::CameraCalibration& c = *import_.mutable_calibration();
  c.set_image_width_px(kColumns);
  c.set_image_height_px(kRows);
  for (const double k : {180.0, 0.0, 64.0, 0.0, 180.0, 47.0, 0.0, 0.0, 1.0}) c.add_k(k);
  c.add_d(-0.05);
  const auto import_now = [&] {
    grpc::ClientContext context;
    const grpc::Status status = stations_->ImportCalibration(&context, import_, &station_);
    field_ = Trailing(context, kErrorFieldKey);
    return status;
  };
  const auto export_now = [&](v1::CameraCalibration* out) {
    grpc::ClientContext context;
    v1::ExportCalibrationRequest request;
    request.set_name(import_.name());
    return stations_->ExportCalibration(&context, request, out);
  };
  v1::CameraCalibration out;
  EXPECT_EQ(export_now(&out).error_code(), grpc::StatusCode::NOT_FOUND);
  ASSERT_TRUE(import_now().ok());
  ASSERT_TRUE(export_now(&out).ok());
  EXPECT_EQ(out.k(0), 180.0);
  EXPECT_EQ(out.d(0), -0.05);
  EXPECT_NEAR(out.focal_log_sigma(), 0.003, 1e-12);
  EXPECT_EQ(Get("cell").events(0).kind(), v1::StationEvent::KIND_CALIBRATION_IMPORTED);
  grpc::ClientContext context;
  v1::ResetStationRequest reset;
  reset.set_name(import_.name());
  ASSERT_TRUE(stations_->ResetStation(&context, reset, &station_).ok());
  EXPECT_EQ(export_now(&out).error_code(), grpc::StatusCode::FAILED_PRECONDITION);
  for (int what = 0; what < 14; ++what) {
    const v1::CameraCalibration good = c;
    if (what == 0) c.set_image_width_px(0);
    if (what == 1) c.mutable_k()->RemoveLast();
    if (what == 2) c.set_k(4, 200.0);
    if (what == 3) c.set_k(1, 1.0);
    if (what == 4) c.set_k(0, std::nan(""));
    if (what == 5) c.add_d(0.1);
    if (what == 6) c.set_focal_log_sigma(-1.0);
    if (what == 7) c.set_k(8, 180.0);
    if (what == 8) c.set_k(7, 0.01);
    if (what == 9) {  // column by column
      for (const auto& [a, b] : {std::pair{2, 6}, {5, 7}}) c.mutable_k()->SwapElements(a, b);
    }
    if (what == 10) c.set_k(2, 200.0);
    if (what == 11) c.set_d(0, -5.0);
    if (what == 12) c.set_k(0, 1.0), c.set_k(4, 1.0);
    if (what == 13) c.set_k(0, 1e4), c.set_k(4, 1e4);
    EXPECT_EQ(import_now().error_code(), grpc::StatusCode::INVALID_ARGUMENT) << what;
    EXPECT_THAT(field_, testing::StartsWith("calibration.")) << what;
    c = good;
  }
}

TEST_F(StationServiceTest, StationsAreListedInPages) {
  for (const char* id : {"c", "a", "b"}) ASSERT_TRUE(Make(id).ok());
  v1::ListStationsRequest request;
  request.set_page_size(2);
  v1::ListStationsResponse page;
  grpc::ClientContext first;
  ASSERT_TRUE(stations_->ListStations(&first, request, &page).ok());
  ASSERT_EQ(page.stations_size(), 2);
  EXPECT_EQ(page.stations(1).name(), "stations/b");
  request.set_page_token(page.next_page_token());
  grpc::ClientContext second;
  ASSERT_TRUE(stations_->ListStations(&second, request, &page).ok());
  ASSERT_EQ(page.stations_size(), 1);
  EXPECT_EQ(page.next_page_token(), "");
  request.set_page_token("v1.a");
  grpc::ClientContext third;
  EXPECT_EQ(stations_->ListStations(&third, request, &page).error_code(),
            grpc::StatusCode::INVALID_ARGUMENT);
}

TEST_F(StationServiceTest, ConcurrentRequestsAllTeach) {
  ASSERT_TRUE(Make("cell").ok());
  std::vector<std::thread> threads;
  for (int t = 0; t < 3; ++t) {
    threads.emplace_back([&] {
      for (int i = 0; i < 3; ++i) {
        grpc::ClientContext context;
        v1::RecognizeSceneResponse answer;
        EXPECT_TRUE(server_.recognition()
                        .RecognizeScene(&context, Request("cell", {"left", "right"}), &answer)
                        .ok());
        EXPECT_TRUE(answer.station().learnt());
      }
    });
  }
  for (std::thread& t : threads) t.join();
  EXPECT_EQ(Get("cell").request_count(), 9);
}

TEST_F(StationServiceTest, RequestsThatOnlyUseTeachNothing) {
  ASSERT_TRUE(Make("cell").ok());
  for (int i = 0; i < 3; ++i) ASSERT_TRUE(Recognize(Request("cell", {"left", "right"})).ok());
  const std::string etag = Get("cell").etag();
  v1::RecognizeSceneRequest request = Request("cell", {"left", "right"});
  request.set_station_read_only(true);
  ASSERT_TRUE(Recognize(request).ok());
  EXPECT_TRUE(answer_.station().read_only());
  EXPECT_FALSE(answer_.station().learnt());
  EXPECT_EQ(scene_.Seen()->state.requests, 3);  // it is used
  EXPECT_EQ(Get("cell").etag(), etag);
  request.clear_station();
  EXPECT_EQ(Recognize(request).error_code(), grpc::StatusCode::INVALID_ARGUMENT);
  EXPECT_EQ(field_, "station_read_only");
}

TEST_F(StationServiceTest, ACameraThatStandsStillTakesOneImage) {
  ASSERT_TRUE(Make("cell").ok());
  EXPECT_EQ(Recognize(Request("cell", {"left", "right", "left"})).error_code(),
            grpc::StatusCode::INVALID_ARGUMENT);
  EXPECT_EQ(field_, "images[2].camera_id");
  EXPECT_EQ(Get("cell").cameras_size(), 0);
  // One on the arm takes as many as it likes.
  v1::UpdateStationRequest update;
  update.mutable_station()->set_name("stations/cell");
  v1::StationCamera* camera = update.mutable_station()->add_cameras();
  camera->set_name("stations/cell/cameras/arm");
  camera->set_motion(v1::StationCamera::MOTION_MOVING);
  ASSERT_TRUE(Update(update).ok());
  EXPECT_TRUE(Recognize(Request("cell", {"arm", "arm"})).ok()) << field_;
}

class TeachersOfAStationTest : public StationServiceTest {
 protected:
  TeachersOfAStationTest() : StationServiceTest(Options()) {}
  static ServerOptions Options() {
    static ScratchDir folder;
    ServerOptions options;
    options.access_file = folder.File("access");
    std::ofstream file(options.access_file);
    for (const char* role : {"robot", "teacher", "admin"})
      file << role << " " << role << " sha256:" << Sha256Hex(role) << "\n";
    return options;
  }
  // The role is the token as well.
  v1::StationReport RecognizeAs(const std::string& role) {
    grpc::ClientContext context;
    context.AddMetadata("authorization", "Bearer " + role);
    v1::RecognizeSceneResponse answer;
    const grpc::Status status =
        server_.recognition().RecognizeScene(&context, Request("cell", {"left", "right"}), &answer);
    EXPECT_TRUE(status.ok()) << status.error_message();
    return answer.station();
  }
};

TEST_F(TeachersOfAStationTest, ARobotsTokenUsesAndNeverTeaches) {
  grpc::ClientContext context;
  context.AddMetadata("authorization", "Bearer admin");
  v1::UpdateStationRequest make;
  make.mutable_station()->set_name("stations/cell");
  make.set_allow_missing(true);
  ASSERT_TRUE(stations_->UpdateStation(&context, make, &station_).ok());
  for (const std::string role : {"robot", "teacher", "admin"}) {
    const v1::StationReport report = RecognizeAs(role);
    EXPECT_EQ(report.learnt(), role != "robot") << role;
    EXPECT_EQ(report.read_only(), role == "robot") << role;
  }
  // A teacher is no admin.
  grpc::ClientContext second;
  second.AddMetadata("authorization", "Bearer teacher");
  EXPECT_EQ(stations_->UpdateStation(&second, make, &station_).error_code(),
            grpc::StatusCode::PERMISSION_DENIED);
}

class RecordedStationTest : public StationServiceTest {
 protected:
  RecordedStationTest() : StationServiceTest(Options()) {}
  static ServerOptions Options() {
    ServerOptions options;
    options.telemetry.recorder.folder = Folder().path().string();
    options.telemetry.recorder.sample = 1.0;
    return options;
  }
  static ScratchDir& Folder() {
    static ScratchDir folder;
    return folder;
  }
};

TEST_F(RecordedStationTest, ARecordingHoldsThePriorAndItsReplayTeachesNothing) {
  ASSERT_TRUE(Make("cell").ok());
  for (int i = 0; i < 3; ++i) ASSERT_TRUE(Recognize(Request("cell", {"left", "right"})).ok());
  v1::RecognizeSceneRequest recorded;
  int files = 0;
  for (const auto& entry : std::filesystem::directory_iterator(Folder().path())) {
    std::ifstream file(entry.path(), std::ios::binary);
    const std::string bytes((std::istreambuf_iterator<char>(file)), {});
    const auto recording = DecodeRecording(bytes);
    ASSERT_TRUE(recording.ok()) << recording.status();
    ASSERT_TRUE(recorded.ParseFromString(recording->request));
    ASSERT_TRUE(DecodeStationState(recorded.station_state()).ok());
    ++files;
  }
  EXPECT_EQ(files, 3);
  ASSERT_TRUE(Recognize(recorded).ok());
  EXPECT_FALSE(answer_.station().learnt());
  EXPECT_EQ(Get("cell").request_count(), 3);
  const int64_t known = DecodeStationState(recorded.station_state())->requests;
  EXPECT_EQ(scene_.Seen()->state.requests, known);
}

}  // namespace
}  // namespace horopter
