// Deadlines, cancellation, a full queue, draining, health: what a call meets before and around the
// pipeline.
#include <gmock/gmock.h>
#include <grpcpp/generic/generic_stub.h>
#include <grpcpp/grpcpp.h>
#include <gtest/gtest.h>

#include <atomic>
#include <chrono>
#include <fstream>
#include <future>
#include <iterator>
#include <opencv2/core.hpp>
#include <opencv2/imgcodecs.hpp>
#include <thread>

#include "horopter/v1/server.grpc.pb.h"
#include "server/service/rpc_status.h"
#include "server/service/unary_call.h"
#include "tests/server/service/health_answer.h"
#include "tests/support/scratch_dir.h"
#include "tests/support/service_fixture.h"

namespace horopter {
namespace {

using namespace std::chrono_literals;

v1::RecognizeSceneRequest OneImage() {
  std::vector<unsigned char> bytes;
  cv::imencode(".png", cv::Mat(32, 32, CV_8UC1, cv::Scalar(90)), bytes);
  v1::RecognizeSceneRequest request;
  request.add_images()->set_content(bytes.data(), bytes.size());
  return request;
}

// Holds every call until it is opened or the call is stopped.
class Gate {
 public:
  ~Gate() { Open(); }
  void Open() { open_ = true; }
  int entered() const { return entered_; }
  int stopped() const { return stopped_; }
  bool AwaitEntered(int count) const {
    return Await([&] { return entered_ >= count; });
  }
  bool AwaitStopped(int count) const {
    return Await([&] { return stopped_ >= count; });
  }

  Recognizer recognizer() {
    return [this](const SceneRequest& request,
                  const CatalogSnapshot&,
                  const CallLimits& limits) -> absl::StatusOr<PipelineResult> {
      ++entered_;
      while (!open_) {
        if (limits.stop()) {
          ++stopped_;
          return absl::CancelledError("stopped");
        }
        std::this_thread::sleep_for(1ms);
      }
      PipelineResult result;
      result.answer.cameras.resize(request.images.size());
      return result;
    };
  }

 private:
  // The limit only ends a test that has failed.
  template <typename Condition>
  static bool Await(const Condition& condition) {
    for (int i = 0; i < 20000 && !condition(); ++i) std::this_thread::sleep_for(1ms);
    return condition();
  }

