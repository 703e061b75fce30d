#include "server/service/waiting_listener.h"

#include <grpcpp/grpcpp.h>
#include <gtest/gtest.h>
#include <unistd.h>

#include <atomic>
#include <thread>
#include <vector>

#include "absl/strings/str_cat.h"
#include "horopter/v1/answers.grpc.pb.h"
#include "horopter/v1/catalog.grpc.pb.h"
#include "tests/server/service/health_answer.h"

namespace horopter {
namespace {

constexpr char kReason[] = "the database is waited for";

std::unique_ptr<WaitingListener> Start(const std::string& address) {
  auto started = WaitingListener::Start(address, {}, {}, kReason);
  EXPECT_TRUE(started.ok()) << started.status();
  return started.ok() ? *std::move(started) : nullptr;
}

// A channel that shares no connection with others to this address.
std::shared_ptr<grpc::Channel> ChannelTo(const std::string& address) {
  grpc::ChannelArguments arguments;
  arguments.SetInt(GRPC_ARG_USE_LOCAL_SUBCHANNEL_POOL, 1);
  return grpc::CreateCustomChannel(address, grpc::InsecureChannelCredentials(), arguments);
}

grpc::Status ListObjects(const std::shared_ptr<grpc::Channel>& channel) {
  grpc::ClientContext context;
  v1::ListObjectsResponse response;
  return v1::CatalogService::NewStub(channel)->ListObjects(&context, {}, &response);
}

TEST(WaitingListener, HealthIsNotServingAndCallsLearnWhy) {
  const auto listener = Start("127.0.0.1:0");
  ASSERT_NE(listener, nullptr);
  const auto channel = ChannelTo(listener->address());
  for (const char* service : {"", "horopter.v1.RecognitionService", "horopter.v1.CatalogService"}) {
    EXPECT_EQ(HealthAnswer(channel, service), kNotServing) << service;
  }
  const grpc::Status listed = ListObjects(channel);
  EXPECT_EQ(listed.error_code(), grpc::StatusCode::UNAVAILABLE);
  EXPECT_EQ(listed.error_message(), kReason);

  grpc::ClientContext context;
  v1::WatchedAnswer answer;
  const auto stub = v1::AnswerService::NewStub(channel);
  const auto watched = stub->WatchAnswers(&context, {});
  EXPECT_FALSE(watched->Read(&answer));
  const grpc::Status ended = watched->Finish();
  EXPECT_EQ(ended.error_code(), grpc::StatusCode::UNAVAILABLE);
  EXPECT_EQ(ended.error_message(), kReason);
}

TEST(WaitingListener, LargeRequestsAreRefusedAsWell) {
  const auto listener = Start("127.0.0.1:0");
  ASSERT_NE(listener, nullptr);
  grpc::ClientContext context;
  v1::CreateObjectRequest request;
  request.mutable_object()->set_display_name(std::string(8 << 20, 'x'));
  v1::Object response;
  const grpc::Status made = v1::CatalogService::NewStub(ChannelTo(listener->address()))
                                ->CreateObject(&context, request, &response);
  EXPECT_EQ(made.error_code(), grpc::StatusCode::UNAVAILABLE) << made.error_message();
}

TEST(WaitingListener, ItsAddressIsFreeForTheServerAfterwards) {
  // Below those that the system hands out: nobody else takes it between two rounds.
  constexpr int kFirstPort = 21000, kPorts = 9000;
  std::unique_ptr<WaitingListener> first;
  for (int i = 0; first == nullptr && i < 100; ++i) {
    const std::string address = absl::StrCat("127.0.0.1:", kFirstPort + (::getpid() + i) % kPorts);
    auto started = WaitingListener::Start(address, {}, {}, kReason);
    if (started.ok()) first = *std::move(started);
  }
  ASSERT_NE(first, nullptr);
  const std::string address = first->address();
  EXPECT_EQ(WaitingListener::Start(address, {}, {}, kReason).status().code(),
            absl::StatusCode::kUnavailable);
  // Calls that run meanwhile are ended one way or the other, none hangs.
  std::atomic<bool> stop = false;
  std::vector<std::thread> callers;
  for (int i = 0; i < 4; ++i) {
    callers.emplace_back([&] {
      const auto channel = ChannelTo(address);
      while (!stop) EXPECT_EQ(ListObjects(channel).error_code(), grpc::StatusCode::UNAVAILABLE);
    });
  }
  for (int round = 0; round < 20; ++round) {
    first.reset();
    first = Start(address);
    ASSERT_NE(first, nullptr) << round;
    EXPECT_EQ(HealthAnswer(ChannelTo(address), ""), kNotServing);
  }
  stop = true;
  for (std::thread& caller : callers) caller.join();
}

TEST(WaitingListener, WhatItCannotListenOnIsSaid) {
  EXPECT_EQ(WaitingListener::Start("nonsense", {}, {}, kReason).status().code(),
            absl::StatusCode::kInvalidArgument);
  TlsOptions half;
  half.certificate = "/nonexistent/server.pem";
  EXPECT_EQ(WaitingListener::Start("127.0.0.1:0", half, {}, kReason).status().code(),
            absl::StatusCode::kInvalidArgument);
}

}  // namespace
}  // namespace horopter
