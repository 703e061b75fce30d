// What a failed call says to programs.
#include "server/service/error_details.h"

#include <grpcpp/server_context.h>
#include <grpcpp/support/status.h>
#include <gtest/gtest.h>

#include <map>
#include <string_view>

#include "horopter/v1/errors.pb.h"
#include "server/service/rpc_status.h"

namespace horopter {
namespace {

// The details by the name of google.rpc that they travel under.
std::map<std::string, std::string> DetailsIn(const std::string& bytes, v1::Status* out) {
  EXPECT_TRUE(out->ParseFromString(bytes));
  std::map<std::string, std::string> details;
  for (const auto& any : out->details()) {
    constexpr std::string_view kPrefix = "type.googleapis.com/google.rpc.";
    EXPECT_EQ(any.type_url().substr(0, kPrefix.size()), kPrefix);
    details[any.type_url().substr(kPrefix.size())] = any.value();
  }
  return details;
}

TEST(ErrorDetails, ABadFieldIsAViolation) {
  v1::Status status;
  const auto details = DetailsIn(ErrorDetails(InvalidField("images[2].content", "empty")), &status);
  EXPECT_EQ(status.code(), 3);
  EXPECT_EQ(status.message(), "images[2].content: empty");
  v1::BadRequest bad;
  ASSERT_TRUE(bad.ParseFromString(details.at("BadRequest")));
  ASSERT_EQ(bad.field_violations_size(), 1);
  EXPECT_EQ(bad.field_violations(0).field(), "images[2].content");
  v1::ErrorInfo info;
  ASSERT_TRUE(info.ParseFromString(details.at("ErrorInfo")));
  EXPECT_EQ(info.reason(), "FIELD_INVALID");
  EXPECT_EQ(info.domain(), "horopter");
  EXPECT_EQ(details.count("RetryInfo"), 0u);
}

TEST(ErrorDetails, ABusyServerSaysWhenToTryAgain) {
  v1::Status status;
  const auto details = DetailsIn(ErrorDetails(QueueFull(1250)), &status);
  v1::RetryInfo retry;
  ASSERT_TRUE(retry.ParseFromString(details.at("RetryInfo")));
  EXPECT_EQ(retry.retry_delay().seconds(), 1);
  EXPECT_EQ(retry.retry_delay().nanos(), 250'000'000);
  EXPECT_EQ(ErrorReason(QueueFull(1250)), "SERVER_BUSY");
  EXPECT_EQ(ErrorReason(absl::ResourceExhaustedError("disk full")), "LIMIT_EXCEEDED");
}

TEST(ErrorDetails, EveryCodeHasAReasonAndLongOrOddTextStaysSmallAndValid) {
  for (int code = 1; code <= 16; ++code) {
    EXPECT_FALSE(ErrorReason(absl::Status(static_cast<absl::StatusCode>(code), "x")).empty());
  }
  v1::Status status;
  const std::string bytes = ErrorDetails(InvalidField("name", std::string(100'000, '\xff') + "\n"));
  EXPECT_LT(bytes.size(), 4096u);
  EXPECT_TRUE(status.ParseFromString(bytes));
  EXPECT_EQ(status.message().find('\xff'), std::string::npos);
}

// As gRPC carries them, in `grpc-status-details-bin`.
TEST(ErrorDetails, TravelWithTheStatusOfACall) {
  grpc::CallbackServerContext context;
  v1::Status status;
  const grpc::Status sent = ToRpcStatus(absl::NotFoundError("objects/nut"), &context);
  EXPECT_EQ(sent.error_code(), grpc::StatusCode::NOT_FOUND);
  EXPECT_EQ(DetailsIn(sent.error_details(), &status).size(), 1u);
  EXPECT_EQ(status.message(), "objects/nut");
  EXPECT_TRUE(ToRpcStatus(absl::OkStatus(), &context).error_details().empty());
}

}  // namespace
}  // namespace horopter
