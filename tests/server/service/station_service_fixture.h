// A server whose recognition is a rig's: stations learn from it.
#pragma once

#include <grpcpp/grpcpp.h>
#include <gtest/gtest.h>

#include <memory>
#include <mutex>
#include <opencv2/core.hpp>
#include <opencv2/imgcodecs.hpp>
#include <optional>
#include <random>
#include <string>
#include <vector>

#include "server/service/rpc_status.h"
#include "server/service/station_service.h"
#include "tests/support/service_fixture.h"
#include "tests/support/synthetic_rig.h"

namespace horopter {

inline constexpr int kRows = 96, kColumns = 128;

inline std::string Png(int rows = kRows, int columns = kColumns) {
  std::vector<unsigned char> bytes;
  cv::imencode(".png", cv::Mat(rows, columns, CV_8UC3, cv::Scalar(10, 20, 30)), bytes);
  return {bytes.begin(), bytes.end()};
}

// A rig whose images have the size of the test's.
inline SyntheticRig SmallRig(int cameras = 2) {
  SyntheticRig rig = MakeSyntheticRig(cameras, 3);
  for (PinholeCamera& c : rig.cameras) {
    c.width = kColumns;
    c.height = kRows;
    c.focal_px *= 0.1;
    c.cx = 63.0;
    c.cy = 48.0;
  }
  return rig;
}

// Answers without objects; of a station, what images of the rig say of it.
struct FakeScene {
  SyntheticRig rig = SmallRig();
  std::mt19937 rng{5};
  std::mutex mutex;
  int calls = 0;
  std::optional<StationRequest> seen;
  std::vector<std::optional<CameraBase>> by_reference;  // per image

  // Under the lock, like Seen.
  void RefersTo(const std::vector<std::optional<Rigid3>>& bases, double sigma = 1e-3) {
    const std::lock_guard lock(mutex);
    by_reference.clear();
    for (const std::optional<Rigid3>& base : bases) {
      by_reference.emplace_back();
      if (base) by_reference.back() = CameraBase{*base, sigma, sigma, true, 1};
    }
  }
  void SetRig(const SyntheticRig& other) {
    const std::lock_guard lock(mutex);
    rig = other;
  }
  void ShiftCamera(int camera, double x_m) {
    const std::lock_guard lock(mutex);
    rig.poses[camera].t.x() += x_m;
  }

  // What the last call saw of its station; under the lock, for who watches threads does not see
  // that the call is over.
  std::optional<StationRequest> Seen() {
    const std::lock_guard lock(mutex);
    return seen;
  }

  Recognizer Answers() {
    return [this](const SceneRequest& request, const CatalogSnapshot&, const CallLimits&) {
      const std::lock_guard lock(mutex);
      ++calls;
      seen = request.station;
      PipelineResult result;
      result.answer.cameras.resize(request.images.size());
      if (!request.station) return absl::StatusOr<PipelineResult>(std::move(result));
      std::vector<int> images(request.images.size());
      for (std::size_t i = 0; i < images.size(); ++i) images[i] = static_cast<int>(i);
      result.station.emplace();
      result.station->evidence = SayOf(rig, images, 0.3, &rng);
      result.station->test =
          TestStation(request.station->state, request.station->views, result.station->evidence, {});
      result.station->prior_used = result.station->test.agrees;
      result.station->bases_seen = by_reference;
      return absl::StatusOr<PipelineResult>(std::move(result));
    };
  }
};

class StationServiceTest : public testing::Test {
 protected:
  explicit StationServiceTest(const ServerOptions& options = {})
      : server_(scene_.Answers(), options),
        stations_(v1::StationService::NewStub(server_.channel())) {}

  grpc::Status Make(const std::string& id) {
    v1::UpdateStationRequest request;
    request.mutable_station()->set_name("stations/" + id);
    request.set_allow_missing(true);
    return Update(request);
  }
  grpc::Status Update(const v1::UpdateStationRequest& request) {
    grpc::ClientContext context;
    const grpc::Status status = stations_->UpdateStation(&context, request, &station_);
    field_ = Trailing(context, kErrorFieldKey);
    return status;
  }
  v1::Station Get(const std::string& id) {
    grpc::ClientContext context;
    v1::GetStationRequest request;
    request.set_name("stations/" + id);
    v1::Station out;
    EXPECT_TRUE(stations_->GetStation(&context, request, &out).ok());
    return out;
  }
  static v1::RecognizeSceneRequest Request(const std::string& station,
                                           const std::vector<std::string>& cameras) {
    v1::RecognizeSceneRequest request;
    if (!station.empty()) request.set_station("stations/" + station);
    for (const std::string& camera : cameras) {
      v1::SceneImage* image = request.add_images();
      image->set_content(Png());
      image->set_camera_id(camera);
    }
    return request;
  }
  grpc::Status Recognize(const v1::RecognizeSceneRequest& request) {
    grpc::ClientContext context;
    answer_.Clear();
    const grpc::Status status = server_.recognition().RecognizeScene(&context, request, &answer_);
    field_ = Trailing(context, kErrorFieldKey);
    return status;
  }

  FakeScene scene_;
  TestServer server_;
  std::unique_ptr<v1::StationService::Stub> stations_;
  v1::Station station_;
  v1::RecognizeSceneResponse answer_;
  std::string field_;
};

}  // namespace horopter
