#include <gmock/gmock.h>
#include <grpcpp/grpcpp.h>
#include <gtest/gtest.h>

#include <filesystem>
#include <fstream>
#include <future>
#include <memory>
#include <opencv2/imgcodecs.hpp>
#include <optional>
#include <vector>

#include "horopter/v1/answers.grpc.pb.h"
#include "server/base/sha256.h"
#include "tests/server/service/recording_recognizer.h"
#include "tests/support/scratch_dir.h"
#include "tests/support/service_fixture.h"

namespace horopter {
namespace {

using grpc::StatusCode;
using testing::HasSubstr;

v1::RecognizeSceneRequest Request(int images = 2, int rows = 1200, int cols = 1600) {
  v1::RecognizeSceneRequest request;
  for (int i = 0; i < images; ++i) {
    v1::SceneImage* const image = request.add_images();
    image->set_content(Png(rows, cols));
    image->set_frame_id("lens");
  }
  return request;
}

// One watching client.
class Watcher {
 public:
  Watcher(v1::AnswerService::Stub& stub,
          const v1::WatchAnswersRequest& request,
          const std::string& token = "") {
    if (!token.empty()) context_.AddMetadata("authorization", "Bearer " + token);
    reader_ = stub.WatchAnswers(&context_, request);
  }
  ~Watcher() {
    if (reader_ == nullptr) return;
    context_.TryCancel();
    End();
  }
  // The next message; unset: the call has ended.
  std::optional<v1::WatchedAnswer> Next() {
    v1::WatchedAnswer answer;
    if (!reader_->Read(&answer)) return std::nullopt;
    return answer;
  }
  grpc::Status End() {
    v1::WatchedAnswer ignored;
    while (reader_->Read(&ignored)) {
    }
    const grpc::Status status = reader_->Finish();
    reader_ = nullptr;
    return status;
  }

 private:
  grpc::ClientContext context_;
  std::unique_ptr<grpc::ClientReader<v1::WatchedAnswer>> reader_;
};

class AnswerServiceTest : public testing::Test {
 protected:
  void Begin(ServerOptions options = {}) {
    server_ = std::make_unique<TestServer>(Recording(seen_), options);
    stub_ = v1::AnswerService::NewStub(server_->channel());
  }
  v1::RecognizeSceneResponse Recognize(const v1::RecognizeSceneRequest& request = Request(),
                                       const std::string& token = "") {
    grpc::ClientContext context;
    if (!token.empty()) context.AddMetadata("authorization", "Bearer " + token);
    v1::RecognizeSceneResponse response;
    const grpc::Status status = server_->recognition().RecognizeScene(&context, request, &response);
    EXPECT_TRUE(status.ok()) << status.error_message();
    return response;
  }
  v1::WatchAnswersRequest Last(int count) {
    v1::WatchAnswersRequest request;
    request.set_last(count);
    return request;
  }