  std::atomic<bool> open_{false};
  std::atomic<int> entered_{0}, stopped_{0};
};

grpc::Status Recognize(TestServer& server, grpc::ClientContext& context) {
  v1::RecognizeSceneResponse answer;
  return server.recognition().RecognizeScene(&context, OneImage(), &answer);
}

v1::ServerInfo Info(TestServer& server) {
  grpc::ClientContext context;
  v1::ServerInfo info;
  EXPECT_TRUE(v1::ServerService::NewStub(server.channel())
                  ->GetServerInfo(&context, v1::GetServerInfoRequest(), &info)
                  .ok());
  return info;
}

TEST(Admission, ADeadlineStopsTheRunningStages) {
  Gate gate;
  TestServer server(gate.recognizer());
  grpc::ClientContext context;
  context.set_deadline(std::chrono::system_clock::now() + 50ms);
  EXPECT_EQ(Recognize(server, context).error_code(), grpc::StatusCode::DEADLINE_EXCEEDED);
  // A slow machine may pass the deadline before the stages begin; then there is nothing to stop.
  if (gate.entered() > 0) {
    EXPECT_TRUE(gate.AwaitStopped(1));
  }
}

// What a call's limits say until they stop it, or at once where it has no deadline to wait for.
struct Limits {
  std::atomic<int> calls{0}, hurried_at_first{0}, hurried{0}, hurried_before_stop{0};
  std::atomic<double> allowed_s{-1.0};
};

Recognizer Watching(Limits& seen, bool until_hurry) {
  return [&seen, until_hurry](const SceneRequest& request,
                              const CatalogSnapshot&,
                              const CallLimits& limits) -> absl::StatusOr<PipelineResult> {
    ++seen.calls;
    seen.allowed_s = limits.allowed_s;
    seen.hurried_at_first += limits.hurry();
    while (until_hurry && !limits.hurry()) std::this_thread::sleep_for(1ms);
    seen.hurried_before_stop += !limits.stop() && until_hurry;
    while (until_hurry && !limits.stop()) std::this_thread::sleep_for(1ms);
    seen.hurried += limits.hurry();
    PipelineResult result;
    result.answer.cameras.resize(request.images.size());
    return result;
  };
}

TEST(Admission, ACallWithoutADeadlineIsNeverInAHurryAndALongOneNotAtFirst) {
  Limits seen;
  TestServer server(Watching(seen, false));
  grpc::ClientContext unlimited, patient;
  EXPECT_TRUE(Recognize(server, unlimited).ok());
  EXPECT_EQ(seen.allowed_s, 0.0);
  patient.set_deadline(std::chrono::system_clock::now() + 1h);
  EXPECT_TRUE(Recognize(server, patient).ok());
  EXPECT_EQ(seen.calls, 2);
  EXPECT_EQ(seen.hurried, 0);
}

TEST(Admission, ADeadlineHurriesTheStagesBeforeItStopsThem) {
  Limits seen;
  {
    TestServer server(Watching(seen, true));
    grpc::ClientContext context;
    context.set_deadline(std::chrono::system_clock::now() + 2s);
    EXPECT_EQ(Recognize(server, context).error_code(), grpc::StatusCode::DEADLINE_EXCEEDED);
    server.server().Stop(20.0);
  }
  ASSERT_EQ(seen.calls, 1);
  EXPECT_GT(seen.allowed_s, 0.0);
  EXPECT_LE(seen.allowed_s, 2.0);
  EXPECT_EQ(seen.hurried_at_first, 0);
  EXPECT_EQ(seen.hurried_before_stop, 1);
  EXPECT_EQ(seen.hurried, 1);
}

TEST(Admission, WhatTheHurryLeavesIsAShareOfLongCallsAndEnoughOfShortOnes) {
  EXPECT_DOUBLE_EQ(HurryAfterS(6.0), 4.5);
  EXPECT_DOUBLE_EQ(HurryAfterS(3.0), 2.2);
  EXPECT_DOUBLE_EQ(HurryAfterS(1.0), 0.3);
  EXPECT_DOUBLE_EQ(HurryAfterS(0.0), 0.0);
}

TEST(Admission, ACancelStopsTheRunningStages) {
  Gate gate;
  TestServer server(gate.recognizer());
  grpc::ClientContext context;
  auto call = std::async(std::launch::async, [&] { return Recognize(server, context); });
  ASSERT_TRUE(gate.AwaitEntered(1));
  context.TryCancel();
  EXPECT_EQ(call.get().error_code(), grpc::StatusCode::CANCELLED);
  EXPECT_TRUE(gate.AwaitStopped(1));
}

TEST(Admission, ACallCancelledInTheQueueNeverReachesTheStages) {
  Gate gate;
  TestServer server(gate.recognizer());
  grpc::ClientContext first, second;
  auto running = std::async(std::launch::async, [&] { return Recognize(server, first); });
  ASSERT_TRUE(gate.AwaitEntered(1));
  second.set_deadline(std::chrono::system_clock::now() + 20ms);
  EXPECT_EQ(Recognize(server, second).error_code(), grpc::StatusCode::DEADLINE_EXCEEDED);
  gate.Open();
  EXPECT_TRUE(running.get().ok());
  server.server().Stop(20.0);
  EXPECT_EQ(gate.entered(), 1);
}

TEST(Admission, AFullQueueIsRefusedAtOnceWithARetryHintAndTheOthersFinish) {
  Gate gate;
  ServerOptions options;
  options.workers = 1;
  options.queue = 2;
  TestServer server(gate.recognizer(), options);
  std::vector<grpc::ClientContext> contexts(6);
  std::vector<std::future<grpc::Status>> calls;
  for (grpc::ClientContext& context : contexts) {
    calls.push_back(std::async(std::launch::async, [&] { return Recognize(server, context); }));
  }
  // Three fit in; the other three end while the gate is still closed.
  int refused = 0;
  while (refused < 3) {
    for (size_t i = 0; i < calls.size(); ++i) {
      if (!calls[i].valid() || calls[i].wait_for(1ms) != std::future_status::ready) continue;
      EXPECT_EQ(calls[i].get().error_code(), grpc::StatusCode::RESOURCE_EXHAUSTED);
      EXPECT_GE(std::atoi(Trailing(contexts[i], kRetryAfterKey).c_str()), 100);
      ++refused;
    }
  }
  // The catalog answers meanwhile.
  EXPECT_TRUE(server.Enrol("box"));
  gate.Open();
  for (auto& call : calls) {
    if (call.valid()) {
      EXPECT_TRUE(call.get().ok());
    }
  }
  EXPECT_EQ(gate.entered(), 3);
}

// Reading megabytes to refuse them would take longer than the refusal.
TEST(Admission, AFullQueueRefusesARequestThatItHasNotRead) {
  Gate gate;
  ServerOptions options;
  options.queue = 0;
  TestServer server(gate.recognizer(), options);
  grpc::ClientContext first, context;
  auto running = std::async(std::launch::async, [&] { return Recognize(server, first); });
  ASSERT_TRUE(gate.AwaitEntered(1));
  grpc::GenericStub stub(server.channel());
  const grpc::Slice slice("no message of this method");
  const grpc::ByteBuffer request(&slice, 1);
  grpc::ByteBuffer response;
  std::promise<grpc::Status> refused;
  stub.UnaryCall(&context,
                 "/horopter.v1.RecognitionService/RecognizeScene",
                 {},
                 &request,
                 &response,
                 [&](const grpc::Status& status) { refused.set_value(status); });
  const grpc::Status status = refused.get_future().get();
  EXPECT_EQ(status.error_code(), grpc::StatusCode::RESOURCE_EXHAUSTED) << status.error_message();
  EXPECT_GE(std::atoi(Trailing(context, kRetryAfterKey).c_str()), 100);
  gate.Open();
  EXPECT_TRUE(running.get().ok());
}

// Over the network, where gRPC counts the bytes.
TEST(Admission, TwoOfTheLargestRequestsAtOnceAreBothAnswered) {
  Gate gate;
  ServerOptions options;
  options.listen = "127.0.0.1:0";
  options.max_message_mb = options.max_object_mb = 4;
  options.memory_mb = 256;
  options.workers = 2;
  TestServer server(gate.recognizer(), options);
  v1::RecognizeSceneRequest largest;
  v1::RawFrame* frame = largest.add_images()->mutable_raw();
  frame->set_format(v1::RawFrame::PIXEL_FORMAT_GRAY8);
  frame->set_width_px(2000);
  frame->set_height_px(2000);
  frame->set_data(std::string(2000 * 2000, 'x'));
  const auto stub = v1::RecognitionService::NewStub(
      grpc::CreateChannel(server.server().address(), grpc::InsecureChannelCredentials()));
  const auto recognize = [&] {
    grpc::ClientContext context;
    v1::RecognizeSceneResponse answer;
    return stub->RecognizeScene(&context, largest, &answer);
  };
  auto first = std::async(std::launch::async, recognize);
  auto second = std::async(std::launch::async, recognize);
  EXPECT_TRUE(gate.AwaitEntered(2));
  gate.Open();
  for (auto* call : {&first, &second}) {
    const grpc::Status status = call->get();
    EXPECT_TRUE(status.ok()) << status.error_message();
  }
}

TEST(Admission, ACallCancelledInTheQueueGivesItsPlaceBackAtOnce) {
  Gate gate;
  ServerOptions options;
  options.queue = 1;
  TestServer server(gate.recognizer(), options);
  grpc::ClientContext first, second, third;
  auto running = std::async(std::launch::async, [&] { return Recognize(server, first); });
  ASSERT_TRUE(gate.AwaitEntered(1));
  auto waiting = std::async(std::launch::async, [&] { return Recognize(server, second); });
  const auto info = [&] { return Info(server).load(); };
  while (info().waiting() < 1) std::this_thread::sleep_for(1ms);
  const int64_t held = info().reserved_bytes();
  second.TryCancel();
  EXPECT_EQ(waiting.get().error_code(), grpc::StatusCode::CANCELLED);
  while (info().waiting() > 0) std::this_thread::sleep_for(1ms);
  EXPECT_LT(info().reserved_bytes(), held);
  EXPECT_EQ(info().running(), 1) << "the first one still runs";
  auto next = std::async(std::launch::async, [&] { return Recognize(server, third); });
  while (info().waiting() < 1) {
    ASSERT_NE(next.wait_for(1ms), std::future_status::ready) << next.get().error_message();
  }
  gate.Open();
  EXPECT_TRUE(running.get().ok());
  EXPECT_TRUE(next.get().ok());
}

TEST(Admission, BytesAreReservedBeforeACallIsQueuedAndGivenBackAfterIt) {
  Gate gate;
  ServerOptions options;
  options.max_message_mb = options.max_object_mb = 8;
  options.memory_mb = 16;
  options.queue = 100;
  TestServer server(gate.recognizer(), options);
  // 600 x 600 raw pixels: 0.36 MB twice and 24 bytes a pixel, so that one fits and a second does
  // not.
  v1::RecognizeSceneRequest large;
  v1::RawFrame* frame = large.add_images()->mutable_raw();
  frame->set_format(v1::RawFrame::PIXEL_FORMAT_GRAY8);
  frame->set_width_px(600);
  frame->set_height_px(600);
  frame->set_data(std::string(600 * 600, 'x'));
  const auto call = [&](grpc::ClientContext& context) {
    v1::RecognizeSceneResponse answer;
    return server.recognition().RecognizeScene(&context, large, &answer);
  };
  grpc::ClientContext first, second, third, fourth;
  auto running = std::async(std::launch::async, [&] { return call(first); });
  ASSERT_TRUE(gate.AwaitEntered(1));
  EXPECT_EQ(call(second).error_code(), grpc::StatusCode::RESOURCE_EXHAUSTED);
  EXPECT_GE(std::atoi(Trailing(second, kRetryAfterKey).c_str()), 100);
  gate.Open();
  EXPECT_TRUE(running.get().ok());
  while (Info(server).load().reserved_bytes() > 0) std::this_thread::sleep_for(1ms);
  EXPECT_TRUE(call(third).ok());
  // What no waiting helps is refused without a time to try again.
  frame->set_width_px(1000);
  frame->set_height_px(1000);
  frame->set_data(std::string(1000 * 1000, 'x'));
  EXPECT_EQ(call(fourth).error_code(), grpc::StatusCode::RESOURCE_EXHAUSTED);
  EXPECT_EQ(Trailing(fourth, kRetryAfterKey), "");
}

TEST(Admission, EachMethodHasItsOwnMessageLimit) {
  TestServer server(Gate().recognizer());
  v1::GetObjectRequest request;
  request.set_name(std::string(2 << 20, 'x'));
  grpc::ClientContext context;
  v1::Object object;
  EXPECT_EQ(server.catalog().GetObject(&context, request, &object).error_code(),
            grpc::StatusCode::RESOURCE_EXHAUSTED);
}

TEST(Admission, TheServerTellsItsLimits) {
  ServerOptions options;
  options.images.max_pixels = 12345678;
  options.queue = 3;
  TestServer server(Gate().recognizer(), options);
  ASSERT_TRUE(server.Enrol("box"));
  const v1::ServerInfo info = Info(server);
  EXPECT_FALSE(info.version().empty());
  EXPECT_GT(info.start_time().seconds(), 0);
  EXPECT_EQ(info.limits().max_images(), 32);
  EXPECT_EQ(info.limits().max_image_pixels(), 12345678);
  EXPECT_EQ(info.limits().queue(), 3);
  EXPECT_EQ(info.limits().max_segments_per_image(), PipelineOptions().features.max_segments);
  EXPECT_EQ(info.limits().max_arcs_per_image(), PipelineOptions().features.arcs.max_arcs);
  EXPECT_GT(info.limits().max_arcs_per_image(), 0);
  EXPECT_EQ(info.object_count(), 1);
  EXPECT_GE(info.catalog_generation(), 1);
}

// Over the network: gRPC's in-process transport cannot begin a call on a server that shuts down.
TEST(Admission, DrainingFinishesWhatRunsAndRefusesWhatComes) {
  Gate gate;
  ServerOptions options;
  options.listen = "127.0.0.1:0";
  TestServer server(gate.recognizer(), options);
  const auto stub = v1::RecognitionService::NewStub(
      grpc::CreateChannel(server.server().address(), grpc::InsecureChannelCredentials()));
  const auto recognize = [&] {
    grpc::ClientContext context;
    v1::RecognizeSceneResponse answer;
    return stub->RecognizeScene(&context, OneImage(), &answer);
  };
  auto running = std::async(std::launch::async, recognize);
  ASSERT_TRUE(gate.AwaitEntered(1));
  auto stop = std::async(std::launch::async, [&] { server.server().Stop(20.0); });
  // Calls that come before Stop has begun are let in; they wait behind the first one until their
  // deadline.
  const auto refused = [&] {
    grpc::ClientContext context;
    context.set_deadline(std::chrono::system_clock::now() + 200ms);
    v1::RecognizeSceneResponse answer;
    const grpc::Status status = stub->RecognizeScene(&context, OneImage(), &answer);
    return status.error_code() == grpc::StatusCode::UNAVAILABLE;
  };
  bool was_refused = false;
  for (int i = 0; i < 50 && !was_refused; ++i) was_refused = refused();
  EXPECT_TRUE(was_refused);
  EXPECT_EQ(stop.wait_for(0ms), std::future_status::timeout)
      << "Stop must wait for the running call";
  gate.Open();
  EXPECT_TRUE(running.get().ok());
  stop.get();
  EXPECT_EQ(gate.entered(), 1);
}

TEST(Admission, AfterTheDrainTimeRunningCallsAreCancelled) {
  Gate gate;
  TestServer server(gate.recognizer());
  grpc::ClientContext context;
  auto running = std::async(std::launch::async, [&] { return Recognize(server, context); });
  ASSERT_TRUE(gate.AwaitEntered(1));
  server.server().Stop(0.01);
  EXPECT_FALSE(running.get().ok());
  EXPECT_EQ(gate.stopped(), 1);
}

// Nobody cancelled: the log must not say so.
TEST(Admission, ADrainThatRunsOutIsNotTheClientsDoing) {
  const ScratchDir folder;
  ServerOptions options;
  options.telemetry.request_log = folder.File("requests.jsonl");
  {
    Gate gate;
    TestServer server(gate.recognizer(), options);
    grpc::ClientContext context;
    auto running = std::async(std::launch::async, [&] { return Recognize(server, context); });
    ASSERT_TRUE(gate.AwaitEntered(1));
    server.server().Stop(0.01);
    EXPECT_FALSE(running.get().ok());
  }
  std::ifstream log(options.telemetry.request_log);
  const std::string lines((std::istreambuf_iterator<char>(log)), {});
  EXPECT_NE(lines.find("\"UNAVAILABLE\""), std::string::npos) << lines;
  EXPECT_EQ(lines.find("\"CANCELLED\""), std::string::npos) << lines;
}

TEST(Admission, HealthSaysServingForTheServerAndEachService) {
  TestServer server(Gate().recognizer());
  for (const char* service : {"",
                              "horopter.v1.RecognitionService",
                              "horopter.v1.CatalogService",
                              "horopter.v1.ServerService"}) {
    EXPECT_EQ(HealthAnswer(server.channel(), service), kServing) << service;
  }
  EXPECT_EQ(HealthAnswer(server.channel(), "nonsense").rfind("error", 0), 0u);
}

TEST(Admission, ATakenPortAndBadOptionsAreRefused) {
  ServerOptions options;
  options.listen = "127.0.0.1:0";
  TestServer first(Gate().recognizer(), options);
  EXPECT_THAT(first.server().address(), testing::StartsWith("127.0.0.1:"));
  options.listen = first.server().address();
  const auto start = [](const ServerOptions& chosen) {
    return HoropterServer::Start(*Catalog::Open(":memory:"), {}, {}, chosen).status();
  };
  EXPECT_EQ(start(options).code(), absl::StatusCode::kUnavailable);
  options.workers = 0;
  EXPECT_EQ(start(options).code(), absl::StatusCode::kInvalidArgument);
}

}  // namespace
}  // namespace horopter
