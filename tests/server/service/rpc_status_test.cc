// What a failed call says, for people and for programs.
#include "server/service/rpc_status.h"

#include <gtest/gtest.h>

#include <map>

#include "horopter/v1/errors.pb.h"

namespace horopter {
namespace {

// The details by the name of google.rpc that they travel under.
std::map<std::string, std::string> DetailsOf(const absl::Status& status, v1::Status* out) {
  EXPECT_TRUE(out->ParseFromString(ErrorDetails(status, "run-000001")));
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
  const auto details = DetailsOf(InvalidField("images[2].content", "empty"), &status);
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
  v1::RequestInfo request;
  ASSERT_TRUE(request.ParseFromString(details.at("RequestInfo")));
  EXPECT_EQ(request.request_id(), "run-000001");
  EXPECT_EQ(details.count("RetryInfo"), 0u);
}

TEST(ErrorDetails, ABusyServerSaysWhenToTryAgain) {
  v1::Status status;
  const auto details = DetailsOf(QueueFull(1250), &status);
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
  const std::string bytes =
      ErrorDetails(InvalidField("name", std::string(100'000, '\xff') + "\n"), "id");
  EXPECT_LT(bytes.size(), 4096u);  // of 8 KiB of metadata
  EXPECT_TRUE(status.ParseFromString(bytes));
  EXPECT_EQ(status.message().find('\xff'), std::string::npos);
}

TEST(PrefixField, NamesTheFieldFromTheRequestAndKeepsTheRest) {
  const absl::Status inner = absl::InvalidArgumentError("edges[3].polyline_m: 1 point");
  const absl::Status outer = PrefixField("requests[1].", PrefixField("object.", inner));
  EXPECT_EQ(ErrorField(outer), "requests[1].object.edges[3].polyline_m");
  EXPECT_EQ(outer.message(), "requests[1].object.edges[3].polyline_m: 1 point");
  EXPECT_EQ(PrefixField("object.", absl::NotFoundError("gone")).message(), "gone");
  EXPECT_EQ(RetryAfter(PrefixField("object.", QueueFull(7))), "7");
}

}  // namespace
}  // namespace horopter