  Seen seen_;
  std::unique_ptr<TestServer> server_;
  std::unique_ptr<v1::AnswerService::Stub> stub_;
};

TEST_F(AnswerServiceTest, WatchersAreToldOfEachAnswerWithSmallPictures) {
  Begin();
  v1::WatchAnswersRequest watched;
  watched.set_previews(true);
  Watcher watcher(*stub_, watched);
  ASSERT_EQ(watcher.Next()->number(), 0);
  v1::RecognizeSceneRequest request = Request();
  request.set_min_score(0.25);
  const v1::RecognizeSceneResponse response = Recognize(request);
  const auto told = watcher.Next();
  ASSERT_TRUE(told);
  EXPECT_EQ(told->number(), 1);
  EXPECT_EQ(told->request_id(), response.request_id());
  EXPECT_EQ(told->code(), 0);
  EXPECT_FALSE(told->earlier());
  EXPECT_EQ(told->request().min_score(), 0.25);
  ASSERT_EQ(told->request().images_size(), 2);
  EXPECT_EQ(told->request().images(0).frame_id(), "lens");
  EXPECT_EQ(told->request().images(0).content(), "");
  ASSERT_EQ(told->response().reasons_size(), response.reasons_size());
  ASSERT_EQ(told->previews_size(), 2);
  EXPECT_EQ(told->previews(1).image_width_px(), 1600);
  const std::string& file = told->previews(1).jpeg();
  const cv::Mat shown = cv::imdecode(std::vector<char>(file.begin(), file.end()), cv::IMREAD_COLOR);
  EXPECT_EQ(shown.size(), cv::Size(800, 600));

  grpc::ClientContext context;
  v1::GetAnswerRequest get;
  get.set_number(1);
  v1::WatchedAnswer whole;
  ASSERT_TRUE(stub_->GetAnswer(&context, get, &whole).ok());
  ASSERT_EQ(whole.images_size(), 2);
  EXPECT_EQ(whole.images(1).content(), request.images(1).content());
}

TEST_F(AnswerServiceTest, FailedCallsAreToldAndRefusedOnesCounted) {
  Begin();
  Watcher watcher(*stub_, {});
  watcher.Next();
  for (const bool named : {true, false}) {
    grpc::ClientContext context;
    v1::RecognizeSceneRequest request = Request();
    if (named) request.add_candidate_objects("objects/none");
    if (!named) request.mutable_images(0)->set_content("no image");
    v1::RecognizeSceneResponse response;
    EXPECT_FALSE(server_->recognition().RecognizeScene(&context, request, &response).ok());
    const auto told = watcher.Next();
    ASSERT_TRUE(told);
    EXPECT_EQ(told->code(), named ? StatusCode::NOT_FOUND : StatusCode::INVALID_ARGUMENT);
    EXPECT_THAT(told->message(), HasSubstr(named ? "none" : "images[0]"));
    EXPECT_FALSE(told->has_response());
  }
}

TEST_F(AnswerServiceTest, TheLastOnesAreToldFirstAndOnceOnly) {
  Begin();
  for (int i = 0; i < 4; ++i) Recognize();
  Watcher watcher(*stub_, Last(2));
  EXPECT_EQ(watcher.Next()->number(), 0);
  for (const int number : {3, 4}) {
    const auto told = watcher.Next();
    EXPECT_EQ(told->number(), number);
    EXPECT_TRUE(told->earlier());
  }
  v1::WatchAnswersRequest again = Last(50);
  again.set_after(3);
  Watcher second(*stub_, again);
  second.Next();
  EXPECT_EQ(second.Next()->number(), 4);
  Recognize();
  const auto live = second.Next();
  EXPECT_EQ(live->number(), 5);
  EXPECT_FALSE(live->earlier());
  EXPECT_EQ(live->lost(), 0);
}

TEST_F(AnswerServiceTest, AnswersOfOneStationAlone) {
  Begin();
  v1::RecognizeSceneRequest of_cell = Request();
  of_cell.set_station("stations/cell");
  of_cell.set_station_state("x");  // refused, but it names the station
  v1::WatchAnswersRequest request;
  request.set_station("stations/cell");
  Watcher watcher(*stub_, request);
  watcher.Next();
  Recognize();
  grpc::ClientContext context;
  v1::RecognizeSceneResponse response;
  EXPECT_FALSE(server_->recognition().RecognizeScene(&context, of_cell, &response).ok());
  const auto told = watcher.Next();
  EXPECT_EQ(told->number(), 2);
  EXPECT_EQ(told->lost(), 0);
  request.set_station("cell");
  EXPECT_EQ(Watcher(*stub_, request).End().error_code(), StatusCode::INVALID_ARGUMENT);
}

TEST_F(AnswerServiceTest, ObserversAndAdminsWatchUntilTheirTokenGoes) {
  const ScratchDir folder;
  const std::string path = folder.File("access");
  const auto write = [&](const std::vector<std::string>& roles) {
    std::ofstream file(path + ".new");
    for (const std::string& role : roles)
      file << role << " " << role << " sha256:" << Sha256Hex(role) << "\n";
    file.close();
    std::filesystem::rename(path + ".new", path);
  };
  write({"robot", "teacher", "observer", "admin"});
  ServerOptions options;
  options.access_file = path;
  Begin(options);
  for (const char* role : {"robot", "teacher"}) {
    const grpc::Status refused = Watcher(*stub_, {}, role).End();
    EXPECT_EQ(refused.error_code(), StatusCode::PERMISSION_DENIED);
    EXPECT_THAT(refused.error_message(), HasSubstr("needs observer or admin"));
  }
  Watcher admin(*stub_, {}, "admin");
  Watcher observer(*stub_, {}, "observer");
  ASSERT_TRUE(admin.Next());
  ASSERT_TRUE(observer.Next());
  Recognize(Request(), "robot");
  EXPECT_EQ(observer.Next()->caller(), "robot");
  EXPECT_TRUE(admin.Next());
  // An observer recognises as a robot does, and changes nothing.
  Recognize(Request(), "observer");
  EXPECT_TRUE(observer.Next());
  grpc::ClientContext context;
  context.AddMetadata("authorization", "Bearer observer");
  v1::DeleteObjectRequest remove;
  remove.set_name("objects/block");
  google::protobuf::Empty done;
  EXPECT_EQ(server_->catalog().DeleteObject(&context, remove, &done).error_code(),
            StatusCode::PERMISSION_DENIED);
  write({"robot", "admin"});
  server_->server().Reload();
  Recognize(Request(), "robot");
  EXPECT_EQ(observer.End().error_code(), StatusCode::UNAUTHENTICATED);
}

TEST_F(AnswerServiceTest, WatchersAreBoundedInNumber) {
  ServerOptions options;
  options.watch.max_watchers = 2;
  Begin(options);
  auto first = std::make_unique<Watcher>(*stub_, v1::WatchAnswersRequest());
  Watcher second(*stub_, {});
  ASSERT_TRUE(first->Next());
  ASSERT_TRUE(second.Next());
  EXPECT_EQ(Watcher(*stub_, {}).End().error_code(), StatusCode::RESOURCE_EXHAUSTED);
  first = nullptr;
  bool accepted = false;
  for (int i = 0; i < 500 && !accepted; ++i) {
    Watcher third(*stub_, {});
    accepted = third.Next().has_value();
    if (!accepted) std::this_thread::sleep_for(std::chrono::milliseconds(10));
  }
  EXPECT_TRUE(accepted);
}

TEST_F(AnswerServiceTest, NobodyWatchesWhereTheOperatorSaysSo) {
  ServerOptions options;
  options.watch.max_watchers = 0;
  Begin(options);
  Recognize();
  EXPECT_EQ(Watcher(*stub_, {}).End().error_code(), StatusCode::FAILED_PRECONDITION);
}

TEST_F(AnswerServiceTest, TheEndOfTheServerEndsAllWatches) {
  Begin();
  Watcher watcher(*stub_, {});
  ASSERT_TRUE(watcher.Next());
  // A watch that held the end up would take the drain's hour.
  auto stopped = std::async(std::launch::async, [&] { server_->server().Stop(3600.0); });
  EXPECT_EQ(watcher.End().error_code(), StatusCode::UNAVAILABLE);
  stopped.get();
}

TEST_F(AnswerServiceTest, AHundredWhoTakeNothingHoldNoAnswerBack) {
  ServerOptions options;
  options.watch.patience = std::chrono::hours(1);
  Begin(options);
  v1::WatchAnswersRequest request;
  request.set_previews(true);
  std::vector<std::unique_ptr<Watcher>> stuck;
  for (int i = 0; i < 100; ++i) {
    stuck.push_back(std::make_unique<Watcher>(*stub_, request));
    ASSERT_TRUE(stuck.back()->Next());
  }
  Watcher reader(*stub_, request);
  ASSERT_TRUE(reader.Next());
  constexpr int kAnswers = kMostHeldAnswers + 10;
  for (int i = 1; i <= kAnswers; ++i) {
    Recognize(Request(1, 200, 300));
    const auto told = reader.Next();
    ASSERT_TRUE(told);
    EXPECT_EQ(told->number(), i);
    EXPECT_EQ(told->lost(), 0);
  }
  // They get what is still held, and are told how many they lost.
  for (auto& watcher : stuck) {
    int64_t told = 0, lost = 0;
    while (told + lost < kAnswers) {
      const auto next = watcher->Next();
      ASSERT_TRUE(next);
      ++told;
      lost += next->lost();
    }
    EXPECT_EQ(told + lost, kAnswers);
    EXPECT_GE(lost, 1);
  }
}

TEST_F(AnswerServiceTest, WhoTakesNothingForLongIsCutOff) {
  ServerOptions options;
  options.watch.patience = std::chrono::milliseconds(1);
  options.watch.max_watchers = 1;
  Begin(options);
  Watcher stuck(*stub_, {});
  ASSERT_TRUE(stuck.Next());
  Recognize(Request(1, 200, 300));
  while (true) {  // until there is room
    Watcher other(*stub_, {});
    if (other.Next()) break;
    EXPECT_EQ(other.End().error_code(), StatusCode::RESOURCE_EXHAUSTED);
    std::this_thread::sleep_for(std::chrono::milliseconds(10));
  }
}

TEST_F(AnswerServiceTest, RecordingsAreListedAndRead) {
  const ScratchDir folder;
  ServerOptions options;
  options.telemetry.recorder.folder = folder.path().string();
  Begin(options);
  std::vector<std::string> ids;
  for (int i = 0; i < 3; ++i) ids.push_back(Recognize(Request(1, 300, 2400)).request_id());
  std::vector<std::string> listed;
  v1::ListRecordingsRequest request;
  request.set_page_size(2);
  std::string newest;
  do {
    grpc::ClientContext context;
    v1::ListRecordingsResponse page;
    ASSERT_TRUE(stub_->ListRecordings(&context, request, &page).ok());
    EXPECT_LE(page.recordings_size(), 2);
    for (const v1::Recording& recording : page.recordings()) {
      if (newest.empty()) newest = recording.name();
      listed.push_back(recording.request_id());
      EXPECT_GT(recording.size_bytes(), 1000);
      EXPECT_GT(recording.time().seconds(), 1'600'000'000);
    }
    request.set_page_token(page.next_page_token());
  } while (!request.page_token().empty());
  EXPECT_THAT(listed, testing::UnorderedElementsAreArray(ids));

  const auto read = [&](const std::string& name, std::string* bytes) {
    grpc::ClientContext context;
    v1::GetRecordingRequest get;
    get.set_name(name);
    auto reader = stub_->GetRecording(&context, get);
    v1::GetRecordingResponse part;
    while (reader->Read(&part)) *bytes += part.chunk();
    return reader->Finish().error_code();
  };
  std::string bytes, none;
  ASSERT_EQ(read(newest, &bytes), StatusCode::OK);
  std::ifstream file(folder.File(newest.substr(std::string("recordings/").size()) + ".horec"),
                     std::ios::binary);
  EXPECT_EQ(bytes, std::string(std::istreambuf_iterator<char>(file), {}));
  EXPECT_GT(bytes.size(), size_t{2} << 20);  // more than a chunk
  EXPECT_EQ(read("recordings/0000", &none), StatusCode::NOT_FOUND);
  for (const char* bad : {"", "recordings/", "recordings/../parts", "recordings/a/b", "x/00"})
    EXPECT_EQ(read(bad, &none), StatusCode::INVALID_ARGUMENT) << bad;
}

TEST_F(AnswerServiceTest, AServerThatRecordsNothingSaysSo) {
  Begin();
  grpc::ClientContext context;
  v1::ListRecordingsResponse page;
  EXPECT_EQ(stub_->ListRecordings(&context, {}, &page).error_code(),
            StatusCode::FAILED_PRECONDITION);
}

}  // namespace
}  // namespace horopter
