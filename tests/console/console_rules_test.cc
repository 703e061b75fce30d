// What browsers may ask, frames, sessions and rates: the console's pure parts.
#include <gtest/gtest.h>

#include <chrono>
#include <string>
#include <vector>

#include "console/peer_rates.h"
#include "console/request_rules.h"
#include "console/sessions.h"
#include "console/web_frames.h"

namespace horopter {
namespace {

using std::chrono::minutes;
using std::chrono::seconds;
const ConsoleTime kStart{};

TEST(WebFrames, MessagesComeBackAsTheyWereSent) {
  const std::string body = WebMessageHead(3) + "abc" + WebMessageHead(0) + WebMessageHead(1) + "d";
  const auto read = ReadWebMessages(body, 3);
  ASSERT_TRUE(read.ok()) << read.status();
  EXPECT_EQ(*read, (std::vector<std::string_view>{"abc", "", "d"}));
  EXPECT_FALSE(ReadWebMessages(body, 2).ok());
}

TEST(WebFrames, EveryCutIsNoticed) {
  const std::string body = WebMessageHead(3) + "abc";
  for (size_t bytes = 0; bytes < body.size(); ++bytes) {
    EXPECT_FALSE(ReadWebMessages(body.substr(0, bytes), 9).ok()) << bytes;
  }
  EXPECT_FALSE(ReadWebMessages(std::string("\x01\0\0\0\0", 5), 9).ok());  // compressed
  EXPECT_FALSE(ReadWebMessages(std::string("\x80\0\0\0\0", 5), 9).ok());  // trailers
  EXPECT_FALSE(ReadWebMessages(std::string("\0\xff\xff\xff\xff", 5), 9).ok());
}

TEST(WebFrames, TrailersCannotBeBrokenOutOf) {
  const std::string frame =
      WebTrailerFrame(5,
                      "a\r\nb: \xC3\xA9%",
                      {{"x-bin", std::string("\0\1", 2)}, {"bad name", "v"}, {"y", "1\r\n2"}});
  EXPECT_EQ(frame.substr(5),
            "grpc-status: 5\r\ngrpc-message: a%0D%0Ab: %C3%A9%25\r\nx-bin: AAE=\r\n");
  EXPECT_EQ(static_cast<unsigned char>(frame[0]), 0x80);
  EXPECT_EQ(static_cast<size_t>(static_cast<unsigned char>(frame[4])), frame.size() - 5);
}

TEST(WebFrames, TimeoutsHaveUnitsAndBounds) {
  EXPECT_EQ(ParseGrpcTimeout("5S"), seconds(5));
  EXPECT_EQ(ParseGrpcTimeout("2M"), minutes(2));
  EXPECT_EQ(ParseGrpcTimeout("7m"), std::chrono::milliseconds(7));
  EXPECT_GT(*ParseGrpcTimeout("99999999H"), seconds(0));
  for (const char* wrong : {"", "5", "S", "-5S", "5X", "123456789S", "1.5S"}) {
    EXPECT_FALSE(ParseGrpcTimeout(wrong)) << wrong;
  }
}

TEST(RequestRules, OnlyOwnNamesAndAddressesAreHosts) {
  for (const char* own : {"localhost:8080", "127.0.0.1:1", "[::1]:8080", "10.1.2.3", "Cell7:80"}) {
    EXPECT_TRUE(IsOwnHost(own, {"cell7"})) << own;
  }
  for (const char* other : {"",
                            "evil.example",
                            "localhost.evil.example",
                            "127.0.0.1.evil.example",
                            "cell7.evil.example:80"}) {
    EXPECT_FALSE(IsOwnHost(other, {"cell7"})) << other;
  }
}

TEST(RequestRules, ForeignRequestsAreTold) {
  EXPECT_EQ(WhyForeign({"h:1", "http://h:1", "same-origin", "1"}, "http"), "");
  EXPECT_EQ(WhyForeign({"h:1", "", "", "1"}, "http"), "");
  EXPECT_NE(WhyForeign({"h:1", "http://h:1", "same-origin", ""}, "http"), "");
  EXPECT_NE(WhyForeign({"h:1", "http://h:2", "same-origin", "1"}, "http"), "");
  EXPECT_NE(WhyForeign({"h:1", "https://h:1", "", "1"}, "http"), "");
  EXPECT_NE(WhyForeign({"h:1", "http://h:1", "same-site", "1"}, "http"), "");
  EXPECT_NE(WhyForeign({"h:1", "null", "", "1"}, "http"), "");
}

TEST(RequestRules, OneCookieOrNone) {
  EXPECT_EQ(CookieOf("a=1; s=2; b=3", "s"), "2");
  EXPECT_EQ(CookieOf("s=2", "s"), "2");
  EXPECT_EQ(CookieOf("s=2; s=3", "s"), "");
  EXPECT_EQ(CookieOf("xs=2; ss; =s", "s"), "");
  EXPECT_EQ(CookieOf("", "s"), "");
}

TEST(RequestRules, OnlyOurPackageIsCalled) {
  EXPECT_TRUE(RpcMethodOf("/horopter.v1.CatalogService/GetObject"));
  for (const char* wrong : {"/horopter.v1.CatalogService",
                            "/horopter.v1.CatalogService/",
                            "/horopter.v1./x",
                            "/horopter.v2.CatalogService/GetObject",
                            "/horopter.v1.A/B/C",
                            "/horopter.v1.A/B?c",
                            "/grpc.health.v1.Health/Check",
                            ""}) {
    EXPECT_FALSE(RpcMethodOf(wrong)) << wrong;
  }
}

TEST(Sessions, EndByIdlenessAndByAge) {
  ConsoleSessions sessions({.idle_minutes = 10, .lifetime_hours = 1, .most = 10});
  const std::string id = sessions.Open("secret", kStart);
  ASSERT_EQ(id.size(), 64u);
  for (int minute = 5; minute < 60; minute += 5) {
    const std::string* token = sessions.Use(id, kStart + minutes(minute));
    ASSERT_NE(token, nullptr) << minute;
    EXPECT_EQ(*token, "secret");
  }
  EXPECT_EQ(sessions.Use(id, kStart + minutes(60)), nullptr);
  const std::string idle = sessions.Open("secret", kStart);
  EXPECT_EQ(sessions.Use(idle, kStart + minutes(10)), nullptr);
  EXPECT_EQ(sessions.size(), 0u);
}

TEST(Sessions, AreBoundedAndTheLongestIdleGoes) {
  ConsoleSessions sessions({.idle_minutes = 1000, .lifetime_hours = 1000, .most = 3});
  std::vector<std::string> ids;
  for (int i = 0; i < 4; ++i) {
    ids.push_back(sessions.Open("t", kStart + seconds(i)));
    EXPECT_NE(sessions.Use(ids[0], kStart + seconds(i)), nullptr);
  }
  EXPECT_EQ(sessions.size(), 3u);
  EXPECT_EQ(sessions.Use(ids[1], kStart + seconds(9)), nullptr);
  EXPECT_NE(sessions.Use(ids[3], kStart + seconds(9)), nullptr);
  sessions.Close(ids[3]);
  EXPECT_EQ(sessions.Use(ids[3], kStart + seconds(9)), nullptr);
  EXPECT_EQ(sessions.Use("", kStart), nullptr);
}

TEST(PeerRates, BurstThenTheRateAndOthersAreNotTouched) {
  PeerRates rates({.per_second = 2.0, .burst = 3.0});
  for (int i = 0; i < 3; ++i) EXPECT_TRUE(rates.Take("a", kStart));
  EXPECT_FALSE(rates.Take("a", kStart));
  EXPECT_TRUE(rates.Take("b", kStart));
  EXPECT_TRUE(rates.Take("a", kStart + std::chrono::milliseconds(600)));
  EXPECT_FALSE(rates.Take("a", kStart + std::chrono::milliseconds(600)));
}

TEST(PeerRates, MemoryIsBounded) {
  PeerRates rates({.per_second = 1.0, .burst = 2.0});
  int taken = 0;
  for (int i = 0; i < 10000; ++i) taken += rates.Take(std::to_string(i), kStart);
  EXPECT_LE(taken, 4096);
  EXPECT_TRUE(rates.Take("later", kStart + seconds(10)));
}

}  // namespace
}  // namespace horopter
