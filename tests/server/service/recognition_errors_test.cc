// What fails in the pipeline, or while the catalog is loaded, as the caller is told it.
#include <gmock/gmock.h>
#include <grpcpp/grpcpp.h>
#include <gtest/gtest.h>

#include <atomic>
#include <chrono>
#include <functional>
#include <mutex>
#include <new>
#include <opencv2/core.hpp>
#include <stdexcept>
#include <thread>

#include "server/base/stop_scope.h"
#include "server/service/rpc_status.h"
#include "tests/server/service/recording_recognizer.h"
#include "tests/support/scratch_dir.h"
#include "tests/support/service_fixture.h"

namespace horopter {
namespace {

TEST(RecognitionServiceErrors, StatusAndExceptionsOfThePipelineReachTheClient) {
  absl::Status status = absl::OkStatus();
  TestServer server([&](const SceneRequest&,
                        const CatalogSnapshot&,
                        const CallLimits&) -> absl::StatusOr<PipelineResult> {
    if (status.ok()) throw std::runtime_error("boom");
    return status;
  });
  v1::RecognizeSceneRequest request;
  request.add_images()->set_content(Png(32, 32));
  v1::RecognizeSceneResponse answer;
  {
    grpc::ClientContext context;
    const grpc::Status result = server.recognition().RecognizeScene(&context, request, &answer);
    EXPECT_EQ(result.error_code(), grpc::StatusCode::INTERNAL);
    EXPECT_THAT(result.error_message(), testing::HasSubstr("boom"));
  }
  status = absl::FailedPreconditionError("5 point matches, need 7");
  grpc::ClientContext context;
  const grpc::Status result = server.recognition().RecognizeScene(&context, request, &answer);
  EXPECT_EQ(result.error_code(), grpc::StatusCode::FAILED_PRECONDITION);
  EXPECT_EQ(result.error_message(), "5 point matches, need 7");
}

TEST(RecognitionServiceErrors, AThrowOnAThreadOfTheRequestIsItsStatusAndTheServerLives) {
  std::mutex mutex;  // who watches threads does not see that a call follows what was set before it
  std::function<void()> fail;
  const auto fail_by = [&](std::function<void()> how) {
    const std::lock_guard lock(mutex);
    fail = std::move(how);
  };
  TestServer server([&](const SceneRequest& request,
                        const CatalogSnapshot& catalog,
                        const CallLimits& limits) -> absl::StatusOr<PipelineResult> {
    PipelineOptions options;
    options.threads = 2;
    // Asked in the loop over the images first.
    const auto stop = [&] {
      const std::lock_guard lock(mutex);
      fail();
      return limits.stop();
    };
    return RecognizeScene(request, catalog, options, stop);
  });
  ASSERT_TRUE(server.Enrol("nut"));
  v1::RecognizeSceneRequest request;
  for (int i = 0; i < 4; ++i) request.add_images()->set_content(Png(32, 32));
  const auto call = [&] {
    grpc::ClientContext context;
    v1::RecognizeSceneResponse answer;
    const grpc::Status status = server.recognition().RecognizeScene(&context, request, &answer);
    EXPECT_EQ(Trailing(context, kRetryAfterKey), "");
    return status;
  };
  for (int repetition = 0; repetition < 20; ++repetition) {
    fail_by([] { throw std::bad_alloc(); });
    EXPECT_EQ(call().error_code(), grpc::StatusCode::RESOURCE_EXHAUSTED);
    fail_by([] { throw cv::Exception(cv::Error::StsBadArg, "odd kernel", "f", "filter.cpp", 1); });
    const grpc::Status status = call();
    EXPECT_EQ(status.error_code(), grpc::StatusCode::INTERNAL);
    EXPECT_THAT(status.error_message(), testing::HasSubstr("odd kernel"));
  }
}

TEST(ServerStart, WhatIsNotPreparedYetIsSaidNotTakenForMissing) {
  const ScratchDir dir;
  const std::string db = dir.File("catalog.db");
  {
    TestServer server(nullptr, {}, db);
    for (const char* id : {"nut", "box"}) ASSERT_TRUE(server.Enrol(id));
  }
  std::atomic<bool> may_prepare = false;
  ObjectPreparer preparer = FakePreparer(2);  // another version
  preparer.prepare = [&](ObjectModel model) {
    while (!may_prepare) {
      LeaveIfStopped();
      std::this_thread::sleep_for(std::chrono::milliseconds(1));
    }
    return PrepareFake(std::move(model));
  };
  Seen seen;
  auto server = HoropterServer::Start(Catalog::Open(db).value(), preparer, Recording(seen), {});
  ASSERT_TRUE(server.ok()) << server.status();
  const auto stub = v1::RecognitionService::NewStub((*server)->InProcessChannel());
  const auto recognize = [&](const std::string& candidate, v1::RecognizeSceneResponse* answer) {
    grpc::ClientContext context;
    v1::RecognizeSceneRequest request;
    request.add_images()->set_content(Png(32, 32));
    if (!candidate.empty()) request.add_candidate_objects(candidate);
    const grpc::Status status = stub->RecognizeScene(&context, request, answer);
    EXPECT_EQ(Trailing(context, kRetryAfterKey).empty(),
              status.error_code() != grpc::StatusCode::RESOURCE_EXHAUSTED);
    return status.error_code();
  };
  v1::RecognizeSceneResponse answer;
  EXPECT_EQ(recognize("objects/nut", &answer), grpc::StatusCode::RESOURCE_EXHAUSTED);
  EXPECT_EQ(recognize("objects/bolt", &answer), grpc::StatusCode::NOT_FOUND);
  ASSERT_EQ(recognize("", &answer), grpc::StatusCode::OK);
  ASSERT_EQ(answer.unsearched_size(), 1);
  EXPECT_EQ(answer.unsearched(0).cause(), v1::UnsearchedStep::CAUSE_PREPARING);
  may_prepare = true;
  const auto until = std::chrono::steady_clock::now() + std::chrono::seconds(60);
  while (!(*server)->store().Published()->pending.empty() &&
         std::chrono::steady_clock::now() < until)
    std::this_thread::sleep_for(std::chrono::milliseconds(1));
  answer.Clear();
  EXPECT_EQ(recognize("objects/nut", &answer), grpc::StatusCode::OK);
  EXPECT_EQ(answer.unsearched_size(), 0);
}

TEST(ServerStart, MemoryThatIsShortOnAThreadOfTheLoadIsAStatus) {
  const ScratchDir dir;
  const std::string db = dir.File("catalog.db");
  {
    TestServer server(nullptr, {}, db);
    for (const char* id : {"nut", "box", "rod"}) ASSERT_TRUE(server.Enrol(id));
  }
  ObjectPreparer preparer = FakePreparer(2);  // another version: all are prepared again
  preparer.prepare = [](ObjectModel) -> absl::StatusOr<ObjectPreparer::Prepared> {
    throw std::bad_alloc();
  };
  ServerOptions options;
  options.load_threads = 2;
  options.prepare_first = true;
  EXPECT_EQ(
      HoropterServer::Start(Catalog::Open(db).value(), preparer, nullptr, options).status().code(),
      absl::StatusCode::kResourceExhausted);
}

}  // namespace
}  // namespace horopter
